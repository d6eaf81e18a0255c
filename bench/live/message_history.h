// What was published of some topics since the run began, in bounded memory, so that a page which is opened
// late can show it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace rigor::live {

using Bytes = std::shared_ptr<const std::string>;

class MessageHistory {
 public:
  enum class Keep : std::uint8_t {
    thinned,  ///< over the whole time, at instants that are equally far apart: where room ends, every other
              ///< one goes
    newest    ///< the last ones
  };
  static constexpr std::size_t kMost = 1024;         ///< messages of a topic
  static constexpr std::size_t kLongest = 8u << 10;  ///< bytes of a message; longer ones are not kept

  struct Kept {
    std::uint64_t time_ns = 0;
    Bytes message;
  };

  /// Any thread, as all that follows.
  void keep(std::uint32_t channel, Keep how);
  [[nodiscard]] bool keeps(std::uint32_t channel) const;
  /// Nothing where the channel is not kept. A time that goes back by more than a second begins a new history.
  void add(std::uint32_t channel, std::uint64_t time_ns, const Bytes& message);
  /// In the order of time; the newest of all is among them.
  [[nodiscard]] std::vector<Kept> messages(std::uint32_t channel) const;

 private:
  struct Topic {
    Keep how = Keep::thinned;
    std::deque<Kept> kept;
    Kept newest;  ///< of what is thinned, where it came too soon to be kept; no message: none did
    std::uint64_t gap_ns = 0;
  };
  mutable std::mutex mutex_;
  std::map<std::uint32_t, Topic> topics_;
};

}  // namespace rigor::live

// A recording as a source's device: datagrams at the distances that their stamps have, from the run's start
// on.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>

#include "drivers/network/pcap_file.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/run_origin.h"

namespace rigor::network {

/// One thread.
class PcapFeed {
 public:
  using Wanted = std::function<bool(const UdpDatagram&)>;
  struct Item {
    BenchTime due;
    UdpDatagram datagram;  ///< until the next item
  };
  /// not_found; bad_input: no recording, or one without a datagram that is wanted. Setup.
  [[nodiscard]] static Result<PcapFeed> open(const std::filesystem::path& file, Wanted wanted);

  /// The next datagram that is wanted. Empty: the end; `broken()` says whether it is that of the file.
  [[nodiscard]] std::optional<Item> next(BenchTime t0);
  using Take = std::function<void(std::span<const std::uint8_t> datagram, BenchTime due)>;
  /// The thread of a source in a wall-clock run: waits for the run's start and gives each datagram when it is
  /// due. True: that was the recording; false: `deadline` was cut.
  [[nodiscard]] bool play(const RunOrigin& origin, Deadline& deadline, const Take& take);
  /// Virtual time: gives datagrams as long as `more` wants some. True: that was the recording.
  [[nodiscard]] bool play_while(const std::function<bool()>& more, BenchTime t0, const Take& take);
  [[nodiscard]] bool broken() const { return broken_; }
  [[nodiscard]] RealtimeTime first_stamp() const { return first_; }

 private:
  PcapFeed(PcapReader reader, Wanted wanted) : reader_(std::move(reader)), wanted_(std::move(wanted)) {}
  PcapReader reader_;
  Wanted wanted_;
  RealtimeTime first_;
  bool ended_ = false, broken_ = false;
};

}  // namespace rigor::network

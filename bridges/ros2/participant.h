// One process's part in a DDS domain: topics, writers and readers of encoded messages.
//
//   auto participant = Participant::open({.domain = 0});             loopback alone
//   auto writer = participant->write("/left/image", {"sensor_msgs/msg/Image", definition}, qos);
//   writer->send(message);                                           never waits for a peer
//   auto reader = participant->read("/cmd_vel", type, qos);
//   while (ddsi_serdata* message = reader->take()) …
//
// A process has one participant in each domain: those who open the same one share it. What CYCLONEDDS_URI
// says comes on top of what is set here.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

struct ddsi_serdata;
struct ddsi_sertype;

namespace rigor::ros2 {

struct DomainSettings {
  std::uint32_t domain = 0;
  /// By name or address; `auto`: those that Cyclone DDS chooses.
  std::string interface = "lo";
  /// Addresses of machines that multicast does not reach.
  std::vector<std::string> peers{};
  bool operator==(const DomainSettings&) const = default;
};

/// Quality of service by the name that ROS 2 has for it.
struct Qos {
  enum class Profile : std::uint8_t {
    sensor_data,     ///< best effort, volatile; a reader keeps 5
    reliable,        ///< reliable, volatile; a reader keeps 10: ROS 2's default
    transient_local  ///< reliable, for those who come later, who get the last
  };
  Profile profile = Profile::reliable;
  int depth = 0;  ///< samples that a reader keeps, or that those who come later get; 0: as the profile says
};
[[nodiscard]] std::string name_of(const Qos& qos);
[[nodiscard]] const std::vector<std::string>& qos_names();
[[nodiscard]] Qos::Profile qos_profile(const std::string& name);  ///< one of qos_names()

/// What a reliable writer holds for peers that have not acknowledged it, beyond one message; then it takes no
/// more.
inline constexpr std::uint64_t kMostUnacknowledged = 8'000'000;

struct MessageType {
  std::string name;        ///< `sensor_msgs/msg/Image`
  std::string definition;  ///< as `ros2msg`; empty: not known, and no hash is told
};

/// A peer that this process cannot exchange messages with, although it names the same topic.
struct Mismatch {
  std::uint32_t count = 0;  ///< of such peers so far
  std::string policy;       ///< RELIABILITY, DURABILITY …
};

/// Any thread, one at a time.
class Writer {
 public:
  ~Writer();
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;
  /// Of messages for `send`.
  [[nodiscard]] const ddsi_sertype* type() const { return type_; }
  /// Takes over the message. False: a peer that has to acknowledge is behind, and the message is not sent.
  [[nodiscard]] bool send(ddsi_serdata* message);
  /// Waits until all peers that acknowledge have what was sent, at most this long.
  void drain(Duration most);
  [[nodiscard]] std::uint32_t peers() const;
  [[nodiscard]] Mismatch mismatch() const;

 private:
  friend class Participant;
  Writer() = default;
  std::shared_ptr<class Participant> participant_;
  std::int32_t topic_ = 0, writer_ = 0;
  ddsi_sertype* type_ = nullptr;
};

struct Wake;

class Reader {
 public:
  ~Reader();
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  /// The next message, with a reference that the caller ends (release), or null.
  [[nodiscard]] ddsi_serdata* take();
  static void release(ddsi_serdata* message);
  /// Messages that were lost on the way, or found no place here.
  [[nodiscard]] std::uint64_t lost() const;
  [[nodiscard]] std::uint32_t peers() const;
  [[nodiscard]] Mismatch mismatch() const;

 private:
  friend class Participant;
  friend class Waiter;
  Reader() = default;
  std::shared_ptr<class Participant> participant_;
  std::shared_ptr<Wake> wake_;  ///< who waits for it
  std::int32_t topic_ = 0, reader_ = 0;
};

/// Waits for messages of several readers, on one thread.
class Waiter {
 public:
  Waiter();
  /// The thread that waits. From now on messages of this reader end a wait; the next one ends at once.
  void add(Reader& reader);
  /// Until a reader has messages or `stop` was called, at most so long.
  void wait(Duration most);
  /// Any thread: from now on `wait` returns at once.
  void stop();

 private:
  std::shared_ptr<Wake> wake_;
  std::atomic<bool> stopped_{false};
};

/// Somebody on one of our topics who means another type by it.
struct OtherType {
  std::string topic;  ///< as ROS 2 names it
  std::string ours, theirs;
  bool they_write = false;
};

class Participant : public std::enable_shared_from_this<Participant> {
 public:
  /// Setup context. unavailable: no such interface, no right, Cyclone's own words; bad_input: this process is
  /// in that domain with other settings.
  [[nodiscard]] static Result<std::shared_ptr<Participant>> open(const DomainSettings& settings);
  ~Participant();
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  // Setup context or an I/O thread. `topic`: as ROS 2 names it. unavailable, with Cyclone's reason.
  [[nodiscard]] Result<std::unique_ptr<Writer>> write(const std::string& topic, const MessageType& type,
                                                      const Qos& qos);
  [[nodiscard]] Result<std::unique_ptr<Reader>> read(const std::string& topic, const MessageType& type,
                                                     const Qos& qos);
  /// Types that peers announced for topics of ours since the last call, where they differ from ours. One
  /// thread at a time.
  [[nodiscard]] std::vector<OtherType> other_types();

 private:
  struct Impl;
  explicit Participant(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// What Cyclone DDS is told for these settings, as its own XML.
[[nodiscard]] std::string cyclone_configuration(const DomainSettings& settings);

}  // namespace rigor::ros2

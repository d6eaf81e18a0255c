// Scheduled action commands (GigE Vision 2.0): one command says at which instant of the PTP clock a camera
// begins to expose, so that all cameras that follow the same master expose together, however long the command
// took.
//
//   ActionGroup    the members' common clock: what the PTP clock says at an instant of the bench, the same
//   number
//                  for every member that asks
//   ActionSender   sends one camera its commands and takes in what it answers
//
//   auto group = ActionGroup::join(device_key, group_key);      // arm
//   group->add_latch(this, device, before, after);              // once a second
//   auto due = sender.send_due(now, t0, period, *group, …);     // whenever it is time
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "drivers/aravis/gvcp_codec.h"
#include "rt-core/clock_map.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/period.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

/// Cameras of this process that obey the same keys. Any thread.
class ActionGroup {
 public:
  /// The group of these keys; it exists while a member holds it.
  [[nodiscard]] static std::shared_ptr<ActionGroup> join(std::uint32_t device_key, std::uint32_t group_key);

  /// A member's clock read `x` at some instant in [before, after]. The latches of one member make the clock;
  /// those of the others count when it falls silent.
  void add_latch(const void* member, DeviceTime x, BenchTime before, BenchTime after);
  /// How far a member's latch is from the group's clock beyond what its window explains; 0 before the first
  /// latch.
  [[nodiscard]] Duration distance(DeviceTime x, BenchTime before, BenchTime after) const;
  /// The clock's time at `t`; for one `t` every member gets the same. Empty before the first latch.
  [[nodiscard]] std::optional<DeviceTime> time_of(BenchTime t);

 private:
  mutable std::mutex mutex_;
  ClockMap clock_;
  const void* source_ = nullptr;
  BenchTime fed_;  ///< last latch of source_
  DeviceTime newest_;
  struct Told {
    BenchTime t;
    DeviceTime x;
  };
  std::array<Told, 64> told_{};
  std::size_t told_count_ = 0;
};

struct ActionStatistics {
  std::uint64_t sent = 0;
  std::uint64_t in_time = 0;         ///< accepted for the instant that was asked for
  std::uint64_t late = 0;            ///< executed at once
  std::uint64_t refused = 0;         ///< no PTP time, a full queue, or another error
  std::uint64_t not_sent = 0;        ///< the instant was over, or no clock was known
  std::uint64_t exposed = 0;         ///< frames whose exposure began at an instant that was asked for
  Duration answer_mean, answer_max;  ///< from command to answer
  Duration jitter_mean,
      jitter_max;       ///< magnitude, of exposures against their instants, by the camera's clock
  std::string refusal;  ///< the first one
  /// All commands were obeyed in time, and exposures began when they were asked for.
  [[nodiscard]] bool good() const;
  [[nodiscard]] std::string text() const;  ///< for people
};

/// One camera's commands. Two threads: one sends and receives, one tells of exposures.
class ActionSender {
 public:
  /// Commands go to port 3956 of `address`, an IPv4 address, from now on; no other thread is here.
  [[nodiscard]] Status aim(const std::string& address);

  /// Forgets all, before a run.
  void restart();
  /// The exposures of a camera: at t0 + k·period, each asked for `lead` before.
  struct Schedule {
    BenchTime t0;
    Period period;
    Duration lead;
    gige::ActionCmd keys;
    std::function<std::uint64_t(DeviceTime)> ticks;  ///< of the camera's counter
  };
  struct Due {
    Duration wait;                   ///< until the next command is due
    std::optional<BenchTime> asked;  ///< the newest exposure whose command was sent
  };
  /// Sends what is due at `now` and takes in what was answered. Does not wait.
  Due send_due(BenchTime now, const Schedule& schedule, ActionGroup& group);
  /// Takes in what was answered.
  void receive();
  /// A frame's exposure began at `t` of the camera's clock.
  void exposed(DeviceTime t);
  [[nodiscard]] ActionStatistics statistics() const;

 private:
  struct Sent {
    std::uint16_t id = 0;
    RealtimeTime at;
    DeviceTime t;
    bool answered = true, seen = true;
  };
  void send(const gige::ActionCmd& command, DeviceTime t);

  FileDescriptor socket_;
  std::int64_t next_ = 0;  ///< index of the next exposure
  mutable std::mutex mutex_;
  std::uint16_t id_ = 0;
  std::array<Sent, 256> sent_{};
  ActionStatistics statistics_;
  Duration answer_sum_, jitter_sum_;
};

}  // namespace rigor

// A motor-driven turntable: the device's own truth behind a Modbus server or on a CAN bus, and the motion
// that cameras see.
//
// The motor follows trapezoidal profiles: constant acceleration up to the wanted rate, constant rate,
// constant braking. A command starts a new profile where the table is then, so the motion has no steps in
// angle or rate. Each profile is kept as its closed form, so that the state at any instant is computed from
// the last command alone: nothing is integrated, nothing drifts, and days later it is as exact as at once.
//
//   holding registers (16 bit; two make an s32, most significant first)
//     0    enable            0: brake and hold, 1: follow the target; writing 0 clears a fault
//     1    mode              0: rate, 1: position
//     2-3  target position   s32, 0.001 deg, position mode; not wrapped: 720000 is two turns
//     4-5  target rate       s32, 0.001 deg/s; rate mode: signed rate; position mode: greatest rate of the
//     move,
//                            0: the table's own
//     6    command timeout   ms; 0: none. Enabled and without a write to any of these registers for so long,
//                            the table brakes and holds with fault 2: the watchdog of a master that died
//   input registers
//     0-1  position          s32, 0.001 deg, all turns counted; rolls over as two's complement after 5965
//     turns 2-3  rate              s32, 0.001 deg/s 4    status            bit 0 enabled, 1 moving, 2 at
//     target, 3 fault, 4 target limited to what the motor can 5    fault             0 none, 1 mode is
//     neither 0 nor 1, 2 command timeout 6-7  angle             s32, 0.001 deg, within the turn: [-180, 180)
//
// As signals (a node on a bus) the same device has position, angle [deg], rate [deg/s], status, fault;
// commanded are enable, mode, target_position [deg], target_rate [deg/s] and command_timeout [ms], which are
// the registers above, rounded to their 0.001; what a register cannot hold is refused.
//
// After power-up: all registers 0, which means disabled, rate mode.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <limits>
#include <mutex>

#include "rt-core/published.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

struct TurntableConfig {
  double max_rate_radps = 1.5707963267948966;           ///< 90 deg/s
  double max_acceleration_radps2 = 3.1415926535897931;  ///< 180 deg/s²
  double start_rad = 0;
};

/// Constant acceleration in up to three pieces, then constant rate.
struct TurntableProfile {
  struct Piece {
    double duration_s = 0, acceleration_radps2 = 0;
  };
  BenchTime t_start;
  double position_rad = 0, rate_radps = 0;  ///< at t_start
  std::array<Piece, 3> piece{};

  struct State {
    double position_rad = 0, rate_radps = 0, acceleration_radps2 = 0;
    bool moving = false;  ///< rate or acceleration is not zero
  };
  /// The state at `t`; before t_start that at t_start.
  [[nodiscard]] State at(BenchTime t) const noexcept;
  /// Seconds until the rate is constant.
  [[nodiscard]] double settled_after_s() const noexcept {
    return piece[0].duration_s + piece[1].duration_s + piece[2].duration_s;
  }
};

/// From a state to a constant rate. `max_acceleration_radps2` above 0.
[[nodiscard]] TurntableProfile profile_to_rate(const TurntableProfile::State& from, BenchTime t,
                                               double rate_radps, double max_acceleration_radps2) noexcept;
/// From a state to rest at a position, in the shortest time that the limits allow. Where the table is faster
/// than `max_rate_radps`, it first brakes; where it cannot stop in time, it turns back.
[[nodiscard]] TurntableProfile profile_to_position(const TurntableProfile::State& from, BenchTime t,
                                                   double position_rad, double max_rate_radps,
                                                   double max_acceleration_radps2) noexcept;

/// Registers and signals: any thread, one at a time is kept by a lock. Motion: any thread, without a lock.
class Turntable final : public RegisterModel, public SignalModel, public MotionSource {
 public:
  explicit Turntable(const TurntableConfig& config = {});

  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override;
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) override;

  [[nodiscard]] const std::vector<Signal>& signals() const override;
  [[nodiscard]] double read(std::size_t signal, BenchTime t) override;
  [[nodiscard]] bool write(std::size_t signal, double value, BenchTime t) override;

  /// One joint. Its rate is that at `t`, so around `t` the motion is taken for uniform; the error after Δt is
  /// a·Δt²/2. For instants before the latest command the profile that was followed then is used, as far back
  /// as the last 64 commands that changed anything.
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override;

  static constexpr std::uint16_t kHoldingCount = 7, kInputCount = 8;

 private:
  static constexpr std::size_t kHistory = 64;
  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
  struct Entry {
    std::uint64_t number = 0;
    TurntableProfile profile;
  };
  void publish(const TurntableProfile& p) noexcept;
  void follow(BenchTime t);
  /// Up to `t`: whether the master has fallen silent on the way.
  void expire(BenchTime t);
  [[nodiscard]] std::array<std::uint16_t, kInputCount> inputs(BenchTime t) const;
  [[nodiscard]] std::int32_t holding_s32(std::size_t at) const noexcept;

  /// What the motor is told; a new profile starts when this changes.
  struct Goal {
    bool position_mode = false;
    double position_rad = 0, rate_radps = 0;
    bool operator==(const Goal&) const = default;
  };

  TurntableConfig config_;
  mutable std::mutex mutex_;  // guards all down to published_
  std::array<std::uint16_t, kHoldingCount> holding_{};
  std::uint16_t fault_ = 0;
  bool limited_ = false;
  Goal goal_;
  TurntableProfile profile_;
  BenchTime last_;
  std::atomic<std::int64_t> expires_ns_{kNever};  ///< when the master will have been silent for too long

  // Profile n is in place n % kHistory and says its number, so that a reader who was overtaken sees it.
  std::atomic<std::uint64_t> published_{0};
  std::array<Published<Entry>, kHistory> history_;
};

}  // namespace rigor

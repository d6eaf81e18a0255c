// What platforms that are told by signals have in common: a table of signals, the same ones as registers
// (signal_registers.h), one lock, and the instants at which they are asked and told, which never decrease.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <numbers>
#include <span>
#include <vector>

#include "sim/platform/platform.h"
#include "sim/platform/signal_registers.h"

namespace rigor {

/// A signal and the step of its register.
struct PlatformSignal {
  const char* name;
  const char* unit;
  bool commanded = false;
  double step = 1e-3;
};

/// The truth that every vehicle tells, in this order, where its table has them one after another.
inline constexpr std::array<PlatformSignal, 7> kTruthSignals{{{"x_m", "m", false, 1e-4},
                                                              {"y_m", "m", false, 1e-4},
                                                              {"z_m", "m", false, 1e-4},
                                                              {"roll_deg", "deg", false, 1e-4},
                                                              {"pitch_deg", "deg", false, 1e-4},
                                                              {"yaw_deg", "deg", false, 1e-4},
                                                              {"velocity_mps", "m/s", false, 1e-4}}};
/// Value `i` of kTruthSignals. `angle_rad`: roll, pitch, yaw.
[[nodiscard]] inline double truth_value(std::size_t i, const BodyState& body,
                                        const std::array<double, 3>& angle_rad) {
  constexpr double kDegPerRad = 180 / std::numbers::pi;
  if (i < 3) return body.T_world_body.position_m[i];
  if (i < 5) return angle_rad[i - 3] * kDegPerRad;
  if (i == 5) return std::remainder(angle_rad[2], 2 * std::numbers::pi) * kDegPerRad;
  return std::hypot(body.velocity_mps[0], body.velocity_mps[1], body.velocity_mps[2]);
}

class SignalPlatform : public Platform {
 public:
  [[nodiscard]] const std::vector<Signal>& signals() const final { return signals_; }
  [[nodiscard]] double read(std::size_t signal, BenchTime t) final {
    const std::lock_guard lock(mutex_);
    go_to(t);
    return value(signal);
  }
  /// Values that are not finite are refused.
  [[nodiscard]] bool write(std::size_t signal, double value, BenchTime t) final {
    if (!std::isfinite(value)) return false;
    const std::lock_guard lock(mutex_);
    go_to(t);
    return take(signal, value);
  }
  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) final {
    return registers_.read(table, address, out, t);
  }
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) final {
    return registers_.write(table, address, in, t);
  }

 protected:
  explicit SignalPlatform(std::span<const PlatformSignal> table)
      : signals_(signals_of(table)), registers_(*this, signals_, steps_of(table)) {}

  // Under the lock:
  virtual void advance(BenchTime t) = 0;
  /// Of the instant `last_`; NaN where there is no such signal.
  [[nodiscard]] virtual double value(std::size_t signal) = 0;
  /// From `last_` on. False: no command.
  [[nodiscard]] virtual bool take(std::size_t signal, double value) = 0;

  mutable std::mutex mutex_;
  BenchTime last_;

 private:
  void go_to(BenchTime t) {
    last_ = std::max(last_, t);
    advance(last_);
  }
  static std::vector<Signal> signals_of(std::span<const PlatformSignal> table) {
    std::vector<Signal> all;
    for (const PlatformSignal& s : table) all.push_back({s.name, s.unit, s.commanded});
    return all;
  }
  static std::vector<double> steps_of(std::span<const PlatformSignal> table) {
    std::vector<double> all;
    for (const PlatformSignal& s : table) all.push_back(s.step);
    return all;
  }

  std::vector<Signal> signals_;
  SignalRegisters registers_;
};

}  // namespace rigor

// Samples that are a few numbers of a kind: what of them is watched.
//
//   imu        specific force [m/s²], angular rate [rad/s], by axis
//   nav_fix    east, north, up [m] of the simulated side's first fix, along its ellipsoid
//   odometry   forward velocity [m/s], turn rate [rad/s], rates of the left and right wheel [rad/s]
//
// The pose of odometry adds up what its wheels do not know: its difference to a simulated side's wanders
// without bounds, and a watch of it would say nothing but that.
#pragma once

#include <span>
#include <vector>

#include "sensor-hal/channel/pair_watch/value_change.h"
#include "sensor-hal/types/sample.h"

namespace rigor::pair_watch {

class KindNumbers {
 public:
  /// Setup. bad_input: another kind.
  [[nodiscard]] static Result<KindNumbers> make(SampleKind kind);
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return values_.parameters(); }

  // One thread at a time; no allocation.
  /// Of one instant. False: samples of another kind, or a receiver without a fix; nothing has happened.
  bool add(double t_s, const Sample& real, const Sample& simulated) noexcept;
  void finish(Estimate& estimate) noexcept { values_.finish(estimate); }

 private:
  static constexpr std::size_t kMost = 6;
  KindNumbers(SampleKind kind, std::size_t count, ValueChange values)
      : kind_(kind), count_(count), values_(std::move(values)) {}
  /// Into the first `count_`; false: there are none.
  bool numbers_of(const Sample& sample, std::span<double, kMost> out) const noexcept;

  SampleKind kind_;
  std::size_t count_;
  ValueChange values_;
  bool has_origin_ = false;
  NavFix origin_;
};

}  // namespace rigor::pair_watch

// What an emulated receiver measures at an instant: place and errors of the sensor's model, and the velocity
// that belongs to it.
#pragma once

#include <memory>

#include "drivers/gnss/receiver_device.h"
#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/models/philox.h"

namespace rigor::gnss {

/// One thread; no allocation.
class MeasuredFix {
 public:
  /// `name` and `seed` key the noise of the velocity.
  MeasuredFix(const DeviceParts& parts, const std::string& name, std::uint64_t seed,
              double velocity_sigma_mps);
  /// Whether there is something that measures places; else why not.
  [[nodiscard]] static Status check(const DeviceParts& parts, const std::string& place);
  /// A measurement that fails is one without a fix.
  [[nodiscard]] Measured at(std::uint64_t index, BenchTime t_capture, BenchTime t_start);

 private:
  [[nodiscard]] bool capture(std::uint64_t index, BenchTime t, BenchTime t_start, NavFix& out);
  std::shared_ptr<SampleProvider> samples_;
  std::shared_ptr<const MotionSource> motion_;
  models::PhiloxKey key_;
  double velocity_sigma_mps_;
  Sample sample_;
};

}  // namespace rigor::gnss

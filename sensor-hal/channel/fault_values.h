// The values of samples that faults change: what they are called, their units, and how a fault gets at them.
//
//   kind          values (the first is meant where none is named)                    unit in keys
//   image         intensity                                                          _dn
//   range_image   range, amplitude                                                   _m, none
//   point_cloud   range (along the ray), remission                                   _m, none
//   registers     by their names                                                     none: the register's own
//   can_frame     a signal of a DBC file, or byte_0 … byte_63                        none: the signal's own
//   pose          x, y, z, roll, pitch, yaw (turned about its own axes)              _m, _rad
//   imu           force_x …, rate_x …, temperature                                   _mps2, _radps, _k
//   nav_fix       east, north, up, satellites                                        _m, none
//   odometry      x, y, yaw, velocity_x, velocity_y, turn_rate, wheel_left, …        _m, _rad, _mps, _radps
//
// One kind more is one case more in each function of fault_values.cpp.
//
// Pixels are rounded and clipped to what their format holds; of YUV only the luma changes; 0 ("none") of
// depth stays. "No return" stays in range images; a range does not become negative. Bytes of a frame count
// modulo 256. Everything but `fault_components`: any thread, no allocation.
#pragma once

#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/models/philox.h"

namespace rigor {

struct FaultComponent {
  std::string name;
  std::string unit;  ///< "m", "dn", …; empty: none in keys
};
/// In the order of FaultReading::component. Empty: nothing of this kind can be changed. Setup context.
[[nodiscard]] std::vector<FaultComponent> fault_components(SampleKind kind,
                                                           const ChannelDescription& description);
/// Whether samples of this kind are many elements (pixels, points), each of which a spike may hit.
[[nodiscard]] bool has_elements(SampleKind kind) noexcept;
/// A register, a pose's coordinate; NaN where the sample has no such value.
[[nodiscard]] double read_component(const Sample& sample, int component) noexcept;

/// One change of one sample: all that is needed to do it on another thread.
struct SampleEdit {
  FaultKind kind = FaultKind::bias;  ///< bias, noise, spike, corrupt
  int component = 0;
  const FrameSignal* signal = nullptr;
  double amount = 0;
  double element_share = 1;
  std::uint32_t flips = 0;
  double keep = 1;
  models::PhiloxKey key;
  std::uint64_t sequence = 0;
};
/// Changes the sample. Its memory is the caller's own.
void apply_edit(const SampleEdit& edit, Sample& sample) noexcept;
/// The same for a command's value: what is to be added.
[[nodiscard]] double edit_amount(const SampleEdit& edit) noexcept;

/// Draws of faults: which samples, how long, which way.
[[nodiscard]] inline double fault_uniform(models::PhiloxKey key, std::uint64_t sequence,
                                          std::uint32_t element) noexcept {
  const auto words = models::draw_words(key, models::NoiseEffect::fault_choice, sequence, element);
  return (static_cast<double>(words[0]) + 0.5) * 0x1p-32;
}
/// Standard normal.
[[nodiscard]] double fault_normal(models::PhiloxKey key, std::uint64_t sequence,
                                  std::uint32_t element) noexcept;

}  // namespace rigor

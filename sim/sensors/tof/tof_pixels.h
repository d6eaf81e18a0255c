// From light to ranges: taps, their noise, phase, unwrapping, limits. Pixel by pixel, independent of each
// other.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_model.h"
#include "sim/sensors/tof/tof_light.h"
#include "sim/sensors/tof/tof_rays.h"
#include "sim/sensors/tof/tof_simulator.h"

namespace rigor::tof {

/// Mean electrons of the taps: [(frequency · 4 + tap) · pixels + pixel].
using TapMeans = std::vector<float>;

/// Taps that an exposure fills.
struct ExposedTaps {
  std::size_t first_frequency = 0, frequencies = 1;
  bool even = true, odd = true;  ///< taps 0 and 2, taps 1 and 3
  bool one = false;              ///< only the tap `tap` of these
  std::size_t tap = 0;
};

/// Taps of exposure m where each has its own instant.
[[nodiscard]] ExposedTaps taps_of(const models::TofModulation& m, int exposure);

class PixelArray {
 public:
  PixelArray(const models::TofModel& model, models::PhiloxKey key);

  /// Mixes the samples' phasors into the means of the exposed taps.
  void expose(const SampleRays& rays, const SampleLight& light, const ExposedTaps& taps);
  /// Reads all taps of capture `index` and works out ranges, before filters.
  void read(std::uint64_t index, TofPicture& picture, bool keep_taps);
  [[nodiscard]] TapMeans& means() { return means_; }

 private:
  struct Sums {
    float active = 0, x = 0, y = 0, ambient = 0;
  };
  /// Ranges as the wiggling's spline has them, into wiggled_m_.
  void add_spline(const std::vector<float>& range_m);
  void phasors(const std::vector<float>& e, const std::vector<float>& true_range_m, std::size_t frequency,
               std::vector<float>& x, std::vector<float>& y);
  void add_parts(const SampleLight& light, std::size_t frequency, const ExposedTaps& taps);
  void put(std::size_t pixel, std::size_t frequency, const ExposedTaps& taps, const Sums& sums);
  void make_fixed_pattern();
  [[nodiscard]] TofPixelStatus range_of(const float* turns, float& range_m) const;

  const models::TofModel model_;
  const models::PhiloxKey key_;
  const std::size_t pixels_;
  std::size_t reference_ = 0;  ///< the highest frequency
  int wraps_ = 1;
  std::vector<float> turns_per_m_;
  float unambiguous_m_ = 0;
  TapMeans means_;
  std::vector<float> x_, y_, bounce_x_, bounce_y_;
  std::vector<float> spline_m_;  ///< coefficients of the wiggling; empty: none
  std::vector<float> wiggled_m_;
  std::vector<float> offset_m_, gain_;  ///< fixed patterns; empty: none
  std::vector<float> drained_;          ///< ambient electrons of a tap that suppression takes; empty: none
};

}  // namespace rigor::tof

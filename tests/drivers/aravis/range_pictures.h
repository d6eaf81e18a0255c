// Range and amplitude that are known by pixel and frame.
#pragma once

#include <cmath>
#include <limits>

#include "sensor-hal/channel/providers.h"

namespace rigor::testing {

/// Millimetre steps from pixel to pixel; every seventh has no return; amplitude 0.5 · (index mod 1000 +
/// 2·pixel).
class RangePictures final : public SampleProvider {
 public:
  static constexpr std::uint32_t kWidth = 64, kHeight = 48;
  [[nodiscard]] Geometry geometry() const override {
    return {SampleKind::range_image, kWidth, kHeight, kWidth * kHeight * 2 * sizeof(float), "tof_optical"};
  }
  static float range_m(std::size_t i, std::uint64_t index) {
    return i % 7 == 3 ? std::numeric_limits<float>::quiet_NaN()
                      : 1.0F + 0.001F * static_cast<float>(i) + 0.01F * static_cast<float>(index);
  }
  static float amplitude(std::size_t i, std::uint64_t index) {
    return 0.5F * static_cast<float>(index + 2 * i);
  }
  [[nodiscard]] Status capture(const Request& r, Sample& s) override {
    auto* f = reinterpret_cast<float*>(s.memory().data());
    constexpr std::size_t kPixels = kWidth * kHeight;
    for (std::size_t i = 0; i < kPixels; ++i)
      f[i] = range_m(i, r.index % 1000), f[kPixels + i] = amplitude(i, r.index % 1000);
    s.info = RangeImageInfo{kWidth, kHeight};
    s.size_bytes = kPixels * 2 * sizeof(float);
    return {};
  }
};

}  // namespace rigor::testing

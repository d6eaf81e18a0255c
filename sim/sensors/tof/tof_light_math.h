// What the parts of LightMeter share: vectors of a ray, air, loops over samples. Internal to sim/sensors/tof.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>

#include "sensor-hal/models/air/air_math.h"
#include "sensor-hal/models/tof/tof_math.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::tof {

inline constexpr float kPi = std::numbers::pi_v<float>;
inline constexpr std::size_t kGrain = 2048;

template <class F>
void each(std::size_t count, const F& f) {
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, kGrain), [&](const auto& range) {
    for (std::size_t i = range.begin(); i < range.end(); ++i) f(i);
  });
}

struct Vector {
  float x, y, z;
};
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator*(Vector a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector vec(const float* v) { return {v[0], v[1], v[2]}; }

/// A material that is not a number reflects nothing.
inline float electrons(float e) { return e >= 0 && e < std::numeric_limits<float>::infinity() ? e : 0; }
/// How far a ray of the second kind starts off its surface: above what a float range is uncertain by.
inline float lift_m(float range_m) { return 1e-4F + 2e-5F * range_m; }
/// What air takes away from light there and back.
class Air {
 public:
  Air(const render::ContentFrame& frame, int band, double eye_z)
      : frame_(frame), band_(static_cast<std::size_t>(band)), eye_z_(eye_z) {
    everywhere_ = static_cast<double>(frame.precipitation.extinction_per_m[band_]);
    for (const render::Haze& haze : frame.hazes) hazy_ = hazy_ || haze.extinction_per_m[band_] > 0;
  }
  [[nodiscard]] bool clear() const { return everywhere_ <= 0 && !hazy_; }
  [[nodiscard]] float transmission(double range_m, double direction_z) const {
    using Fog = models::AirMath<double>;
    double depth = everywhere_ * range_m;
    for (const render::Haze& haze : frame_.hazes)
      depth += static_cast<double>(haze.extinction_per_m[band_]) *
               Fog::air_way_below_m(eye_z_, direction_z, range_m, haze.top_m);
    return static_cast<float>(Fog::air_two_way_transmission(depth));
  }

 private:
  const render::ContentFrame& frame_;
  std::size_t band_;
  double eye_z_, everywhere_ = 0;
  bool hazy_ = false;
};

}  // namespace rigor::tof

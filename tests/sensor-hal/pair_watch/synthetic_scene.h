// What the devices of these tests look at, known to the last bit: light by direction, and a room of columns
// for scans of it. The tests of the watch and those of the calibration of pairs share it.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/sample.h"
#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::pair_watch::testing {

using Vector = std::array<double, 3>;
inline constexpr double kDegree = 3.14159265358979 / 180;

/// v turned by a small rotation vector: exp(w) v, to the second order and of the same length.
inline Vector turned(const Vector& w, const Vector& v) {
  const auto cross = [](const Vector& a, const Vector& b) {
    return Vector{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  };
  const Vector first = cross(w, v), second = cross(w, first);
  Vector out;
  double before = 0, after = 0;
  for (std::size_t k = 0; k < 3; ++k) {
    out[k] = v[k] + first[k] + second[k] / 2;
    before += v[k] * v[k], after += out[k] * out[k];
  }
  for (double& x : out) x *= std::sqrt(before / after);
  return out;
}

// ---- light

/// Of 12 bits, with a lens that bends, shot and read noise.
inline CameraModel camera_of(int width_px, int height_px) {
  CameraModel c;
  c.width_px = width_px, c.height_px = height_px;
  c.fx_px = c.fy_px = 0.9 * width_px;
  c.cx_px = (width_px - 1) / 2.0, c.cy_px = (height_px - 1) / 2.0;
  c.lens.k1 = -0.1, c.lens.k2 = 0.02;
  c.noise.system_gain_dn_per_e = 0.4, c.noise.black_level_dn = 100;
  c.noise.dsnu_e = 0, c.noise.prnu = 0;
  return c;
}

/// DN above black by direction: waves of many lengths, none shorter than some pixels of the tests' cameras.
class Waves {
 public:
  /// Heights are one to three times `height_dn`.
  Waves(Random& r, double height_dn) {
    for (Wave& w : waves_) {
      w.x = 40 * (r.uniform() - 0.5), w.y = 40 * (r.uniform() - 0.5);
      w.phase = 6.28 * r.uniform(), w.height = height_dn * (1 + 2 * r.uniform());
    }
  }
  [[nodiscard]] double light(const Vector& d) const {
    double v = 1400;
    for (const Wave& w : waves_)
      v += w.height * std::sin(w.x * (d[0] / d[2]) + w.y * (d[1] / d[2]) + w.phase);
    return v;
  }

 private:
  struct Wave {
    double x, y, phase, height;
  };
  std::array<Wave, 12> waves_;
};

// ---- ranges

/// 12 by 9 by 4 m with four columns of a square section, by rays.
class Room {
 public:
  explicit Room(Random& r) {
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const double x = -5 + 10 * r.uniform(), y = (i % 2 == 0 ? 2.0 : -3.0) + r.uniform(),
                   w = 0.4 + 0.6 * r.uniform();
      columns_[i] = {{x, y, -1.5}, {x + w, y + w, 2.5}};
    }
  }
  [[nodiscard]] double range(const Vector& o, const Vector& d) const {
    constexpr Vector low{-6, -4.5, -1.5}, high{6, 4.5, 2.5};
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < 3; ++k)
      if (d[k] != 0) best = std::min(best, ((d[k] > 0 ? high[k] : low[k]) - o[k]) / d[k]);
    for (const Box& b : columns_) {
      double from = 0, to = best;
      for (std::size_t k = 0; k < 3; ++k) {
        if (std::abs(d[k]) < 1e-12) {
          if (o[k] < b.low[k] || o[k] > b.high[k]) from = to + 1;
          continue;
        }
        const double s = (b.low[k] - o[k]) / d[k], t = (b.high[k] - o[k]) / d[k];
        from = std::max(from, std::min(s, t)), to = std::min(to, std::max(s, t));
      }
      if (from > 0 && from < to) best = std::min(best, from);
    }
    return best;
  }

 private:
  struct Box {
    Vector low{}, high{};
  };
  std::array<Box, 4> columns_;
};

/// Rings lie 2 degrees apart about the horizon.
struct ScanShape {
  std::uint32_t rings = 1, steps = 541;
  double step_rad = 0.5 * kDegree, first_rad = -135 * kDegree;
};

/// What a scanner has against its simulated side; `beam_m` is the bias of ring `beam` alone. The mount is
/// given in the simulated side's frame.
struct ScanChange {
  double bias_m = 0, scale = 0, noise = 1, lost = 0, beam_m = 0, remission = 0;
  Vector turn_rad{}, move_m{};
  std::uint32_t beam = 3;
};

/// Of both sides alike.
struct ScanNoise {
  double sigma_m = 0.015, remission = 0, lost = 0;  ///< `remission`: relative; `lost`: share of firings
};

inline std::vector<LidarPoint> scan_of(const Room& room, const Vector& at, const ScanShape& shape,
                                       const ScanChange& c, const ScanNoise& noise, Random& random) {
  std::vector<LidarPoint> points;
  points.reserve(std::size_t{shape.steps} * shape.rings);
  const Vector o{at[0] + c.move_m[0], at[1] + c.move_m[1], at[2] + c.move_m[2]};
  for (std::uint32_t k = 0; k < shape.steps; ++k)
    for (std::uint32_t ring = 0; ring < shape.rings; ++ring) {
      const double a = shape.first_rad + k * shape.step_rad;
      const double e = shape.rings == 1 ? 0 : (2.0 * ring - (shape.rings - 1)) * kDegree;
      const Vector d{std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
      const double truth = room.range(o, turned(c.turn_rad, d));
      const double lost = noise.lost + c.lost;
      const bool gone = lost > 0 && random.uniform() < lost;
      const double range = truth * (1 + c.scale) + c.bias_m + (ring == c.beam ? c.beam_m : 0) +
                           noise.sigma_m * c.noise * random.quick_normal();
      double remission = (0.2 + 0.6 * std::abs(std::sin(3 * truth))) * (1 + c.remission);
      if (noise.remission > 0) remission *= 1 + noise.remission * random.quick_normal();
      if (gone) continue;
      points.push_back({static_cast<float>(d[0] * range), static_cast<float>(d[1] * range),
                        static_cast<float>(d[2] * range), static_cast<float>(remission),
                        static_cast<std::int32_t>(k * 50000), static_cast<std::uint16_t>(ring), 0, 0});
    }
  return points;
}

}  // namespace rigor::pair_watch::testing

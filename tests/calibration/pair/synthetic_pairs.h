// Pairs of a device and its twin for tests: both measured in a scene that is known, the device with a changed
// model. Noise is drawn anew for each sample and side.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "calibration/pair/pair_model.h"
#include "sensor-hal/models/camera_model.h"
#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::calibration::testing {

using pair_watch::testing::Random;
using Vector = std::array<double, 3>;
inline constexpr double kDegree = 3.14159265358979 / 180;

/// Recorded samples of both sides.
struct Pairs {
  std::vector<Sample> real, simulated;
  [[nodiscard]] ForEachPair each() const {
    return [this](const TakePair& take) -> Status {
      for (std::size_t i = 0; i < real.size(); ++i) take(real[i], simulated[i]);
      return {};
    };
  }
};

template <class T>
void put(Sample& s, const std::vector<T>& values) {
  s.reserve(values.size() * sizeof(T));
  s.size_bytes = values.size() * sizeof(T);
  std::memcpy(s.memory().data(), values.data(), s.size_bytes);
}

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

// ---- cameras

inline CameraModel small_camera() {
  CameraModel c;
  c.width_px = 128, c.height_px = 96;
  c.fx_px = c.fy_px = 115;
  c.cx_px = 63.5, c.cy_px = 47.5;
  c.lens.k1 = -0.1, c.lens.k2 = 0.02;
  c.noise.system_gain_dn_per_e = 0.4, c.noise.black_level_dn = 100, c.noise.read_noise_e = 12;
  c.noise.dsnu_e = 0, c.noise.prnu = 0;
  return c;
}

struct CameraChange {
  double focal = 0, light = 0, electronics = 0, offset_dn = 0, read_noise = 1, a2 = 0, dirt = 0, cx_px = 0;
  Vector turn_rad{};
};

/// Light by direction: smooth waves, each scene its own.
inline Pairs camera_pairs(const CameraModel& twin, const CameraChange& change, std::size_t count,
                          std::uint64_t seed, std::size_t scenes = 4) {
  Random random(seed);
  struct Wave {
    double x, y, phase, height;
  };
  CameraModel real = twin;
  real.fx_px *= 1 + change.focal, real.fy_px *= 1 + change.focal, real.cx_px += change.cx_px;
  const auto picture = [&](const std::vector<Wave>& waves, const CameraModel& c, const Vector& turn,
                           double a2) {
    std::vector<float> out;
    for (int v = 0; v < c.height_px; ++v)
      for (int u = 0; u < c.width_px; ++u) {
        const OpticalRay d = unproject_ray(c, {double(u), double(v)}).value();
        const Vector w = turned(turn, {d.x, d.y, d.z});
        const double x = w[0] / w[2], y = w[1] / w[2];
        double light = 1400;
        for (const Wave& wave : waves) light += wave.height * std::sin(wave.x * x + wave.y * y + wave.phase);
        out.push_back(static_cast<float>(light * (1 + a2 * (d.x * d.x + d.y * d.y) / (d.z * d.z))));
      }
    return out;
  };
  std::vector<std::vector<float>> ideal_real, ideal_twin;
  for (std::size_t i = 0; i < scenes; ++i) {
    std::vector<Wave> waves;
    for (int k = 0; k < 12; ++k)
      waves.push_back({40 * (random.uniform() - 0.5), 40 * (random.uniform() - 0.5), 6.28 * random.uniform(),
                       50 + 100 * random.uniform()});
    ideal_twin.push_back(picture(waves, twin, {}, 0));
    ideal_real.push_back(picture(waves, real, change.turn_rad, change.a2));
  }
  const double k = twin.noise.system_gain_dn_per_e, black = twin.noise.black_level_dn;
  const auto expose = [&](const std::vector<float>& light, double more_light, double gain, double read,
                          double offset, double dirt) {
    std::vector<std::uint16_t> pixels;
    for (std::size_t i = 0; i < light.size(); ++i) {
      const std::size_t x = i % std::size_t(twin.width_px), y = i / std::size_t(twin.width_px);
      const double part = x < 20 && y < 24 ? 1 - dirt : 1;
      const double electrons = std::max(0.0, double(light[i]) / k * more_light * part);
      const double measured = electrons + std::sqrt(electrons + read * read) * random.quick_normal();
      pixels.push_back(
          static_cast<std::uint16_t>(std::clamp(black + offset + k * gain * measured + 0.5, 0.0, 4095.0)));
    }
    Sample s;
    ImageInfo info;
    info.format = PixelFormat::mono12;
    info.width_px = std::uint32_t(twin.width_px), info.height_px = std::uint32_t(twin.height_px);
    s.info = info;
    put(s, pixels);
    return s;
  };
  Pairs pairs;
  const double read = twin.noise.read_noise_e;
  for (std::size_t i = 0; i < count; ++i) {
    pairs.real.push_back(expose(ideal_real[i % scenes], 1 + change.light, 1 + change.electronics,
                                read * change.read_noise, change.offset_dn, change.dirt));
    pairs.simulated.push_back(expose(ideal_twin[i % scenes], 1, 1, read, 0, 0));
  }
  return pairs;
}

// ---- LiDARs

struct CloudChangePlanted {
  double bias_m = 0, scale = 0, noise = 1, beam_m = 0, remission = 0;
  Vector turn_rad{}, move_m{};
};
struct ScanShape {
  std::uint32_t rings = 1, steps = 541;
  double step_rad = 0.5 * kDegree, first_rad = -135 * kDegree;
};

/// A room of 12 by 9 by 4 m with square columns, by rays.
struct Room {
  struct Box {
    Vector low, high;
  };
  std::vector<Box> columns;
  explicit Room(Random& r) {
    for (int i = 0; i < 4; ++i) {
      const double x = -5 + 10 * r.uniform(), y = (i % 2 == 0 ? 2.0 : -3.0) + r.uniform(),
                   w = 0.4 + 0.6 * r.uniform();
      columns.push_back({{x, y, -1.5}, {x + w, y + w, 2.5}});
    }
  }
  [[nodiscard]] double range(const Vector& o, const Vector& d) const {
    constexpr Vector low{-6, -4.5, -1.5}, high{6, 4.5, 2.5};
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < 3; ++k)
      if (d[k] != 0) best = std::min(best, ((d[k] > 0 ? high[k] : low[k]) - o[k]) / d[k]);
    for (const Box& b : columns) {
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
};

inline Pairs cloud_pairs(const ScanShape& shape, const CloudChangePlanted& c, std::size_t count,
                         std::uint64_t seed, double sigma_m = 0.015) {
  Random random(seed);
  Pairs pairs;
  for (std::size_t i = 0; i < count; ++i) {
    const Room room(random);
    const Vector at{-2 + 4 * random.uniform(), -1 + 2 * random.uniform(), 0};
    for (const bool device : {true, false}) {
      std::vector<LidarPoint> points;
      const CloudChangePlanted change = device ? c : CloudChangePlanted{};
      for (std::uint32_t k = 0; k < shape.steps; ++k)
        for (std::uint32_t ring = 0; ring < shape.rings; ++ring) {
          const double a = shape.first_rad + k * shape.step_rad;
          const double e = shape.rings == 1 ? 0 : (2.0 * ring - (shape.rings - 1)) * kDegree;
          const Vector d{std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
          const Vector o{at[0] + change.move_m[0], at[1] + change.move_m[1], at[2] + change.move_m[2]};
          const double truth = room.range(o, turned(change.turn_rad, d));
          const double range = truth * (1 + change.scale) + change.bias_m + (ring == 3 ? change.beam_m : 0) +
                               sigma_m * change.noise * random.quick_normal();
          const double remission = (0.2 + 0.6 * std::abs(std::sin(3 * truth))) * (1 + change.remission) *
                                   (1 + 0.02 * random.quick_normal());
          points.push_back({float(d[0] * range), float(d[1] * range), float(d[2] * range), float(remission),
                            std::int32_t(k * 50000), std::uint16_t(ring), 0, 0});
        }
      Sample s;
      s.info = PointCloudInfo{std::uint32_t(points.size())};
      put(s, points);
      (device ? pairs.real : pairs.simulated).push_back(std::move(s));
    }
  }
  return pairs;
}

}  // namespace rigor::calibration::testing

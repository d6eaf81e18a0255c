// Pairs of a device and its simulated side for tests: both measured in a scene that is known, the device with
// a changed model. Noise is drawn anew for each sample and side.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "calibration/pair/pair_model.h"
#include "tests/sensor-hal/pair_watch/synthetic_scene.h"

namespace rigor::calibration::testing {

using pair_watch::testing::kDegree;
using pair_watch::testing::Random;
using pair_watch::testing::Room;
using pair_watch::testing::ScanChange;
using pair_watch::testing::ScanShape;
using pair_watch::testing::turned;
using pair_watch::testing::Vector;
using pair_watch::testing::Waves;

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

// ---- cameras

inline CameraModel small_camera() {
  CameraModel c = pair_watch::testing::camera_of(128, 96);
  c.noise.read_noise_e = 12;
  return c;
}

struct CameraChange {
  double focal = 0, light = 0, electronics = 0, offset_dn = 0, read_noise = 1, a2 = 0, dirt = 0, cx_px = 0;
  Vector turn_rad{};
};

/// Light by direction: smooth waves, each scene its own.
inline Pairs camera_pairs(const CameraModel& simulated, const CameraChange& change, std::size_t count,
                          std::uint64_t seed, std::size_t scenes = 4) {
  Random random(seed);
  CameraModel real = simulated;
  real.fx_px *= 1 + change.focal, real.fy_px *= 1 + change.focal, real.cx_px += change.cx_px;
  const auto picture = [&](const Waves& waves, const CameraModel& c, const Vector& turn, double a2) {
    std::vector<float> out;
    for (int v = 0; v < c.height_px; ++v)
      for (int u = 0; u < c.width_px; ++u) {
        const OpticalRay d = unproject_ray(c, {double(u), double(v)}).value();
        const double light = waves.light(turned(turn, {d.x, d.y, d.z}));
        out.push_back(static_cast<float>(light * (1 + a2 * (d.x * d.x + d.y * d.y) / (d.z * d.z))));
      }
    return out;
  };
  std::vector<std::vector<float>> ideal_real, ideal_simulated;
  for (std::size_t i = 0; i < scenes; ++i) {
    const Waves waves(random, 50);
    ideal_simulated.push_back(picture(waves, simulated, {}, 0));
    ideal_real.push_back(picture(waves, real, change.turn_rad, change.a2));
  }
  const double k = simulated.noise.system_gain_dn_per_e, black = simulated.noise.black_level_dn;
  const auto expose = [&](const std::vector<float>& light, double more_light, double gain, double read,
                          double offset, double dirt) {
    std::vector<std::uint16_t> pixels;
    for (std::size_t i = 0; i < light.size(); ++i) {
      const std::size_t x = i % std::size_t(simulated.width_px), y = i / std::size_t(simulated.width_px);
      const double part = x < 20 && y < 24 ? 1 - dirt : 1;
      const double electrons = std::max(0.0, double(light[i]) / k * more_light * part);
      const double measured = electrons + std::sqrt(electrons + read * read) * random.quick_normal();
      pixels.push_back(
          static_cast<std::uint16_t>(std::clamp(black + offset + k * gain * measured + 0.5, 0.0, 4095.0)));
    }
    Sample s;
    ImageInfo info;
    info.format = PixelFormat::mono12;
    info.width_px = std::uint32_t(simulated.width_px), info.height_px = std::uint32_t(simulated.height_px);
    s.info = info;
    put(s, pixels);
    return s;
  };
  Pairs pairs;
  const double read = simulated.noise.read_noise_e;
  for (std::size_t i = 0; i < count; ++i) {
    pairs.real.push_back(expose(ideal_real[i % scenes], 1 + change.light, 1 + change.electronics,
                                read * change.read_noise, change.offset_dn, change.dirt));
    pairs.simulated.push_back(expose(ideal_simulated[i % scenes], 1, 1, read, 0, 0));
  }
  return pairs;
}

// ---- LiDARs

inline Pairs cloud_pairs(const ScanShape& shape, const ScanChange& c, std::size_t count, std::uint64_t seed,
                         double sigma_m = 0.015, bool standing = false) {
  Random random(seed);
  Pairs pairs;
  Room room(random);
  Vector at{};
  for (std::size_t i = 0; i < count; ++i) {
    if (i > 0 && !standing) room = Room(random);
    if (i == 0 || !standing) at = {-2 + 4 * random.uniform(), -1 + 2 * random.uniform(), 0};
    for (const bool device : {true, false}) {
      const std::vector<LidarPoint> points =
          scan_of(room, at, shape, device ? c : ScanChange{}, {sigma_m, 0.02}, random);
      Sample s;
      s.info = PointCloudInfo{std::uint32_t(points.size())};
      put(s, points);
      (device ? pairs.real : pairs.simulated).push_back(std::move(s));
    }
  }
  return pairs;
}

}  // namespace rigor::calibration::testing

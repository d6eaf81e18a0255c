// A LiDAR in a closed room, measured by the simulator's own formulas (lidar.glsl.h) and draws: truth for
// fits.
#pragma once

#include <cmath>
#include <functional>
#include <vector>

#include "calibration/lidar/lidar_fit.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/philox.h"

namespace rigor::calibration::test {

struct Wall {
  Eigen::Vector3d normal;  ///< unit
  double distance_m, reflectance;
};

inline std::vector<Wall> room() {
  return {{Eigen::Vector3d(1, 0.1, 0.02).normalized(), 4.2, 0.9},
          {Eigen::Vector3d(-1, 0.05, 0.01).normalized(), 5.5, 0.5},
          {Eigen::Vector3d(0.03, 1, -0.02).normalized(), 3.1, 0.25},
          {Eigen::Vector3d(0.02, -1, 0.03).normalized(), 6.8, 0.12}};
}

/// A VLP-16 with columns of `step_deg`.
inline models::LidarModel sixteen_beams(double step_deg = 1) {
  models::LidarModel m;
  const double elevations[] = {-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15};
  m.scan.beams.clear();
  for (const double e : elevations) {
    models::LidarBeam b;
    b.elevation_rad = e * M_PI / 180;
    m.scan.beams.push_back(b);
  }
  m.scan.columns = static_cast<std::uint32_t>(std::lround(360 / step_deg));
  m.scan.column_period_s = 1e-4;
  m.scan.rotation_radps = step_deg * M_PI / 180 / 1e-4;
  m.range = {.min_m = 0.5, .max_m = 100, .step_m = 0.002};
  m.noise = {.floor_m = 0, .scale_m = 0.0063, .offset = 0.17, .exponent = 1};
  m.remission = {.scale = 100, .retro_scale = 3, .noise = 0.02, .maximum = 255, .step = 1};
  return m;
}

struct Truth {
  models::LidarModel model = sixteen_beams();
  std::vector<Wall> walls = room();
  double outliers = 0;  ///< share of returns that are anywhere
  double from_rad = -M_PI, to_rad = M_PI;
  /// By how much walls are nearer or farther than their planes in a direction, m; empty: even.
  std::function<double(std::uint16_t beam, double azimuth_rad)> uneven_m{};
};

/// `scans` scans. `stated`: the sensor model that the azimuths and elevations of the returns are told by is
/// the caller's affair: returns hold beam and rotor alone.
inline LidarReturns measure(const Truth& t, int scans, std::uint64_t seed) {
  using Math = models::LidarMath<double>;
  using Draws = models::NoiseMath<double>;
  const auto normal = [](std::uint32_t w) { return Draws::normal_quantile(Draws::unit_from_bits(w)); };
  const models::PhiloxKey key = models::channel_key(seed, models::channel_id_from_name("lidar"));
  LidarReturns out;
  out.scans = static_cast<std::uint32_t>(scans);
  const models::LidarModel& m = t.model;
  for (int s = 0; s < scans; ++s) {
    std::uint32_t firing = 0;
    for (std::uint32_t c = 0; c < m.scan.columns; ++c)
      for (std::uint16_t b = 0; b < m.scan.beams.size(); ++b, ++firing) {
        const double azimuth = std::remainder(m.scan.azimuth_rad(c), 2 * M_PI);
        if (azimuth < t.from_rad || azimuth > t.to_rad) continue;
        const models::LidarAim aim = models::rotor_aim(m.scan.beams[b], azimuth);
        const Eigen::Vector3d u(aim.direction.data()), o(aim.origin_m.data());
        double range = 1e9, cosine = 0, rho = 0;
        for (const Wall& w : t.walls) {
          const double across = w.normal.dot(u);
          if (across < 1e-6) continue;
          const double r = (w.distance_m - w.normal.dot(o)) / across;
          if (r > 0 && r < range) range = r, cosine = across, rho = w.reflectance;
        }
        if (range > m.range.max_m) continue;
        if (t.uneven_m) range += t.uneven_m(b, azimuth);
        const double e = Math::lidar_surface_remission(cosine, rho, 0, 1, 0, 1);
        if (e < m.detection.minimum_remission) continue;
        const auto words = models::draw_words(key, models::NoiseEffect::lidar_echo,
                                              static_cast<std::uint64_t>(s), firing * 2);
        double measured =
            range +
            Math::lidar_range_error_m(range, m.range.scale, m.scan.beams[b].range_bias_m + m.range.bias_m,
                                      m.range.remission_bias_m, e, m.range.incidence_bias_m, cosine) +
            normal(words[0]) * Math::lidar_range_sigma_m(e, m.noise.floor_m, m.noise.scale_m, m.noise.offset,
                                                         m.noise.exponent);
        if (Draws::unit_from_bits(words[2]) < t.outliers)
          measured = 0.6 + 11 * Draws::unit_from_bits(words[3]);
        measured = Math::lidar_quantise(measured, m.range.step_m);
        double units =
            Math::lidar_remission_units(e, range, m.remission.scale, m.remission.retro_scale, 0, 0) *
            m.scan.beams[b].remission_gain * (1 + m.remission.noise * normal(words[1]));
        units = std::min(Math::lidar_quantise(std::max(0.0, units), m.remission.step), m.remission.maximum);
        out.all.push_back({static_cast<float>(measured), static_cast<float>(units),
                           static_cast<float>(azimuth), b, static_cast<std::uint32_t>(s)});
      }
  }
  return out;
}

}  // namespace rigor::calibration::test

// Pictures of even light in known electrons, and the numbers that come out.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "sim/sensors/camera/sensor_stage.h"

namespace rigor::test {

/// A sensor without any error, 12 bits, K = 0.25 DN/e-, whose red band gives electrons.
inline CameraModel quiet_camera(int width = 320, int height = 240) {
  CameraModel m;
  m.width_px = width;
  m.height_px = height;
  m.cx_px = 0.5 * (width - 1);
  m.cy_px = 0.5 * (height - 1);
  m.fx_px = m.fy_px = 400;
  m.noise = {};
  m.noise.system_gain_dn_per_e = 0.25;
  m.noise.full_well_e = 15000;
  m.noise.read_noise_e = m.noise.dark_current_e_per_s = m.noise.dsnu_e = m.noise.prnu = 0;
  m.noise.shot_noise = false;
  m.noise.adc_bits = 12;
  m.optics.mono_efficiency = {0.5, 0, 0, 0};
  m.optics.colour_efficiency = {{{0.5, 0, 0, 0}, {0, 0.5, 0, 0}, {0, 0, 0.5, 0}}};
  return m;
}

/// Radiance of `band` that gives so many electrons in `exposure_s`.
inline float radiance_for(const CameraModel& m, double electrons, double exposure_s, std::size_t band = 0) {
  std::array<double, 4> one{};
  one[band] = 0.5;
  return static_cast<float>(electrons / exposure_s / m.electron_rate_per_radiance(one)[band]);
}

inline OpticsPicture even_picture(const CameraModel& m, double electrons, double exposure_s = 0.01) {
  OpticsPicture p{m.width_px, m.height_px, {}};
  p.radiance.assign(4 * static_cast<std::size_t>(m.width_px) * m.height_px, 0.0f);
  const float red = radiance_for(m, electrons, exposure_s);
  for (std::size_t i = 0; i < p.radiance.size(); i += 4) p.radiance[i] = red;
  return p;
}

/// Lights, edges and ramps of every colour, the same each time.
inline OpticsPicture busy_picture(const CameraModel& m, double electrons = 4000, double exposure_s = 0.01) {
  OpticsPicture p{m.width_px, m.height_px, {}};
  p.radiance.resize(4 * static_cast<std::size_t>(m.width_px) * m.height_px);
  for (int y = 0; y < m.height_px; ++y)
    for (int x = 0; x < m.width_px; ++x)
      for (std::size_t b = 0; b < 4; ++b) {
        const std::uint32_t hash = (static_cast<std::uint32_t>(x / 5) * 73856093u) ^
                                   (static_cast<std::uint32_t>(y / 7) * 19349663u) ^
                                   (static_cast<std::uint32_t>(b) * 83492791u);
        double level = 0.02 + 0.5 * x / m.width_px + 0.5 * ((hash * 2654435761u) >> 24) / 255.0;
        if (hash % 97 == 0) level *= 30;
        p.radiance[4 * (static_cast<std::size_t>(y) * m.width_px + x) + b] =
            radiance_for(m, level * electrons, exposure_s);
      }
  return p;
}

inline std::unique_ptr<SensorStage> make_stage(const CameraModel& m, bool noise = true,
                                               std::uint64_t seed = 1) {
  auto made = SensorStage::create({.name = "camera", .model = m, .seed = seed, .noise = noise});
  EXPECT_TRUE(made) << made.error().text();
  return made ? std::move(*made) : nullptr;
}

inline std::vector<std::byte> shoot(SensorStage& stage, const OpticsPicture& picture, SensorStageRequest q,
                                    int width, int height) {
  std::vector<std::byte> out(
      image_bytes(q.format, static_cast<std::size_t>(width), static_cast<std::size_t>(height)));
  const Status s = stage.expose(q, picture, out);
  EXPECT_TRUE(s) << s.error().text();
  return out;
}

/// Digital numbers at the converter's bits.
inline std::vector<int> numbers(SensorStage& stage, const OpticsPicture& picture, std::uint64_t index = 0,
                                double exposure_s = 0.01, double gain_db = 0) {
  const auto bytes = shoot(
      stage, picture,
      {.capture_index = index, .exposure_s = exposure_s, .gain_db = gain_db, .format = PixelFormat::mono16},
      picture.width_px, picture.height_px);
  std::vector<int> out(bytes.size() / 2);
  for (std::size_t i = 0; i < out.size(); ++i)
    out[i] = std::to_integer<int>(bytes[2 * i]) | std::to_integer<int>(bytes[2 * i + 1]) << 8;
  return out;
}

struct Moments {
  double mean = 0, variance = 0;
};
template <class T>
Moments moments(const std::vector<T>& v) {
  double sum = 0;
  for (const T x : v) sum += static_cast<double>(x);
  const double mean = sum / static_cast<double>(v.size());
  double squares = 0;
  for (const T x : v) squares += (static_cast<double>(x) - mean) * (static_cast<double>(x) - mean);
  return {mean, squares / static_cast<double>(v.size() - 1)};
}

}  // namespace rigor::test

// A time-of-flight camera before a plane, by the simulator's own formulas: sensor-hal/models/tof.
#pragma once

#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "calibration/tof/tof_frames.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_math.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

struct SyntheticTof {
  models::TofModel model;
  double offset_m = 0;           ///< of all pixels
  double amplitude_error_m = 0;  ///< k of k/A, metres times electrons
  double remission = 0.8;
  double distance_sigma_m = 0;  ///< of where the plane really stands
  double tilt = 0;              ///< of the plane, slope along x and y
};

/// Like an SR4000, in a small picture of the same field of view.
inline models::TofModel small_tof(int width_px = 24, int height_px = 18) {
  models::TofModel m;
  m.width_px = width_px, m.height_px = height_px;
  m.fx_px = m.fy_px = 250.0 * width_px / 176;
  m.cx_px = 0.5 * (width_px - 1), m.cy_px = 0.5 * (height_px - 1);
  m.modulation.frequencies_hz = {30e6};
  m.modulation.contrast = 0.5;
  m.modulation.waveform = models::TofWaveform::harmonics;
  m.modulation.harmonics = {0.03, 0.01, 0, 0};
  m.modulation.integration_time_s = 8.5e-3;
  m.illumination.radiant_intensity_w_per_sr = 0.375;
  m.optics.transmission = 0.85;
  m.pixel.pitch_m = 40e-6;
  m.pixel.fill_factor = 0.5;
  m.pixel.quantum_efficiency = 0.4;
  m.pixel.full_well_e = 4e5;
  m.pixel.read_noise_e = 100;
  m.pixel.range_offset_sigma_m = 3e-3;
  return m;
}

/// `frames` pictures for each distance, with the names `NAME scene S frame F`. The camera, its fixed pattern,
/// is that of the seed; another recording of it begins with another capture.
inline std::vector<TofFrame> record_plane(const SyntheticTof& t, const std::vector<double>& distances_m,
                                          int frames, std::uint64_t seed, const std::string& name = "plane",
                                          std::uint64_t first_capture = 0) {
  using Math = models::TofMath<double>;
  const models::TofModel& m = t.model;
  const models::PhiloxKey key = models::channel_key(seed, 7);
  std::mt19937_64 random(seed * 977 + 5 + first_capture);
  std::normal_distribution<double> normal;
  const double turns_per_m = 2 * m.modulation.frequencies_hz.front() / 299792458.0;
  const auto& a = m.modulation.harmonics;
  const bool sine = m.modulation.waveform == models::TofWaveform::sine;
  const auto pixels = static_cast<std::size_t>(m.width_px) * static_cast<std::size_t>(m.height_px);
  const CameraModel camera = m.camera();
  std::vector<OpticalRay> rays;
  for (std::size_t p = 0; p < pixels; ++p)
    rays.push_back(*unproject_ray(camera, {static_cast<double>(p % static_cast<std::size_t>(m.width_px)),
                                           static_cast<double>(p / static_cast<std::size_t>(m.width_px))}));
  const auto spline_error = [&](double range_m) {
    const auto& w = m.range_error.wiggling;
    if (w.coefficients_m.empty()) return 0.0;
    double first = 0, b[4], sum = 0;
    Math::tof_spline(range_m, w.from_m, w.to_m, static_cast<double>(w.coefficients_m.size() - 3), first, b[0],
                     b[1], b[2], b[3]);
    for (std::size_t k = 0; k < 4; ++k) sum += b[k] * w.coefficients_m[static_cast<std::size_t>(first) + k];
    return sum;
  };
  std::vector<TofFrame> out;
  std::uint64_t capture = first_capture;
  for (std::size_t s = 0; s < distances_m.size(); ++s) {
    const double at = distances_m[s] + t.distance_sigma_m * normal(random);
    for (int f = 0; f < frames; ++f, ++capture) {
      TofFrame frame;
      frame.name = name + " scene " + std::to_string(s) + " frame " + std::to_string(f);
      frame.width_px = m.width_px, frame.height_px = m.height_px;
      frame.distance_m = distances_m[s];
      frame.t_s = 0.1 * static_cast<double>(capture);
      for (std::size_t p = 0; p < pixels; ++p) {
        const OpticalRay& ray = rays[p];
        const double n = std::hypot(ray.x, ray.y, ray.z);
        const double range = at / ((ray.z + t.tilt * ray.x + 0.5 * t.tilt * ray.y) / n);
        const double e = m.active_electrons(range, t.remission);
        double x = 0, y = 0, d[4], saturated = 0, full = 0;
        Math::tof_phasor((range + spline_error(range)) * turns_per_m, 0, sine ? 0 : a[0], sine ? 0 : a[1],
                         sine ? 0 : a[2], sine ? 0 : a[3], 1, 1, x, y);
        Math::tof_taps(e, e * x, e * y, m.modulation.contrast, 0, d[0], d[1], d[2], d[3]);
        const auto element = static_cast<std::uint32_t>(p);
        const auto shot = models::draw_words(key, models::NoiseEffect::tof_shot, capture, element);
        const auto read = models::draw_words(key, models::NoiseEffect::tof_read, capture, element);
        const auto fixed = models::draw_words(key, models::NoiseEffect::tof_fixed_pattern, 0, element);
        for (std::size_t k = 0; k < 4; ++k) {
          const double arrived = Math::poisson_quantile(d[k], Math::unit_from_bits(shot[k]));
          d[k] = Math::tof_read_tap(arrived, 0, m.pixel.full_well_e, m.pixel.read_noise_e,
                                    Math::normal_quantile(Math::unit_from_bits(read[k])), 0, full);
          saturated += full;
        }
        double turns = 0, amplitude = 0;
        Math::tof_demodulate(d[0], d[1], d[2], d[3], turns, amplitude);
        double r = turns / turns_per_m +
                   Math::tof_range_error(t.offset_m + m.range_error.offset_m,
                                         t.amplitude_error_m + m.range_error.amplitude_error_m_e, amplitude) +
                   m.pixel.range_offset_sigma_m * Math::normal_quantile(Math::unit_from_bits(fixed[0]));
        const double wrap = m.unambiguous_range_m();
        r -= wrap * std::floor(r / wrap);
        frame.range_m.push_back(saturated > 0 ? std::numeric_limits<float>::quiet_NaN()
                                              : static_cast<float>(r));
        frame.amplitude.push_back(static_cast<float>(amplitude));
      }
      out.push_back(std::move(frame));
    }
  }
  return out;
}

}  // namespace rigor::calibration

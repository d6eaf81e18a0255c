#include "calibration/tof/saturation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::calibration {

FitResult full_well(const TofScenes& scenes, const models::TofModel& model, double contrast) {
  FitResult r;
  const CameraModel camera = model.camera();
  const double turns_per_m = 2 * model.modulation.frequencies_hz.front() / 299792458.0;
  const auto& mod = model.modulation;
  const bool harmonics = mod.waveform == models::TofWaveform::harmonics;
  // Electrons of the fullest tap of a pixel whose amplitude is A: E/2 (1 + C·max(|x|, |y|)), A = E·C/2·|(x,
  // y)|.
  const auto fullest = [&](double amplitude, double range_m) {
    double x = 1, y = 0;
    models::TofMath<double>::tof_phasor(
        range_m * turns_per_m, mod.waveform == models::TofWaveform::triangle ? 1 : 0,
        harmonics ? mod.harmonics[0] : 0, harmonics ? mod.harmonics[1] : 0, harmonics ? mod.harmonics[2] : 0,
        harmonics ? mod.harmonics[3] : 0, 1, 1, x, y);
    return amplitude / std::hypot(x, y) * (1 / contrast + std::max(std::abs(x), std::abs(y)));
  };
  std::vector<double> measured, lost;
  std::size_t ranges_lost = 0;
  const auto width = static_cast<std::size_t>(scenes.width_px);
  for (std::size_t p = 0; p < scenes.pixels(); ++p) {
    const auto ray = unproject_ray(camera, {static_cast<double>(p % width), static_cast<double>(p / width)});
    if (!ray || !(ray->z > 0.05)) continue;
    const double slant = std::hypot(ray->x, ray->y, ray->z) / ray->z;
    std::vector<double> strength;  // amplitude times range²
    struct Gone {
      double range_m;
      std::size_t times;
    };
    std::vector<Gone> gone;
    double nearest = 1e300;
    for (const TofScene& s : scenes.scenes) {
      if (!std::isfinite(s.distance_m)) continue;
      const double range = s.distance_m * slant;
      double sum = 0, seen = 0;
      std::size_t without = 0;
      for (const std::size_t i : s.frames) {
        const TofFrame& f = scenes.frames[i];
        if (f.amplitude.empty()) continue;
        if (std::isfinite(f.range_m[p]) && f.amplitude[p] > 0)
          sum += f.amplitude[p], seen += 1;
        else
          ++without;
      }
      // Of a pixel that is lost in some frames, those that are left were chosen by their noise.
      if (seen > 0 && without == 0) {
        measured.push_back(fullest(sum / seen, range));
        strength.push_back(sum / seen * range * range);
        nearest = std::min(nearest, range);
      }
      if (seen == 0 && without > 0) gone.push_back({range, without});
    }
    if (strength.empty()) continue;
    std::nth_element(strength.begin(), strength.begin() + static_cast<std::ptrdiff_t>(strength.size() / 2),
                     strength.end());
    const double typical = strength[strength.size() / 2];
    // Only nearer than where there was a range: what is lost farther away is lost to the dark.
    for (const Gone& g : gone)
      if (g.range_m < nearest) {
        lost.push_back(fullest(typical / (g.range_m * g.range_m), g.range_m));
        ranges_lost += g.times;
      }
  }
  if (measured.empty()) return r;
  std::sort(measured.begin(), measured.end());
  std::sort(lost.begin(), lost.end());
  // A thousandth from the end, so that a single wrong pixel does not say where the well is.
  const double most = measured[static_cast<std::size_t>(0.999 * static_cast<double>(measured.size() - 1))];
  if (lost.size() < 10) {
    r.not_identifiable.emplace_back(
        "full_well_e",
        fmt::format("no pixel was saturated: more than {:.3g} electrons; record a bright surface "
                    "nearer to the camera",
                    most));
    return r;
  }
  const double least = lost[static_cast<std::size_t>(0.001 * static_cast<double>(lost.size() - 1))];
  // Anywhere between the two; and the noise of a tap blurs both.
  const double value = 0.5 * (most + least),
               noise2 = value + model.pixel.read_noise_e * model.pixel.read_noise_e,
               sigma = std::sqrt((least - most) * (least - most) / 12 + noise2);
  r.parameters.push_back({"full_well_e", value, sigma, value});
  r.covariance = Eigen::MatrixXd::Constant(1, 1, std::pow(r.parameters[0].sigma, 2));
  r.warnings.push_back(
      fmt::format("{} ranges are missing where the light was strongest: taken as saturated and "
                  "not used",
                  ranges_lost));
  return r;
}

}  // namespace rigor::calibration

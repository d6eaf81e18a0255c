#include "calibration/tof/saturation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

FitResult full_well(const TofScenes& scenes, const models::TofModel& model, double contrast) {
  FitResult r;
  const CameraModel camera = model.camera();
  const double turns_per_m = 2 * model.modulation.frequencies_hz.front() / 299792458.0;
  const auto fullest = [&](double amplitude, double range_m) {
    const double phase = 2 * std::numbers::pi * range_m * turns_per_m;
    return amplitude * (1 / contrast + std::max(std::abs(std::cos(phase)), std::abs(std::sin(phase))));
  };
  std::vector<double> measured, lost;
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
      std::size_t without = 0;
      for (const std::size_t i : s.frames) {
        const TofFrame& f = scenes.frames[i];
        if (f.amplitude.empty()) continue;
        if (std::isfinite(f.range_m[p]) && f.amplitude[p] > 0) {
          measured.push_back(fullest(f.amplitude[p], range));
          strength.push_back(f.amplitude[p] * range * range);
          nearest = std::min(nearest, range);
        } else {
          ++without;
        }
      }
      if (without > 0) gone.push_back({range, without});
    }
    if (strength.empty()) continue;
    std::nth_element(strength.begin(), strength.begin() + static_cast<std::ptrdiff_t>(strength.size() / 2),
                     strength.end());
    const double typical = strength[strength.size() / 2];
    // Only nearer than where there was a range: what is lost farther away is lost to the dark.
    for (const Gone& g : gone)
      if (g.range_m < nearest)
        lost.insert(lost.end(), g.times, fullest(typical / (g.range_m * g.range_m), g.range_m));
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
  const double value = 0.5 * (most + least), sigma = std::abs(least - most) / std::sqrt(12.0);
  r.parameters.push_back({"full_well_e", value, std::max(sigma, 1e-4 * value), value});
  r.covariance = Eigen::MatrixXd::Constant(1, 1, std::pow(r.parameters[0].sigma, 2));
  r.warnings.push_back(
      fmt::format("{} ranges are missing where the light was strongest: taken as saturated and "
                  "not used",
                  lost.size()));
  return r;
}

}  // namespace rigor::calibration

// The `calibration:` section that a fitted model carries: where its values come from and how sure they are.
// Written by `rigor calibrate`, read by the loaders of all sensor models, used to draw other devices of the
// same kind.
//
//   intrinsics: { fx_px: 533.13, … }
//   calibration:
//     version: 1
//     kind: camera
//     model: opencv4
//     parameters:
//       - { name: fx_px, value: 533.13, sigma: 0.39, path: intrinsics.fx_px, scale: 1 }
//     covariance: [0.15, 0.14, 0.16, …]              # lower triangle, row by row
//     residuals: { unit: px, count: 1404, rejected: 0, rms: 0.13, median_absolute: …, p95_absolute: …,
//     largest: … } validity: { board_distance_m: [8.2, 21.3] } recordings: [{ file: left01.jpg, sha256: … }]
//     not_identifiable: { read_noise_e: "…" }
//     warnings: []
//     interrupted: false
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

struct CalibrationSection {
  struct Parameter {
    std::string name;
    double value = 0, sigma = 0;
    std::string path;  ///< of the sensor model's key; empty: the sensor model has none for it
    double scale = 1;  ///< sensor model's value = scale · value
  };
  struct Recording {
    std::string file, sha256;
  };
  std::string kind, model;
  std::vector<Parameter> parameters;
  std::vector<double> covariance;  ///< lower triangle, row by row: n(n + 1)/2
  std::string residual_unit;
  double residual_rms = 0;
  std::map<std::string, std::array<double, 2>> validity;
  std::vector<Recording> recordings;
  std::map<std::string, std::string> not_identifiable;
  std::vector<std::string> warnings;
  bool interrupted = false;

  /// Cov(i, j).
  [[nodiscard]] double covariance_of(std::size_t i, std::size_t j) const {
    return i >= j ? covariance[i * (i + 1) / 2 + j] : covariance[j * (j + 1) / 2 + i];
  }
};

/// Reads and checks the section of a sensor model; empty `kind` where there is none. Throws ConfigError.
[[nodiscard]] CalibrationSection read_calibration(const ConfigNode& sensor_model);

/// A device drawn from the covariance: what to put in place of the sensor model's values. The same for the
/// same seed and section. bad_input where the covariance is none (not positive semi-definite).
[[nodiscard]] Result<std::vector<ConfigOverride>> draw_parameters(const CalibrationSection& section,
                                                                  std::uint64_t seed);

/// A sensor model, or the device number `draw` of those that its covariance describes (0: the sensor model
/// itself). not_found, bad_input (also where there is nothing to draw from).
[[nodiscard]] Result<ConfigNode> load_sensor_model(const std::filesystem::path& file, std::uint64_t draw = 0);

}  // namespace rigor

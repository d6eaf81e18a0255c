// A fit as files: JSON for machines, and the sensor model that a simulated channel reads.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <utility>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"

namespace rigor::calibration {

struct RecordingHash {
  std::string file, sha256;
};

/// `parameters` by name with value and sigma (null: the data do not say), `residuals`, `rejected`, `models`,
/// `weak_directions`, `not_identifiable`, `validity`, `warnings`, `interrupted`.
[[nodiscard]] nlohmann::json to_json(const FitResult& fit);

/// How the fit becomes a sensor model.
struct SensorModelRecipe {
  std::string kind;  ///< camera, lidar, tof
  std::string base;  ///< YAML that the values go into; empty: a new sensor model
  /// Keys to set, by path (`intrinsics.fx_px`), in order; the value is YAML (`1.5`, `[1, 2]`). Lists are set
  /// whole.
  std::vector<std::pair<std::string, std::string>> set;
  std::vector<std::string> remove;  ///< keys of the base that the new values replace
  /// Which key a parameter stands for, and by what its value is multiplied there; items of lists by index
  /// (`beams.bias_mm.3`). Parameters without one are kept in the section alone.
  struct Place {
    std::string parameter, path;
    double scale = 1;
  };
  std::vector<Place> places;
};

/// The sensor model with its section `calibration` (sensor-hal/models/calibration_section.h). Parameters
/// without a finite uncertainty are not in the covariance: they are listed as not identifiable. bad_input
/// where the base is no map or a path runs through a value.
[[nodiscard]] Result<std::string> sensor_model_yaml(const SensorModelRecipe& recipe, const FitResult& fit,
                                                    const std::vector<RecordingHash>& recordings);

/// A number that reads back as the same double.
[[nodiscard]] std::string exact_text(double value);

}  // namespace rigor::calibration

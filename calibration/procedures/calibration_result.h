// What all calibrations have in common: what they read, and what they give.
//
//   CameraCalibrationOptions options;
//   options.inputs = {"pictures"};
//   options.target = "chessboard:9x6:0.025";
//   const auto result = calibrate_camera(options);           // Result<CalibrationResult>
//   result->fit.find("fx_px")->sigma;  result->fit.covariance;
//   const auto files = save_sensor_model(*result, "left.yaml");
//
// Each `calibrate_X` reads files and writes none, unless its header says otherwise. Any thread; allocates;
// uses all cores for seconds to minutes. A stop that is requested ends it early with the best fit so far,
// marked as interrupted. Progress is shown on stderr, unless set_progress_format(ProgressFormat::none) was
// called. Errors name the file or the option (`--base`, as the command calls it), what was expected and what
// came.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <utility>
#include <vector>

#include "calibration/core/figures.h"
#include "calibration/core/fit_output.h"
#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor {

struct CalibrationInputs {
  std::vector<std::filesystem::path> inputs;  ///< files and folders; each calibration says of which kinds
  std::filesystem::path base;  ///< sensor model that the fitted values go into; empty: a new one
  std::string model = "auto";  ///< the smallest that the data support; or a model by its name
  std::string channel;         ///< of recordings; empty: the only one of its kind
};

/// A JSON object as a value, for headers that others include.
class CalibrationDetails {
 public:
  CalibrationDetails();
  CalibrationDetails(const CalibrationDetails& other);
  CalibrationDetails(CalibrationDetails&& other);
  CalibrationDetails& operator=(CalibrationDetails other);
  ~CalibrationDetails();
  [[nodiscard]] nlohmann::json& json() { return *json_; }
  [[nodiscard]] const nlohmann::json& json() const { return *json_; }
  /// The object as JSON text; numbers that are not finite are null.
  [[nodiscard]] std::string text() const;

 private:
  std::unique_ptr<nlohmann::json> json_;
};

/// One sensor of several that were calibrated together, with a sensor model of its own.
struct SensorModelPart {
  std::string name;  ///< `left`
  calibration::FitResult fit;
  calibration::SensorModelRecipe recipe;
};

struct CalibrationResult {
  std::string title;           ///< of the report
  calibration::FitResult fit;  ///< parameters with units in their names, covariance, residuals, warnings
  calibration::SensorModelRecipe
      recipe;                          ///< how the fit becomes a sensor model; its `base` is read from `base`
  std::filesystem::path base;          ///< sensor model that the values go into; empty: a new one
  std::vector<SensorModelPart> parts;  ///< empty where `fit` is of one sensor
  std::vector<calibration::Figure> figures;
  std::vector<std::filesystem::path> inputs;  ///< files whose hashes go into the sensor model
  CalibrationDetails details;                 ///< further numbers, e.g. the RMS of each view
  std::vector<std::string> record_next;       ///< what further recording would help
  std::vector<std::string> notes;             ///< what follows from it beyond the sensor model
};

/// The sensor model as YAML, with the section `calibration` (parameters, covariance, inputs by their
/// SHA-256). Reads `base` and `inputs`. not_found: the base; bad_input: the base is no map.
[[nodiscard]] Result<std::string> sensor_model_yaml(const CalibrationResult& result);

/// A file that save_sensor_model() wrote; `part` is empty for the one that was named.
struct SavedSensorModel {
  std::string part;
  std::filesystem::path file;
};
/// Writes the sensor model into `file`, and those of the parts beside it (part_file). Each file is written
/// whole or not at all, and replaces one of its name. Errors of sensor_model_yaml(); not_writable, disk_full,
/// io.
[[nodiscard]] Result<std::vector<SavedSensorModel>> save_sensor_model(const CalibrationResult& result,
                                                                      const std::filesystem::path& file);
/// Where the model of a part lies beside that of all: `rig.yaml` and `left` give `rig.left.yaml`.
[[nodiscard]] std::filesystem::path part_file(const std::filesystem::path& file, const std::string& part);

}  // namespace rigor

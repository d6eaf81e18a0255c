#include "calibration/procedures/calibration_result.h"

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "bench/files/file_digest.h"
#include "bench/files/output_file.h"

namespace rigor {
namespace {

Result<std::string> yaml_of(calibration::SensorModelRecipe recipe, const calibration::FitResult& fit,
                            const std::vector<std::filesystem::path>& inputs) {
  std::vector<calibration::RecordingHash> hashes;
  for (const auto& file : inputs) hashes.push_back({file.filename().string(), sha256_of(file)});
  return calibration::sensor_model_yaml(recipe, fit, hashes);
}

}  // namespace

CalibrationDetails::CalibrationDetails()
    : json_(std::make_unique<nlohmann::json>(nlohmann::json::object())) {}
CalibrationDetails::CalibrationDetails(const CalibrationDetails& other)
    : json_(std::make_unique<nlohmann::json>(*other.json_)) {}
CalibrationDetails::CalibrationDetails(CalibrationDetails&& other) : CalibrationDetails() {
  json_.swap(other.json_);
}
CalibrationDetails& CalibrationDetails::operator=(CalibrationDetails other) {
  json_.swap(other.json_);
  return *this;
}
CalibrationDetails::~CalibrationDetails() = default;

std::string CalibrationDetails::text() const {
  return json_->dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

Result<std::string> sensor_model_yaml(const CalibrationResult& result) {
  calibration::SensorModelRecipe recipe = result.recipe;
  if (!result.base.empty()) {
    std::ifstream in(result.base);
    if (!in)
      return fail(ErrorCode::not_found, result.base.string(),
                  "expected the sensor model that the values go into, got no such file");
    std::ostringstream text;
    text << in.rdbuf();
    recipe.base = text.str();
  }
  return yaml_of(std::move(recipe), result.fit, result.inputs);
}

std::filesystem::path part_file(const std::filesystem::path& file, const std::string& part) {
  std::filesystem::path beside = file;
  return beside.replace_filename(file.stem().string() + "." + part + file.extension().string());
}

Result<std::vector<SavedSensorModel>> save_sensor_model(const CalibrationResult& result,
                                                        const std::filesystem::path& file) {
  std::vector<std::pair<SavedSensorModel, std::string>> models;
  for (const SensorModelPart& part : result.parts) {
    auto yaml = yaml_of(part.recipe, part.fit, result.inputs);
    if (!yaml) return tl::unexpected<Error>(yaml.error());
    models.push_back({{part.name, part_file(file, part.name)}, std::move(*yaml)});
  }
  auto yaml = sensor_model_yaml(result);
  if (!yaml) return tl::unexpected<Error>(yaml.error());
  models.push_back({{"", file}, std::move(*yaml)});
  std::vector<SavedSensorModel> saved;
  for (const auto& [model, text] : models) {
    if (auto s = write_output(model.file, text); !s) return tl::unexpected<Error>(s.error());
    saved.push_back(model);
  }
  return saved;
}

}  // namespace rigor

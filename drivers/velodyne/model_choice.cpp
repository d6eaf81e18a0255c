#include "drivers/velodyne/model_choice.h"

#include "drivers/velodyne/calibration_file.h"

namespace rigor::velodyne {

Result<std::unique_ptr<CloudStream>> open_model(const SourceSettings& settings, Model model) {
  Calibration calibration = factory_calibration(model);
  if (!settings.calibration.empty()) {
    auto loaded = load_calibration(settings.calibration, model);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    calibration = std::move(*loaded);
  }
  auto decoder = PacketDecoder::create(model, calibration, settings.rings);
  if (!decoder) return tl::unexpected<Error>(decoder.error());
  return std::make_unique<CloudStream>(std::move(*decoder), settings.stream);
}

Result<Model> decide_model(const SourceSettings& settings, std::uint8_t product,
                           const ModelEvidence& evidence, std::vector<std::string>& warnings) {
  const auto by_byte = model_of(product);
  const auto by_time = evidence.model();
  const auto named = [](Model m) { return std::string(facts_of(m).name); };
  if (settings.model) {
    if (by_time && *by_time != *settings.model)
      warnings.push_back("the rig says " + named(*settings.model) + ", the packets' timing is that of a " +
                         named(*by_time) + ": check `model`");
    else if (by_byte != settings.model)
      warnings.push_back("the product byte says " +
                         (by_byte ? named(*by_byte) : std::string("no known model")) + ", the rig says " +
                         named(*settings.model) + ", and the rig is followed");
    return *settings.model;
  }
  if (by_time && by_byte != by_time)
    warnings.push_back(
        "the product byte says " + (by_byte ? named(*by_byte) : std::string("no known model")) +
        ", the packets' timing is that of a " + named(*by_time) +
        ", which is taken; `model: " + std::string(facts_of(*by_time).key) + "` says so for good");
  if (by_time) return *by_time;
  if (by_byte) return *by_byte;
  return fail(ErrorCode::unavailable, "model",
              "expected packets of a VLP-16 or HDL-32E, got product byte " + std::to_string(product) +
                  " and a timing of neither; say which it is by `model`");
}

}  // namespace rigor::velodyne

// Which model a device is, and the decoder for it.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "drivers/velodyne/velodyne_settings.h"

namespace rigor::velodyne {

/// The model by what packets say and show; a contradiction becomes a warning. unavailable: neither tells.
[[nodiscard]] Result<Model> decide_model(const SourceSettings& settings, std::uint8_t product,
                                         const ModelEvidence& evidence, std::vector<std::string>& warnings);

/// A stream of this model's clouds. bad_input: the calibration.
[[nodiscard]] Result<std::unique_ptr<CloudStream>> open_model(const SourceSettings& settings, Model model);

}  // namespace rigor::velodyne

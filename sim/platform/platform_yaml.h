// Platform models in YAML, as configs/platforms has them. Every key may be left out.
#pragma once

#include <filesystem>

#include "rt-core/result.h"
#include "sim/platform/harvester.h"
#include "sim/platform/skid_steer.h"

namespace rigor {

/// Setup context. not_found; bad_input with place.
[[nodiscard]] Result<SkidSteerConfig> load_skid_steer(const std::filesystem::path& file);
[[nodiscard]] Result<HarvesterConfig> load_harvester(const std::filesystem::path& file);

}  // namespace rigor

// What a dataset's outputs say of a sample beside pixels, as JSON. Internal to bench/dataset.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bench/dataset/dataset.h"

namespace rigor::dataset {

/// Number, split, conditions, rejected poses, T_world_carrier.
[[nodiscard]] nlohmann::json described(const DatasetSample& sample);
/// Kind, pose, device, lens, exposure; with truth the instances of images and range images, and the
/// run-length code of those with `min_area_px` visible pixels or more.
[[nodiscard]] nlohmann::json described(const DatasetView& view, bool truth, std::uint32_t min_area_px);

}  // namespace rigor::dataset

// What a folder of a dataset has beside its samples: annotations as COCO has them, splits, README. Internal
// to bench/dataset.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bench/dataset/dataset_output.h"

namespace rigor::dataset {

/// Of the samples that are whole. not_found, bad_input (a sample that is no JSON), and those of outputs.
[[nodiscard]] Result<DatasetSummary> summarize(const std::filesystem::path& dir,
                                               const nlohmann::json& manifest, const Dataset& dataset,
                                               std::uint32_t min_area_px);
/// README.md of such a folder.
[[nodiscard]] std::string readme(const nlohmann::json& manifest, const Dataset& dataset,
                                 const DatasetSummary& summary);

}  // namespace rigor::dataset

// `--report DIR`: one HTML page with plots and pictures, and the JSON that it was made from. No script, no
// network: it can be mailed, and read in ten years.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>

#include "cli/bench_run.h"
#include "cli/page.h"

namespace rigor {

/// Writes pictures, index.html and result.json into `dir`. Adds to `result` the names of the pictures.
/// `localization`: HTML of what an application's estimate was worth; empty: none.
[[nodiscard]] Status write_report(const std::filesystem::path& dir, nlohmann::json& result,
                                  const RunParts& parts, const std::string& localization);

/// A sample's image as 8-bit BGR rows for people: demosaicked, unpacked, not stretched. PNG at `file`.
[[nodiscard]] Status write_picture(const std::filesystem::path& file, const ImageInfo& info,
                                   std::span<const std::byte> bytes);

}  // namespace rigor

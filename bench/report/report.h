// `--report DIR`: one HTML page with plots and pictures, and the JSON that it was made from. Everything is in
// the folder and nothing is fetched: it can be mailed, and read in ten years.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>

#include "bench/files/output_file.h"
#include "bench/page/page.h"
#include "bench/run/bench_run.h"

namespace rigor {

/// Writes pictures, index.html and result.json into `dir`. Adds to `result` the names of the pictures.
/// `analyses`: HTML of what analyses found; empty: none. `existing`: what becomes of an earlier report.
[[nodiscard]] Status write_report(const std::filesystem::path& dir, nlohmann::json& result,
                                  const RunParts& parts, const std::string& analyses, Existing existing);

}  // namespace rigor

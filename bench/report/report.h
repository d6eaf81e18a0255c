// `--report DIR`: one HTML page with plots and pictures, and the JSON that it was made from. Everything is in
// the folder and nothing is fetched: it can be mailed, and read in ten years.
#pragma once

#include <filesystem>

#include "bench/files/output_file.h"
#include "bench/result/run_report.h"
#include "bench/run/bench_run.h"

namespace rigor {

/// Writes pictures, index.html and result.json into `dir`. Adds to `report` the names of the pictures, which
/// are the first and the last of each camera in `parts`. `existing`: what becomes of an earlier report.
[[nodiscard]] Status write_report(const std::filesystem::path& dir, RunReport& report, const RunParts& parts,
                                  Existing existing);

}  // namespace rigor

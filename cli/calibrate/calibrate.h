// `rigor calibrate …`: what its subcommands share. A subcommand reads its inputs, fits, and hands a product
// over; writing the sheet, the report and the answer is the same for all.
#pragma once

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/console/terminal.h"
#include "calibration/core/figures.h"
#include "calibration/core/fit_output.h"
#include "cli/command_options.h"
#include "rt-core/result.h"

namespace CLI {
class App;
}

namespace rigor {

struct CalibrateOptions {
  std::vector<std::filesystem::path> inputs;
  std::filesystem::path output;  ///< model YAML; empty: none is written
  std::filesystem::path base;    ///< sheet that the values go into
  std::filesystem::path report;  ///< folder; empty: none
  std::string model = "auto";
  std::string channel;  ///< of recordings
  bool force = false;   ///< write over a file that is there
  bool json = false;
};

/// One of `rigor calibrate X`.
struct CalibrateSubcommand {
  CommandOptions app;
  std::function<int()> run;  ///< exit status
};
/// Each makes its subcommand with its options; registered in calibrate_cli.cpp.
[[nodiscard]] CalibrateSubcommand add_calibrate_camera(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_lidar(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_stereo(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_tof(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_extrinsics(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_delay(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_latency(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_twin(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_pair(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_photon(CLI::App& calibrate);
[[nodiscard]] CalibrateSubcommand add_calibrate_shading(CLI::App& calibrate);
/// The options of CalibrateOptions; `inputs` says what INPUT may be.
void add_common_options(CommandOptions& app, CalibrateOptions& options, const char* inputs);

/// What a fit gives away.
struct CalibrationProduct {
  std::string title;  ///< of the report
  calibration::FitResult fit;
  calibration::SheetRecipe recipe;  ///< its `base` is read from the options
  std::vector<calibration::Figure> figures;
  std::vector<std::filesystem::path> inputs;       ///< files whose hashes go into the sheet
  nlohmann::json more = nlohmann::json::object();  ///< added to the JSON answer, e.g. per-view RMS
  std::vector<std::string> record_next;            ///< what further recording would help
  std::vector<std::string> notes{};                ///< what follows from it beyond the sheet
};

/// Before the work: outputs can be written, nothing is overwritten by accident, and none of them is an input
/// (`more_inputs`, `more_outputs`: of the subcommand's own; empty ones do not count). not_writable,
/// bad_input.
[[nodiscard]] Status check_outputs(const CalibrateOptions& options,
                                   const std::vector<std::filesystem::path>& more_inputs = {},
                                   const std::vector<std::filesystem::path>& more_outputs = {});
/// Writes sheet and report, prints the table or the JSON. Exit status: 1 for an interrupted fit, whose best
/// so far is written and marked.
[[nodiscard]] int finish_calibration(const CalibrateOptions& options, CalibrationProduct product);

/// Files that the inputs name: a folder stands for what it holds with one of these extensions, in the order
/// of names. not_found.
[[nodiscard]] Result<std::vector<std::filesystem::path>> input_files(
    const std::vector<std::filesystem::path>& inputs, const std::vector<std::string>& extensions);
/// Hex of a file's SHA-256; empty where it cannot be read.
[[nodiscard]] std::string sha256_of(const std::filesystem::path& file);

}  // namespace rigor

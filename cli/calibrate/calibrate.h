// `rigor calibrate …`: what its subcommands share. A subcommand reads its options into those of a calibration
// (calibration/procedures); checking the outputs, writing the files and printing the answer is the same for
// all.
#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "calibration/procedures/calibration_result.h"
#include "cli/command_options.h"

namespace CLI {
class App;
}

namespace rigor {

struct CalibrateOutput {
  std::filesystem::path output;  ///< model YAML; empty: none is written
  std::filesystem::path report;  ///< folder; empty: none
  bool force = false;            ///< write over a file that is there
  bool json = false;
};

/// What a subcommand reads from its command line.
template <class Options>
struct CalibrateCommand {
  Options options;
  CalibrateOutput output;
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
/// The options of CalibrationInputs and CalibrateOutput; `inputs` says what INPUT may be.
void add_common_options(CommandOptions& app, CalibrationInputs& from, CalibrateOutput& output,
                        const char* inputs);

/// Files that a subcommand reads and writes beside the common ones; empty ones do not count.
struct CalibrateFiles {
  std::vector<std::filesystem::path> inputs{}, outputs{};
};
/// Checks the outputs before the work, calibrates until a signal asks to stop, writes the sensor model and
/// the report, and prints the answer. Exit status: 1 for an interrupted fit, whose best so far is written and
/// marked.
[[nodiscard]] int run_calibration(
    const CalibrationInputs& from, const CalibrateOutput& output, const CalibrateFiles& files,
    const std::function<Result<CalibrationResult>(const StopToken&)>& calibrate);

}  // namespace rigor

#include "cli/calibrate/calibrate_cli.h"

#include <CLI/CLI.hpp>
#include <vector>

#include "cli/calibrate/calibrate.h"

namespace rigor {
namespace {

/// The subcommands, each in a file of its own, in the order in which the help lists them.
constexpr CalibrateSubcommand (*kSubcommands[])(CLI::App&) = {
    add_calibrate_camera,  add_calibrate_lidar, add_calibrate_stereo,     add_calibrate_photon,
    add_calibrate_shading, add_calibrate_tof,   add_calibrate_extrinsics, add_calibrate_delay,
    add_calibrate_latency, add_calibrate_twin,  add_calibrate_pair,
};

}  // namespace

struct CalibrateCommandLine::Impl {
  CLI::App* calibrate = nullptr;
  std::vector<CalibrateSubcommand> subcommands;
};

void add_common_options(CommandOptions& app, CalibrationInputs& from, CalibrateOutput& output,
                        const char* inputs) {
  app.add_option("INPUT", from.inputs, inputs).required();
  app.add_option("-o,--output", output.output,
                 "Sensor model to write (YAML), which a simulated channel reads");
  app.add_option("--base", from.base,
                 "Sensor model that the values go into; what was not fitted stays as it is there")
      .config_file();
  app.add_option("--model", from.model, "auto: the smallest that the data support; or a model by name");
  app.add_option("--report", output.report, "Write an HTML report into this folder");
  app.add_option("--channel", from.channel, "Channel of a recording");
  app.add_flag("--force", output.force, "Write over a sensor model that is there");
  app.add_flag("--json", output.json, "Print the result as JSON");
}

CalibrateCommandLine::CalibrateCommandLine(CLI::App& app) : impl_(std::make_unique<Impl>()) {
  impl_->calibrate = app.add_subcommand("calibrate", "Fit the parameters of a sensor model to recordings");
  impl_->calibrate->require_subcommand(1);
  for (const auto add : kSubcommands) impl_->subcommands.push_back(add(*impl_->calibrate));
}

CalibrateCommandLine::~CalibrateCommandLine() = default;
bool CalibrateCommandLine::chosen() const { return impl_->calibrate->parsed(); }

int CalibrateCommandLine::run() const {
  for (const auto& subcommand : impl_->subcommands)
    if (subcommand.app.parsed()) return subcommand.run();
  return 2;
}

}  // namespace rigor

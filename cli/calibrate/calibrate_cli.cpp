#include "cli/calibrate/calibrate_cli.h"

#include <CLI/CLI.hpp>

#include "cli/calibrate/calibrate.h"

namespace rigor {

struct CalibrateCommandLine::Impl {
  CLI::App* calibrate = nullptr;
  CLI::App* camera = nullptr;
  CalibrateCameraOptions camera_options;
};

namespace {

void add_common(CLI::App* app, CalibrateOptions& o, const char* inputs) {
  app->add_option("INPUT", o.inputs, inputs)->required();
  app->add_option("-o,--output", o.output, "Sheet to write (YAML), which a simulated channel reads");
  app->add_option("--base", o.base,
                  "Sheet that the values go into; what was not fitted stays as it is there");
  app->add_option("--model", o.model, "auto: the smallest that the data support; or a model by name");
  app->add_option("--report", o.report, "Write an HTML report into this folder");
  app->add_option("--channel", o.channel, "Channel of a recording");
  app->add_flag("--force", o.force, "Write over a sheet that is there");
  app->add_flag("--json", o.json, "Print the result as JSON");
}

}  // namespace

CalibrateCommandLine::CalibrateCommandLine(CLI::App& app) : impl_(std::make_unique<Impl>()) {
  Impl& d = *impl_;
  d.calibrate = app.add_subcommand("calibrate", "Fit the parameters of a sensor model to recordings");
  d.calibrate->require_subcommand(1);
  d.camera = d.calibrate->add_subcommand("camera", "Intrinsics and lens from pictures of a board");
  add_common(d.camera, d.camera_options,
             "Pictures, folders of pictures, or lists of corners (.vnl, with --size)");
  d.camera
      ->add_option("--target", d.camera_options.target,
                   "chessboard:9x6:0.025 (inner corners, square in metres), circles:…, asymmetric:…, "
                   "charuco:8x6:0.04:0.03[:DICTIONARY]")
      ->required();
  d.camera->add_option("--size", d.camera_options.size, "WIDTHxHEIGHT of the pictures of a list of corners");
  d.camera->add_option("--start-fx", d.camera_options.start_fx_px, "Focal length in pixels to begin with")
      ->check(CLI::PositiveNumber);
  d.camera->add_flag("--all-corners", d.camera_options.all_corners, "Leave no outlier out");
  d.camera->footer(
      "Example: rigor calibrate camera left*.jpg --target chessboard:9x6:0.025 -o left.yaml --report report");
}

CalibrateCommandLine::~CalibrateCommandLine() = default;
bool CalibrateCommandLine::chosen() const { return impl_->calibrate->parsed(); }

int CalibrateCommandLine::run() const { return calibrate_camera_command(impl_->camera_options); }

}  // namespace rigor

#include <memory>

#include "calibration/procedures/camera_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_camera(CLI::App& calibrate) {
  CommandOptions app(calibrate, "camera", "Intrinsics and lens from pictures of a board");
  auto command = std::make_shared<CalibrateCommand<CameraCalibrationOptions>>();
  add_common_options(
      app, command->options, command->output,
      "Pictures, folders of pictures, recordings (.mcap), or lists of corners (.vnl, with --size)");
  app.add_option("--target", command->options.target,
                 "chessboard:9x6:0.025 (inner corners, square in metres), circles:…, asymmetric:…, "
                 "charuco:8x6:0.04:0.03[:DICTIONARY]")
      .required();
  app.add_option("--size", command->options.size, "WIDTHxHEIGHT of the pictures of a list of corners");
  app.add_option("--start-fx", command->options.start_fx_px, "Focal length in pixels to begin with")
      .positive();
  app.add_flag("--all-corners", command->options.all_corners, "Leave no outlier out");
  app.add_flag("--rolling-shutter", command->options.rolling_shutter,
               "Fit the line time too, of a sequence in which the board or the camera moves; needs times: a "
               "recording, or --rate");
  app.add_option("--rate", command->options.rate_hz,
                 "Pictures a second, of a folder of pictures in the order of their names")
      .positive();
  app.add_option("--longest-gap-ms", command->options.longest_gap_ms,
                 "Views further apart do not say how the board moved between them (--rolling-shutter)")
      .positive();
  app.add_flag("--twin", command->options.twin,
               "Draw the same views with the fitted camera, find and fit them, and show both residuals");
  app.add_flag("--chromatic", command->options.chromatic,
               "Fit the magnification of red and blue too: colour pictures of a chessboard");
  app.footer(
      "Example: rigor calibrate camera left*.jpg --target chessboard:9x6:0.025 -o left.yaml --report report");
  return {app, [command] {
            command->options.looked_for_folder = command->output.report;
            const auto& o = command->options;
            return run_calibration(o, command->output, {},
                                   [&](const StopToken& stop) { return calibrate_camera(o, stop); });
          }};
}

}  // namespace rigor

#include <memory>

#include "calibration/procedures/extrinsics_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_extrinsics(CLI::App& calibrate) {
  CommandOptions app(
      calibrate, "extrinsics",
      "Where a LiDAR or a time-of-flight camera sits relative to a camera, from boards that both saw");
  auto command = std::make_shared<CalibrateCommand<ExtrinsicsCalibrationOptions>>();
  add_common_options(app, command->options, command->output, "Recordings (.mcap)");
  app.add_option("--camera", command->options.camera, "Channel of the camera");
  app.add_option("--camera-model", command->options.camera_model_file,
                 "Its sensor model, as `rigor calibrate camera` wrote it")
      .required();
  app.add_option("--second", command->options.second, "Channel of the LiDAR or the time-of-flight camera");
  app.add_option("--second-model", command->options.second_model_file,
                 "Sensor model of a time-of-flight camera; none: a LiDAR");
  app.add_option("--target", command->options.target, "Board, as in chessboard:9x6:0.025").required();
  app.add_option(
         "--rough", command->options.rough,
         "x,y,z,roll,pitch,yaw of the second sensor in the camera's frame, to a hand's breadth: which points "
         "are the board's is judged by it")
      .required();
  app.add_option("--margin", command->options.margin_m, "How far --rough may be off at the board, m")
      .positive();
  app.add_option("--sigma", command->options.sigma_m,
                 "Noise of the second sensor's ranges, m; else taken from the data")
      .positive();
  app.add_option("--still", command->options.still_m, "By how much a board may move between pictures, m")
      .positive();
  app.add_option("--views", command->options.views, "At most so many views are used").between(1, 10000);
  app.footer(
      "Example: rigor calibrate extrinsics rec.mcap --camera left --camera-model left.yaml --second top "
      "--target chessboard:9x6:0.1 --rough 0.2,-0.1,0 -o top-in-left.yaml");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = {o.camera_model_file, o.second_model_file}},
                                   [&](const StopToken& stop) { return calibrate_extrinsics(o, stop); });
          }};
}

}  // namespace rigor

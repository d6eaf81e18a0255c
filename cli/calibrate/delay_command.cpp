#include <memory>

#include "calibration/procedures/delay_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_delay(CLI::App& calibrate) {
  CommandOptions app(calibrate, "delay",
                     "By how much two channels' stamps are apart, from what both saw move");
  auto command = std::make_shared<CalibrateCommand<DelayCalibrationOptions>>();
  add_common_options(app, command->options, command->output, "A recording (.mcap)");
  app.add_option("--first", command->options.first,
                 "Channel, the denser one; CHANNEL:INDEX of registers, SINK:VALUE of commands")
      .required();
  app.add_option("--second", command->options.second,
                 "The other channel: delay > 0 means that its stamps are early")
      .required();
  app.add_option("--target", command->options.target, "Cameras: the board whose turning is followed");
  app.add_option("--camera-model", command->options.camera_model_file, "Cameras: the sensor model");
  app.add_option("--largest", command->options.largest_s, "How far to search, s").positive();
  app.add_flag("--same", command->options.same_quantity,
               "Both measure the same in one unit (an even motion tells then, too)");
  app.footer(
      "Example: rigor calibrate delay rec.mcap --first table:0 --second left --target chessboard:9x6:0.1 "
      "--camera-model left.yaml");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = {o.camera_model_file}},
                                   [&](const StopToken& stop) { return calibrate_delay(o, stop); });
          }};
}

}  // namespace rigor

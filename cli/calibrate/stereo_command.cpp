#include <memory>

#include "calibration/procedures/stereo_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_stereo(CLI::App& calibrate) {
  CommandOptions app(calibrate, "stereo", "Where the right of two cameras stands in the left one's frame");
  auto command = std::make_shared<CalibrateCommand<StereoCalibrationOptions>>();
  add_common_options(app, command->options, command->output,
                     "Left camera: pictures, folders of pictures, a recording (.mcap), or lists of corners");
  app.add_option("--right", command->options.right,
                 "Right camera: the same, in the same order; not needed where one recording has both");
  app.add_option("--right-channel", command->options.right_channel,
                 "Channel of the right camera in a recording");
  app.add_option("--target", command->options.target, "The board: as for `rigor calibrate camera`")
      .required();
  app.add_option("--size", command->options.size, "WIDTHxHEIGHT of the pictures of a list of corners");
  app.add_option("--left-model", command->options.left_model_file,
                 "Hold the left camera's intrinsics at those of this sensor model");
  app.add_option("--right-model", command->options.right_model_file,
                 "Hold the right camera's intrinsics at those of this sensor model");
  app.add_option("--within-ms", command->options.within_ms,
                 "Views of recordings that belong together are no further apart")
      .not_negative();
  app.footer(
      "Example: rigor calibrate stereo left/ --right right/ --target chessboard:9x6:0.025 -o stereo.yaml "
      "--report report");
  return {app, [command] {
            command->options.looked_for_folder = command->output.report;
            CalibrateFiles files{.inputs = command->options.right};
            files.inputs.insert(files.inputs.end(),
                                {command->options.left_model_file, command->options.right_model_file});
            if (!command->output.output.empty())
              for (const char* side : {"left", "right"})
                if ((side[0] == 'l' ? command->options.left_model_file : command->options.right_model_file)
                        .empty())
                  files.outputs.push_back(part_file(command->output.output, side));
            const auto& o = command->options;
            return run_calibration(o, command->output, files,
                                   [&](const StopToken& stop) { return calibrate_stereo(o, stop); });
          }};
}

}  // namespace rigor

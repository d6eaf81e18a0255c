#include <memory>

#include "calibration/procedures/shading_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_shading(CLI::App& calibrate) {
  CommandOptions app(calibrate, "shading", "Fall-off of the light towards the corners (vignetting)");
  auto command = std::make_shared<CalibrateCommand<ShadingCalibrationOptions>>();
  add_common_options(
      app, command->options, command->output,
      "Pictures of an even light, folders or recordings of them; or a table of gains (.csv, or a "
      "libcamera tuning file .json)");
  app.add_option("--dark", command->options.input.dark,
                 "Pictures, folders or recordings without light, of the same exposure");
  app.add_option("--black", command->options.black_dn,
                 "Black level of the pictures in DN, where there are no dark ones")
      .not_negative();
  app.add_flag("--mosaic", command->options.mosaic, "The pixels are a 2x2 mosaic of colours");
  app.footer(
      "Example: rigor calibrate shading flats/ --dark darks/ --base camera.yaml -o camera-shaded.yaml "
      "--report report");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = o.input.dark},
                                   [&](const StopToken& stop) { return calibrate_shading(o, stop); });
          }};
}

}  // namespace rigor

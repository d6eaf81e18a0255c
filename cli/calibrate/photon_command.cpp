#include <memory>

#include "calibration/procedures/photon_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_photon(CLI::App& calibrate) {
  CommandOptions app(calibrate, "photon", "Gain, noise and saturation of a sensor, by EMVA 1288");
  auto command = std::make_shared<CalibrateCommand<PhotonCalibrationOptions>>();
  add_common_options(
      app, command->options, command->output,
      "Pictures or folders of them (exposure and `dark` in their names: flat_20ms_1.png, "
      "dark_20ms_1.png), lists (.csv: file, exposure_ms, light|dark[, temperature_c[, gain_db]]), "
      "recordings");
  app.add_option("--dark", command->options.input.dark, "Pictures, folders or recordings without light");
  app.add_option("--temperature", command->options.input.temperature_c,
                 "Of the sensor, in °C, where a frame says none");
  app.add_option("--bits", command->options.bits, "Of the converter").between(8, 16);
  const auto mosaic =
      app.add_flag("--mosaic", command->options.mosaic, "The pixels are a 2x2 mosaic of colours");
  app.add_flag("--grey", command->options.grey, "They are not, though they differ").excludes(mosaic);
  app.footer(
      "Example: rigor calibrate photon flats/ --dark darks/ --base "
      "configs/sensors/industrial-global-shutter.yaml -o "
      "mine.yaml --report report");
  return {app, [command] {
            command->options.sensor_model = !command->output.output.empty();
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = o.input.dark},
                                   [&](const StopToken& stop) { return calibrate_photon(o, stop); });
          }};
}

}  // namespace rigor

#include <memory>

#include "calibration/procedures/lidar_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_lidar(CLI::App& calibrate) {
  CommandOptions app(calibrate, "lidar",
                     "Biases, angles and gains of beams, noise against remission, from walls in recordings");
  auto command = std::make_shared<CalibrateCommand<LidarCalibrationOptions>>();
  add_common_options(app, command->options, command->output,
                     "Recordings: .mcap, packets of a Velodyne (.pcap), telegrams of a SICK scanner (.json)");
  app.add_option(
      "--targets", command->options.targets,
      "Surveyed walls (YAML): walls: [{ name: east, normal: [1, 0, 0], distance_m: 4.2, reflectance: "
      "0.8 }], in the sensor's frame");
  app.add_option("--noise-model", command->options.noise_model,
                 "auto, constant, photon, photon+floor, power, offset, offset+floor or full");
  app.footer(
      "Example: rigor calibrate lidar room.pcap --base configs/sensors/velodyne-vlp16.yaml -o my.yaml "
      "--report "
      "report");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = {o.targets}},
                                   [&](const StopToken& stop) { return calibrate_lidar(o, stop); });
          }};
}

}  // namespace rigor

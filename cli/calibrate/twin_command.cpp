#include <memory>

#include "calibration/procedures/twin_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_twin(CLI::App& calibrate) {
  CommandOptions app(calibrate, "twin",
                     "How far a simulated channel is from the real one: bias, spread, noise");
  auto command = std::make_shared<CalibrateCommand<TwinCalibrationOptions>>();
  add_common_options(app, command->options, command->output, "Recordings (.mcap) of a pair");
  app.add_option("--real", command->options.real, "Channel of the device, where it is no pair");
  app.add_option("--simulated", command->options.simulated, "Channel of its twin");
  app.add_option("--tolerance", command->options.tolerance_ms, "Samples are of one instant within so many ms")
      .positive();
  app.footer("Example: rigor calibrate twin rec.mcap --channel top --report twin");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {},
                                   [&](const StopToken& stop) { return calibrate_twin(o, stop); });
          }};
}

}  // namespace rigor

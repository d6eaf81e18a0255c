#include <memory>

#include "calibration/procedures/pair_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_pair(CLI::App& calibrate) {
  CommandOptions app(calibrate, "pair", "The model with which a pair's simulated side would be its device");
  auto command = std::make_shared<CalibrateCommand<PairCalibrationOptions>>();
  add_common_options(app, command->options, command->output,
                     "Recording (.mcap) of a pair; and its rig (.yaml), where not the recorded one counts");
  app.add_option("--from", command->options.from_s, "Only captures from this second of the run on");
  app.add_option("--until", command->options.until_s, "Only captures before this second of the run");
  app.footer(
      "Examples: rigor calibrate pair run.mcap --channel left -o left-new.yaml --report pair\n"
      "          rigor calibrate pair run.mcap --channel left --from 12.5 -o left-new.yaml");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {},
                                   [&](const StopToken& stop) { return calibrate_pair(o, stop); });
          }};
}

}  // namespace rigor

#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "calibration/procedures/latency_report.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
namespace {

int run_latency(const LatencyCalibrationOptions& o, bool as_json) {
  StopSource stop;
  SignalStop signals(stop);
  const auto result = calibrate_latency(o, stop.token());
  if (!result) return report_error(result.error(), as_json);
  if (as_json)
    fmt::print("{}\n", json_text(latency_json(o, *result)));
  else
    fmt::print("{}", latency_text(o, *result));
  return result->interrupted ? 1 : 0;
}

}  // namespace

CalibrateSubcommand add_calibrate_latency(CLI::App& calibrate) {
  CommandOptions app(calibrate, "latency",
                     "latency_ms of channels, from how long their samples took from capture to arrival");
  auto o = std::make_shared<LatencyCalibrationOptions>();
  auto as_json = std::make_shared<bool>(false);
  app.add_option("INPUT", o->inputs, "Recordings (.mcap) of runs in wall-clock time").required();
  app.add_option("--channel", o->channels, "Channel, several times for several; without it all of them");
  app.add_option("--quantile", o->fit.quantile, "Share of the samples that are to be in time; 0.999")
      .positive();
  app.add_option("--confidence", o->fit.confidence, "With which that share is reached; 0.95").positive();
  app.add_option(
      "--trigger", o->trigger,
      "For devices without a clock: CHANNEL whose every sample triggers one, or SINK:VALUE that does "
      "so when it leaves 0");
  app.add_option("--trigger-to-capture", o->trigger_to_capture_ms,
                 "From the trigger to the capture, ms: half of an exposure")
      .not_negative();
  app.add_flag("--json", *as_json, "Print the result as JSON");
  app.footer("Example: rigor calibrate latency run.mcap --channel left --quantile 0.999");
  return {app, [o, as_json] { return run_latency(*o, *as_json); }};
}

}  // namespace rigor

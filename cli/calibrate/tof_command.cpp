#include <memory>

#include "calibration/procedures/tof_calibration.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
CalibrateSubcommand add_calibrate_tof(CLI::App& calibrate) {
  CommandOptions app(calibrate, "tof",
                     "Wiggling, pixels' offsets, noise, saturation and drift of time-of-flight sensors");
  auto command = std::make_shared<CalibrateCommand<TofCalibrationOptions>>();
  add_common_options(
      app, command->options, command->output,
      "Recordings with range images (.mcap), each of one scene at rest; or a series of readings (.csv)");
  app.get_option("INPUT").required(false);
  app.add_option(
      "--distances", command->options.distances,
      "Metres along the axis to the plane that fills the picture, one for each recording with commas "
      "between; or a CSV file of lines recording,distance");
  app.add_option(
         "--distance-sigma", command->options.distance_sigma_m,
         "Standard uncertainty of one distance in metres; without it, it is estimated from the scenes")
      .not_negative();
  app.add_option(
      "--raw", command->options.raw,
      "depth:FILE:WIDTHxHEIGHT,amplitude:FILE: a picture, unsigned 16 bit little-endian, millimetres "
      "(range: in place of depth: for ranges along the rays)");
  app.add_option("--board", command->options.board,
                 "Recordings of a calibration board: the lens from its amplitudes, with --target");
  app.add_option("--target", command->options.target,
                 "The board: chessboard:9x6:0.03 (inner corners, square in metres), as of calibrate camera");
  app.add_option("--noise", command->options.noise,
                 "temporal (frames of a scene at rest) or spatial (windows of a picture)")
      .one_of({"auto", "temporal", "spatial"});
  app.add_option("--window", command->options.window_px, "Window of the spatial estimate in pixels, odd");
  app.add_option(
         "--amplitude-unit", command->options.amplitude_unit,
         "electrons (recordings' default) or counts (that of --raw): of the device, contrast as in the base")
      .one_of({"electrons", "counts"});
  app.add_option("--unit", command->options.unit, "Of a series").one_of({"mm", "m"});
  app.add_option("--period", command->options.period_s, "Seconds between readings, or frames").positive();
  app.footer(
      "Examples: rigor calibrate tof 0.8m.mcap 1.0m.mcap 1.2m.mcap --distances 0.8,1.0,1.2 --base "
      "sr4000.yaml -o "
      "mine.yaml --report report\n"
      "          rigor calibrate tof --board board.mcap --target chessboard:7x5:0.08 --base sr4000.yaml -o "
      "mine.yaml\n"
      "          rigor calibrate tof --raw depth:depth.raw:640x576,amplitude:ir.raw --json\n"
      "          rigor calibrate tof readings.csv --report report");
  return {app, [command] {
            const auto& o = command->options;
            return run_calibration(o, command->output, {.inputs = o.board},
                                   [&](const StopToken& stop) -> Result<CalibrationResult> {
                                     if (!command->output.output.empty() && o.base.empty())
                                       return fail(
                                           ErrorCode::bad_input, "--output",
                                           "expected --base with it: a sensor model of the same kind of "
                                           "camera, whose modulation, lens and light "
                                           "are not fitted (configs/sensors has some)");
                                     return calibrate_tof(o, stop);
                                   });
          }};
}

}  // namespace rigor

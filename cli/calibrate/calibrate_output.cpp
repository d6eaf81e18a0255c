#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "calibration/procedures/calibration_report.h"
#include "cli/calibrate/calibrate.h"

namespace rigor {
namespace {

/// Before the work: outputs can be written, nothing is overwritten by accident, and none of them is an input.
/// not_writable, bad_input.
Status check_outputs(const CalibrationInputs& from, const CalibrateOutput& options,
                     const std::vector<std::filesystem::path>& more_inputs,
                     const std::vector<std::filesystem::path>& more_outputs) {
  std::error_code ec;
  InputFiles inputs;
  for (const auto& input : from.inputs) {
    inputs.add("an input of the calibration", input);
    for (const auto& entry : std::filesystem::directory_iterator(input, ec))
      inputs.add("an input of the calibration", entry.path());
  }
  for (const auto& input : more_inputs) inputs.add("an input of the calibration", input);
  inputs.add("the sensor model of --base", from.base);
  Outputs outputs(std::move(inputs));
  const Existing existing = options.force ? Existing::replace : Existing::refuse;
  if (!options.output.empty())
    if (auto s = outputs.add(options.output, "-o", existing); !s) return s;
  for (const auto& output : more_outputs)
    if (auto s = outputs.add(output, "-o", existing); !s) return s;
  if (!from.base.empty() && !std::filesystem::is_regular_file(from.base, ec))
    return fail(ErrorCode::not_found, from.base.string(),
                "expected a sensor model (--base), got no such file");
  return options.report.empty() ? Status{} : outputs.add_report(options.report);
}

/// Writes the sensor model and the report, prints the table or the JSON.
int finish(const CalibrateOutput& options, const CalibrationResult& result) {
  nlohmann::json answer = result_json(result);
  if (!options.output.empty()) {
    const auto saved = save_sensor_model(result, options.output);
    if (!saved) return report_error(saved.error(), options.json);
    for (const SavedSensorModel& model : *saved)
      answer[model.part.empty() ? "output" : model.part + "_output"] = model.file.string();
  }
  const std::filesystem::path page = options.report / "index.html";
  if (!options.report.empty()) {
    if (auto s = write_report_files(options.report,
                                    {{"result.json", json_text(answer)}, {"index.html", html_report(result)}},
                                    options.force ? Existing::replace : Existing::keep);
        !s)
      return report_error(s.error(), options.json);
    answer["report"] = page.string();
  }
  if (options.json) {
    fmt::print("{}\n", json_text(answer));
  } else {
    fmt::print("{}", text_report(result));
    if (!options.output.empty()) fmt::print("model:  {}\n", options.output.string());
    if (!options.report.empty()) fmt::print("report: {}\n", page.string());
  }
  return result.fit.interrupted ? 1 : 0;
}

}  // namespace

int run_calibration(const CalibrationInputs& from, const CalibrateOutput& output, const CalibrateFiles& files,
                    const std::function<Result<CalibrationResult>(const StopToken&)>& calibrate) {
  if (auto s = check_outputs(from, output, files.inputs, files.outputs); !s)
    return report_error(s.error(), output.json);
  StopSource stop;
  SignalStop signals(stop);
  const auto result = calibrate(stop.token());
  if (!result) return report_error(result.error(), output.json);
  return finish(output, *result);
}

}  // namespace rigor

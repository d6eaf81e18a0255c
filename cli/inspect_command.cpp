#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "cli/commands.h"
#include "cli/terminal.h"
#include "sensor-hal/record/inspect.h"
#include "sensor-hal/record/mcap_repair.h"

namespace rigor {

int inspect_command(const InspectOptions& options) {
  const std::string file = options.file.string();
  if (!options.repair) {
    auto report = record::inspect(file);
    if (!report) return report_error(report.error(), options.json);
    fmt::print("{}", options.json ? record::to_json(*report).dump(2) + "\n" : record::to_text(*report));
    return 0;
  }
  std::filesystem::path output = options.output;
  if (output.empty()) output = std::filesystem::path(options.file).replace_extension(".repaired.mcap");
  std::error_code ec;
  if (std::filesystem::exists(output, ec) && !std::filesystem::equivalent(output, options.file, ec))
    return report_error({ErrorCode::not_writable, output.string(),
                         "expected a name that is not taken, a file is there; give another with -o"},
                        options.json);
  auto report = record::repair(file, output.string());
  if (!report) return report_error(report.error(), options.json);
  if (options.json)
    fmt::print("{}\n", nlohmann::json{{"output", output.string()},
                                      {"was_good", report->was_good},
                                      {"messages", report->messages},
                                      {"attachments_lost", report->attachments_lost},
                                      {"input_bytes", report->input_bytes},
                                      {"output_bytes", report->output_bytes}}
                           .dump(2));
  else
    fmt::print("{}: {} messages kept, {} of {} bytes{}\n", output.string(), report->messages,
               report->output_bytes, report->input_bytes,
               report->was_good ? "; nothing was wrong with the original" : "");
  return 0;
}

}  // namespace rigor

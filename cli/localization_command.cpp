#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "apps/forest-localization/stem_map.h"
#include "bench/analysis/localization_error.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/page/page.h"
#include "cli/commands.h"

namespace rigor {

int localization_command(const LocalizationOptions& options) {
  std::vector<DrawnStem> stems;
  if (!options.map.empty()) {
    const auto map = forest::StemMap::load(options.map);
    if (!map) return report_error(map.error(), options.json);
    for (const forest::Stem& s : map->stems()) stems.push_back({s.x_m, s.y_m, s.radius_m});
  }
  if (!options.report.empty()) {
    InputFiles inputs;
    inputs.add("the recording", options.recording);
    inputs.add("the map", options.map);
    if (auto s = Outputs(std::move(inputs)).add_report(options.report); !s)
      return report_error(s.error(), options.json);
  }
  std::optional<ProgressTask> reading(std::in_place, "read the recording");
  const auto error =
      localization_error(options.recording, {options.truth, options.estimate, options.after_s});
  reading.reset();
  if (!error) return report_error(error.error(), options.json);
  if (!options.report.empty()) {
    const std::string page =
        html_page(options.recording.filename().string(), "", localization_section(*error, stems));
    if (auto s = write_report_files(options.report, {{"index.html", page}},
                                    options.force ? Existing::replace : Existing::keep);
        !s)
      return report_error(s.error(), options.json);
  }
  if (options.json) {
    nlohmann::json j = to_json(*error);
    j["recording"] = options.recording.string();
    fmt::print("{}\n", json_text(j));
    return 0;
  }
  fmt::print("{}\n", to_text(*error));
  if (!options.report.empty()) fmt::print("report    {}\n", (options.report / "index.html").string());
  return 0;
}

}  // namespace rigor

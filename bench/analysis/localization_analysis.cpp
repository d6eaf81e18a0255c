#include "bench/analysis/localization_analysis.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>

#include "apps/forest-localization/stem_map.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

template <class Ports>
void require(const ConfigNode& params, const char* key, const std::string& name, const Ports& ports,
             const char* what) {
  if (ports.contains(name)) return;
  std::vector<std::string> names;
  for (const auto& [known, port] : ports) names.push_back(known);
  throw params.error(key, fmt::format("expected a {} of the rig, one of {}, got \"{}\"{}", what,
                                      names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", ")),
                                      name, did_you_mean(name, names)));
}

Status check(const ConfigNode& params, const ApplicationPorts& ports) {
  const LocalizationQuestion question = localization_question(params);
  require(params, "truth", question.truth, ports.inputs, "channel");
  require(params, "estimate", question.estimate, ports.outputs, "sink");
  return {};
}

Result<std::vector<DrawnStem>> stems_of(const ConfigNode& params) {
  std::vector<DrawnStem> stems;
  if (!params.has("map")) return stems;
  const auto map = forest::StemMap::load(params.base_dir() / params.text("map"));
  if (!map) return tl::unexpected<Error>(params.error("map", map.error().text()).error());
  for (const forest::Stem& s : map->stems()) stems.push_back({s.x_m, s.y_m, s.radius_m});
  return stems;
}

Result<std::optional<AnalysisReport>> analyse(const ConfigNode& params,
                                              const std::filesystem::path& recording) {
  const auto error = localization_error(recording, localization_question(params));
  if (!error) return std::optional<AnalysisReport>();  // none was told
  const auto stems = stems_of(params);
  if (!stems) return tl::unexpected<Error>(stems.error());
  AnalysisReport report;
  report.name = kLocalization;
  report.line = to_text(*error);
  report.json = to_json(*error).dump();
  report.html = localization_section(*error, *stems);
  return report;
}

}  // namespace

LocalizationQuestion localization_question(const ConfigNode& params) {
  LocalizationQuestion q;
  q.truth = params.text_or("truth", q.truth);
  q.estimate = params.text_or("estimate", q.estimate);
  q.after_s = params.number_or("after_s", q.after_s, {.min = 0, .max = 1e7});
  if (params.has("map")) (void)params.text("map");
  params.finish();
  return q;
}

NamedAnalysis localization_analysis() { return {kLocalization, check, analyse}; }

}  // namespace rigor

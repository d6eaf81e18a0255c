#include "bench/analysis/localization_analysis.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>

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

Result<std::vector<DrawnStem>> stems_of(const ConfigNode& params, const StemReader& read) {
  if (!params.has("map")) return std::vector<DrawnStem>{};
  auto stems = read(params.base_dir() / params.text("map"));
  if (!stems) return tl::unexpected<Error>(params.error("map", stems.error().text()).error());
  return stems;
}

Result<std::optional<AnalysisReport>> analyse(const ConfigNode& params,
                                              const std::filesystem::path& recording,
                                              const StemReader& read) {
  const auto error = localization_error(recording, localization_question(params));
  if (!error) return std::optional<AnalysisReport>();  // there was no estimate
  const auto stems = stems_of(params, read);
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
  q.truth = params.text("truth");
  q.estimate = params.text("estimate");
  q.after_s = params.number_or("after_s", q.after_s, {.min = 0, .max = 1e7});
  if (params.has("map")) (void)params.text("map");
  params.finish();
  return q;
}

NamedAnalysis localization_analysis(StemReader read_stems) {
  return {kLocalization, check,
          [read = std::move(read_stems)](const ConfigNode& params, const std::filesystem::path& recording) {
            return analyse(params, recording, read);
          }};
}

}  // namespace rigor

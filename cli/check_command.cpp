#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/analysis/check_recording.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/expect/expected_forms.h"
#include "bench/files/output_file.h"
#include "cli/commands.h"
#include "cli/overrides.h"

namespace rigor {
namespace {

struct Counts {
  std::ptrdiff_t hold = 0, fail = 0, unknown = 0;
};
Counts count(const std::vector<Expected>& all) {
  Counts n;
  n.fail = std::ranges::count_if(all, &Expected::fails);
  n.unknown = std::ranges::count(all, false, &Expected::known);
  n.hold = static_cast<std::ptrdiff_t>(all.size()) - n.fail - n.unknown;
  return n;
}

nlohmann::json to_json(const CheckedRecording& checked, const std::filesystem::path& recording) {
  const Counts n = count(checked.expected);
  return {{"recording", recording.string()},
          {"rig", checked.rig},
          {"duration_s", checked.duration_s},
          {"cycles", checked.cycles},
          {"cut_short", checked.cut_short},
          {"missing_samples", checked.missing_samples},
          {"hold", n.hold},
          {"violated", n.fail},
          {"unknown", n.unknown},
          {"expect", rigor::to_json(checked.expected)}};
}

/// "expect    2 of 4 hold, 1 cannot be determined from a recording (demo, 2.000 s)", and a line for each.
std::string to_text(const CheckedRecording& checked) {
  const Counts n = count(checked.expected);
  std::string out =
      fmt::format("expect    {} of {} hold{} ({}, {:.3f} s)\n", n.hold, checked.expected.size(),
                  n.unknown > 0 ? fmt::format(", {} cannot be determined from a recording", n.unknown) : "",
                  checked.rig, checked.duration_s);
  for (const Expected& e : checked.expected)
    out += fmt::format("{:<15} {}: {}\n",
                       !e.known  ? "unknown"
                       : e.holds ? "holds"
                                 : "does not hold",
                       e.name(), e.known ? e.outcome() : "not in a recording");
  return out;
}

}  // namespace

int check_command(const CheckOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return report_error(overrides.error(), options.json);
  const Existing existing = options.force ? Existing::replace : Existing::keep;
  if (!options.junit.empty()) {
    InputFiles inputs;
    inputs.add("the recording", options.recording);
    inputs.add("the rig", options.rig);
    if (auto s = Outputs(std::move(inputs)).add(options.junit, "--junit", existing); !s)
      return report_error(s.error(), options.json);
  }
  std::optional<ProgressTask> reading(std::in_place, "read the recording");
  const auto checked = check_recorded_run(options.recording, {options.rig, *overrides});
  reading.reset();
  if (!checked) return report_error(checked.error(), options.json);
  if (checked->cut_short)
    write_stderr(
        fmt::format("rigor: warning: {}: the recording was cut short; its first {:.3f} s are judged\n",
                    options.recording.string(), checked->duration_s));
  if (checked->missing_samples > 0)
    write_stderr(
        fmt::format("rigor: warning: {}: its recorder had to skip {} samples that were visible; their "
                    "values are not judged\n",
                    options.recording.string(), checked->missing_samples));
  if (options.json)
    fmt::print("{}\n", json_text(to_json(*checked, options.recording)));
  else
    fmt::print("{}", to_text(*checked));
  if (!options.junit.empty()) {
    if (existing == Existing::keep)
      if (const auto kept = keep_earlier(options.junit); !kept) return report_error(kept.error(), false);
    if (auto s = write_output(options.junit,
                              junit_text(checked->expected, checked->rig, std::nullopt, checked->duration_s));
        !s)
      return report_error(s.error(), false);
  }
  return std::ranges::any_of(checked->expected, &Expected::fails) ? 1 : 0;
}

}  // namespace rigor

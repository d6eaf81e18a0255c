#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/analysis/check_recording.h"
#include "bench/analysis/data_check.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/expect/expected_forms.h"
#include "bench/files/output_file.h"
#include "bench/run/recording.h"
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

nlohmann::json to_json(const DataReport& report, const std::filesystem::path& recording) {
  nlohmann::json findings = nlohmann::json::array();
  for (const DataFinding& f : report.findings)
    findings.push_back({{"kind", f.kind},
                        {"topic", f.topic},
                        {"t_s", f.t_s},
                        {"log_time_ns", std::to_string(f.log_ns)},
                        {"value", f.value},
                        {"unit", f.unit},
                        {"text", f.text}});
  return {{"recording", recording.string()}, {"messages", report.messages},
          {"topics", report.topics},         {"judged_topics", report.judged},
          {"duration_s", report.duration_s}, {"good", report.good()},
          {"counts", report.counts},         {"not_listed", report.not_listed},
          {"findings", std::move(findings)}};
}

/// "data      2 findings in 2 of 12 topics, 1234 messages, 10.000 s", and a line for each.
std::string to_text(const DataReport& report) {
  std::uint64_t all = 0;
  for (const auto& [kind, n] : report.counts) all += n;
  std::string out =
      fmt::format("data      {} in {} messages of {} topics, {} of which have stamps or frames ({:.3f} s)\n",
                  all == 0   ? "nothing found"
                  : all == 1 ? "1 finding"
                             : fmt::format("{} findings", all),
                  report.messages, report.topics, report.judged, report.duration_s);
  for (const DataFinding& f : report.findings)
    out += fmt::format("{:<15} {} at {:.3f} s: {}\n", f.kind, f.topic.empty() ? "the file" : f.topic, f.t_s,
                       f.text);
  if (report.not_listed > 0)
    out += fmt::format("{:<15} {} more of the same kinds and topics\n", "", report.not_listed);
  return out;
}

int check_data_of(const CheckOptions& options) {
  if (!options.junit.empty())
    return report_error(
        {ErrorCode::bad_input, "--junit",
         "expected a recording whose rig has `expect:`, or a RIG that has it; findings in data "
         "are printed as text or, with --json, as JSON"},
        options.json);
  std::optional<ProgressTask> reading(std::in_place, "read the recording");
  const auto report = check_data(options.recording);
  reading.reset();
  if (!report) return report_error(report.error(), options.json);
  if (options.json)
    fmt::print("{}\n", json_text(to_json(*report, options.recording)));
  else
    fmt::print("{}", to_text(*report));
  return report->good() ? 0 : 1;
}

/// Whether nothing is expected: another program's recording, or that of a rig without `expect:`.
bool expects_nothing(const CheckOptions& options, const std::vector<ConfigOverride>& overrides) {
  if (!options.rig.empty()) return false;
  const auto run = read_recorded_run(options.recording);
  if (!run) return run.error().code == ErrorCode::bad_input || run.error().code == ErrorCode::protocol;
  const auto rig = recorded_rig(*run, options.recording, overrides);
  return rig && rig->expect.empty();
}

}  // namespace

int check_command(const CheckOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return report_error(overrides.error(), options.json);
  if (options.data || expects_nothing(options, *overrides)) return check_data_of(options);
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

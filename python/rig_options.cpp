#include "python/rig_options.h"

#include <pybind11/stl.h>

#include "bench/files/installed_configs.h"

namespace rigor::python {

RigOptions::RigOptions(const pybind11::dict& given) {
  const auto read = [&](const char* key, auto& value) {
    value = given[key].cast<std::remove_reference_t<decltype(value)>>();
  };
  read("set", set);
  read("clock", clock);
  read("record", record);
  read("report", report);
  read("trace", trace);
  read("junit", junit);
  read("faults_from", faults_from);
  read("fail_on", fail_on);
  read("duration_s", duration_s);
  read("live", live);
  read("pace", pace);
  read("workers", workers);
  read("replace", replace);
  read("control", control);
}

Result<RigConfig> RigOptions::load(const std::string& file) const {
  std::vector<ConfigOverride> overrides;
  for (const std::string& text : set) {
    auto o = ConfigOverride::parse(text);
    if (!o) return tl::unexpected<Error>(o.error());
    overrides.push_back(std::move(*o));
  }
  auto rig = load_rig(find_config(file), overrides);
  if (!rig) return rig;
  if (clock == "wall") rig->clock = ClockKind::wall;
  if (clock == "virtual") rig->clock = ClockKind::virtual_time;
  if (workers > 0) rig->simulation.workers = workers;
  if (duration_s) rig->duration = seconds_from(*duration_s);
  // "-": none, whatever the rig says.
  if (!record.empty()) rig->record.file = record == "-" ? "" : record;
  if (!report.empty()) rig->report = report == "-" ? "" : report;
  if (rig->clock == ClockKind::virtual_time && rig->duration.ns() == 0)
    return fail(ErrorCode::bad_input, file,
                "expected `duration_s` for a run in virtual time, which would otherwise never end; or give "
                "duration_s=");
  return rig;
}

Result<BenchOptions> RigOptions::bench_options() const {
  const auto findings = findings_named(fail_on);
  if (!findings) return tl::unexpected<Error>(findings.error());
  BenchOptions how;
  how.replace = replace;
  how.trace = trace;
  how.junit = junit;
  how.faults_from = faults_from;
  how.control = control;
  how.pace = pace;
  how.fail_on = *findings;
  return how;
}

}  // namespace rigor::python

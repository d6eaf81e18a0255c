#include "cli/inspect_fmu.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "sensor-hal/config/yaml.h"
#include "sim/fmu/unpacked_fmu.h"

namespace rigor {
namespace {

using nlohmann::json;

std::string interfaces_of(const fmu::ModelDescription& d) {
  std::vector<std::string> words;
  if (d.co_simulation) words.emplace_back("co-simulation");
  if (d.model_exchange) words.emplace_back("model exchange");
  if (d.scheduled_execution) words.emplace_back("scheduled execution");
  return joined_or_none(words);
}

json number_or_null(const std::optional<double>& value) { return value ? json(*value) : json(); }

json to_json(const std::string& file, const fmu::FmuFile& f) {
  const fmu::ModelDescription& d = f.description;
  json variables = json::array(), units = json::array(), terminals = json::array();
  for (const fmu::Variable& v : d.variables)
    variables.push_back({{"name", v.name},
                         {"type", fmu::name_of(v.type)},
                         {"causality", fmu::name_of(v.causality)},
                         {"variability", fmu::name_of(v.variability)},
                         {"unit", v.unit},
                         {"dimensions", v.dimensions},
                         {"start", v.start},
                         {"description", v.description}});
  for (const fmu::Unit& u : d.units)
    units.push_back({{"name", u.name}, {"factor", u.factor}, {"offset", u.offset}, {"defined", u.has_base}});
  for (const fmu::Terminal& t : d.terminals) {
    json members = json::object();
    for (const auto& m : t.members) members[m.name] = m.variable;
    terminals.push_back({{"name", t.name}, {"kind", t.kind}, {"members", members}});
  }
  json j{{"file", file},
         {"format", "FMU"},
         {"fmi_version", d.fmi_version},
         {"model", d.model_name},
         {"description", d.description},
         {"generation_tool", d.generation_tool},
         {"model_exchange", d.model_exchange},
         {"scheduled_execution", d.scheduled_execution},
         {"platforms", f.platforms},
         {"experiment",
          {{"start_s", number_or_null(d.start_time_s)},
           {"stop_s", number_or_null(d.stop_time_s)},
           {"step_s", number_or_null(d.step_s)}}},
         {"variables", variables},
         {"units", units},
         {"terminals", terminals}};
  if (d.co_simulation) {
    const fmu::CoSimulation& c = *d.co_simulation;
    j["co_simulation"] = {{"model_identifier", c.model_identifier},
                          {"variable_step", c.variable_step},
                          {"event_mode", c.event_mode},
                          {"might_return_early", c.might_return_early},
                          {"once_per_process", c.once_per_process},
                          {"needs_execution_tool", c.needs_execution_tool},
                          {"fixed_internal_step_s", number_or_null(c.fixed_internal_step_s)}};
  } else {
    j["co_simulation"] = nullptr;
  }
  return j;
}

std::string to_text(const std::string& file, const fmu::FmuFile& f) {
  const fmu::ModelDescription& d = f.description;
  std::string t =
      fmt::format("{}: FMU of {}, FMI {}: {}\n", file, d.model_name, d.fmi_version, interfaces_of(d));
  if (!d.description.empty()) t += fmt::format("  {}\n", d.description);
  if (!d.generation_tool.empty()) t += fmt::format("  made by      {}\n", d.generation_tool);
  t += fmt::format("  binaries     {}\n", joined_or_none(f.platforms));
  if (d.co_simulation) {
    const fmu::CoSimulation& c = *d.co_simulation;
    std::vector<std::string> can;
    if (c.variable_step) can.emplace_back("variable step");
    if (c.event_mode) can.emplace_back("event mode");
    if (c.might_return_early) can.emplace_back("early return");
    if (c.once_per_process) can.emplace_back("once in a process");
    if (c.needs_execution_tool) can.emplace_back("needs its tool");
    if (c.fixed_internal_step_s)
      can.push_back(fmt::format("internal step {:g} ms", *c.fixed_internal_step_s * 1e3));
    t += fmt::format("  capabilities {}\n", joined_or_none(can));
  }
  if (d.step_s || d.stop_time_s)
    t += fmt::format("  experiment   from {:g} s to {} s, step {}\n", d.start_time_s.value_or(0),
                     d.stop_time_s ? fmt::format("{:g}", *d.stop_time_s) : "?",
                     d.step_s ? fmt::format("{:g} ms", *d.step_s * 1e3) : "not given");
  for (const fmu::Terminal& terminal : d.terminals) {
    std::vector<std::string> members;
    for (const auto& m : terminal.members)
      members.push_back(fmt::format("{}.{} = {}", terminal.name, m.name, m.variable));
    t += fmt::format("  terminal     {}\n", fmt::join(members, ", "));
  }
  std::size_t widest = 8;
  for (const fmu::Variable& v : d.variables) widest = std::max(widest, v.name.size());
  widest = std::min<std::size_t>(widest, 48);
  t += fmt::format("  {:<{}}  {:<11}  {:<19}  {:<11}  {:<8}  start\n", "variable", widest, "type",
                   "causality", "variability", "unit");
  for (const fmu::Variable& v : d.variables) {
    std::string start = v.start;
    if (!v.dimensions.empty()) start = fmt::format("[{}] {}", fmt::join(v.dimensions, " x "), start);
    t += fmt::format("  {:<{}}  {:<11}  {:<19}  {:<11}  {:<8}  {}", v.name, widest, fmu::name_of(v.type),
                     fmu::name_of(v.causality), fmu::name_of(v.variability), v.unit, start);
    while (t.back() == ' ') t.pop_back();
    t += '\n';
  }
  return t;
}

}  // namespace

bool is_fmu(const std::filesystem::path& file) { return file.extension() == ".fmu"; }

int inspect_fmu_command(const InspectOptions& options) {
  const std::string file = options.file.string();
  if (options.repair)
    return report_error({ErrorCode::bad_input, file,
                         "expected a recording of Rigor (MCAP), got an FMU: there is nothing to repair"},
                        options.json);
  const auto read = fmu::read_fmu(options.file);
  if (!read) return report_error(read.error(), options.json);
  fmt::print("{}", options.json ? json_text(to_json(file, *read)) + "\n" : to_text(file, *read));
  return 0;
}

}  // namespace rigor

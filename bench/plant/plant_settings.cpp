#include "bench/plant/plant_settings.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>

#include "sensor-hal/config/did_you_mean.h"
#include "sim/fmu/variable_access.h"

namespace rigor::plant {
namespace {

using fmu::Causality;
using fmu::ModelDescription;
using fmu::Variability;
using fmu::Variable;

constexpr std::size_t kMaxSignals = 4096;

/// Index of a variable among those that are set or read, and the position of its first value.
std::size_t position_of(std::vector<std::size_t>& variables, std::size_t variable,
                        const ModelDescription& d) {
  std::size_t at = 0;
  for (const std::size_t v : variables) {
    if (v == variable) return at;
    at += d.variables[v].elements;
  }
  variables.push_back(variable);
  return at;
}

/// "[2,3]" of element 5 of an array of 3 by 3.
std::string index_text(const Variable& v, std::size_t element) {
  std::vector<std::size_t> index(v.dimensions.size());
  for (std::size_t k = v.dimensions.size(); k-- > 0;) {
    index[k] = element % v.dimensions[k] + 1;
    element /= v.dimensions[k];
  }
  return fmt::format("[{}]", fmt::join(index, ","));
}

class Reader {
 public:
  Reader(ModelDescription& d, PlantSettings& s) : d_(d), s_(s) {}

  void read_signals(const ConfigNode& plant) {
    const ConfigNode map = plant.map_or_absent("signals");
    if (!map.present()) {
      for (std::size_t i = 0; i < d_.variables.size(); ++i) {
        const Variable& v = d_.variables[i];
        if ((v.causality != Causality::input && v.causality != Causality::output) || !fmu::is_number(v.type))
          continue;
        add(plant, "signals", v.name, {i, 0, !v.dimensions.empty()}, v.causality == Causality::input, v.unit,
            {}, 1e-3);
      }
      return;
    }
    for (const std::string& name : map.keys()) {
      if (const std::string variable = map.scalar_or_empty(name); !variable.empty()) {
        (void)map.text(name);
        read_signal(map, name, name, variable, ConfigNode());
      } else {
        const ConfigNode n = map.map(name);
        read_signal(n, "variable", name, n.text_or("variable", name), n);
        n.finish();
      }
    }
  }
  /// Where inputs start: as the FMU or the rig says.
  void set_input_start() {
    for (const std::size_t i : s_.inputs) {
      const Variable& v = d_.variables[i];
      std::string text = v.start;
      for (const auto& [name, value] : s_.start_values)
        if (name == v.name) text = value;
      std::istringstream in(text);
      for (std::size_t k = 0; k < v.elements; ++k) {
        std::string word;
        in >> word;
        s_.input_start.push_back(word == "true" ? 1 : std::strtod(word.c_str(), nullptr));
      }
    }
  }

 private:
  /// `place`, `key`: of the variable's name in the rig; `n`: the signal's keys, absent of the short form.
  void read_signal(const ConfigNode& place, const std::string& key, const std::string& name,
                   const std::string& variable, const ConfigNode& n) {
    const auto found = d_.find(variable);
    if (!found)
      throw place.error(
          key, fmt::format("expected a variable of the FMU, got \"{}\"{}; its outputs are: {}; its "
                           "inputs are: {}; `rigor inspect {}` lists all",
                           variable, did_you_mean(variable, d_.names_of({})),
                           joined_or_none(d_.names_of({Causality::output})),
                           joined_or_none(d_.names_of({Causality::input})), s_.file.filename().string()));
    const Variable& v = d_.variables[found->variable];
    if (!fmu::is_number(v.type))
      throw place.error(key, fmt::format("expected a variable whose values are numbers, got {} of type {}",
                                         v.name, fmu::name_of(v.type)));
    check(n, v);
    const bool tunable = v.causality == Causality::parameter && v.variability == Variability::tunable;
    const bool commanded = n.flag_or("commanded", v.causality == Causality::input);
    if (commanded && v.causality != Causality::input && !tunable)
      throw n.error("commanded",
                    fmt::format("expected an input or a tunable parameter, got {}, which is of causality "
                                "{} and variability {}",
                                v.name, fmu::name_of(v.causality), fmu::name_of(v.variability)));
    std::string unit = n.text_or("unit", v.unit);
    fmu::Conversion conversion;
    if (!v.unit.empty()) {
      std::string why;
      const auto known = fmu::conversion(d_, v.unit, unit, why);
      if (!known)
        throw n.error(
            "unit", fmt::format("expected {}, the unit of {}, or one that it can be converted to, got {}: {}",
                                v.unit, v.name, unit, why));
      conversion = *known;
    }
    add(place, key, name, *found, commanded, std::move(unit), conversion,
        n.number_or("register_step", 1e-3, {.min = 0, .exclusive_min = true}));
  }
  void check(const ConfigNode& n, const Variable& v) {
    const auto same = [&](const char* key, std::string_view own) {
      const std::string asked = n.text_or(key, std::string(own));
      if (asked != own)
        throw n.error(key,
                      fmt::format("expected {}, which is the {} of {}, got {}", own, key, v.name, asked));
    };
    same("type", fmu::name_of(v.type));
    same("causality", fmu::name_of(v.causality));
    same("variability", fmu::name_of(v.variability));
  }
  void add(const ConfigNode& place, const std::string& key, const std::string& name,
           const ModelDescription::Element& element, bool commanded, std::string unit,
           fmu::Conversion conversion, double register_step) {
    const Variable& v = d_.variables[element.variable];
    const std::size_t first = position_of(commanded ? s_.inputs : s_.outputs, element.variable, d_);
    const std::size_t count = element.whole ? v.elements : 1;
    for (std::size_t i = 0; i < count; ++i) {
      PlantSignal signal{element.whole ? name + index_text(v, i) : name,
                         unit,
                         commanded,
                         first + element.element + i,
                         v.type,
                         conversion,
                         register_step};
      if (!names_.insert(signal.name).second)
        throw place.error(key,
                          fmt::format("expected names of their own for signals, got {} twice", signal.name));
      if (s_.signals.size() == kMaxSignals)
        throw place.error(key,
                          fmt::format("expected at most {} signals, got more; name those that are used with "
                                      "`signals`",
                                      kMaxSignals));
      s_.signals.push_back(std::move(signal));
    }
  }

  ModelDescription& d_;
  PlantSettings& s_;
  std::set<std::string> names_;
};

Duration from_ms(double ms) { return Duration(std::llround(ms * 1e6)); }

}  // namespace

std::filesystem::path fmu_file_of(const PlantEntry& entry) {
  const std::string file = entry.node.text("fmu");
  return entry.node.base_dir() / file;
}

PlantSettings read_plant(const PlantEntry& entry, ModelDescription& d) {
  const ConfigNode& n = entry.node;
  PlantSettings s;
  s.name = entry.name;
  s.file = fmu_file_of(entry);
  const double default_step_ms = d.step_s && *d.step_s > 0 ? *d.step_s * 1e3 : 10;
  s.step = from_ms(n.number_or("step_ms", default_step_ms, {.min = 0.01, .max = 1e6}));
  const double fixed_s = d.co_simulation->fixed_internal_step_s.value_or(0);
  if (!d.co_simulation->variable_step && fixed_s > 0 &&
      std::abs(s.step.seconds() / fixed_s - std::round(s.step.seconds() / fixed_s)) > 1e-6)
    throw n.error("step_ms",
                  fmt::format("expected a multiple of {:g} ms, the fixed step of the FMU, got {:g}",
                              fixed_s * 1e3, s.step.seconds() * 1e3));
  s.start_time_s = n.number_or("start_time_s", d.start_time_s.value_or(0));
  s.sandbox = n.flag_or("sandbox", true);
  s.deadline = from_ms(n.number_or("deadline_ms", s.step.seconds() * 1e3, {.min = 0.001, .max = 1e6}));
  s.limits.answer = seconds_from(n.number_or("answer_timeout_s", 5, {.min = 0.01, .max = 3600}));
  s.limits.start = seconds_from(n.number_or("start_timeout_s", 30, {.min = 0.1, .max = 3600}));
  s.restart = n.choice_or("on_fault", {"disconnect", "restart"}, "disconnect") == "restart";
  s.restart_after = from_ms(n.number_or("restart_after_ms", 100, {.min = 0, .max = 1e7}));
  if (const ConfigNode values = n.map_or_absent("start_values"); values.present())
    for (const std::string& name : values.keys()) {
      s.start_values.emplace_back(name, values.text(name));
      if (auto applied = fmu::apply_start_values(d, {s.start_values.back()}, ""); !applied)
        throw values.error(name, applied.error().message);
    }
  Reader reader(d, s);
  reader.read_signals(n);
  reader.set_input_start();
  if (s.signals.empty())
    throw n.error(
        "", "expected an FMU with numeric inputs or outputs, or `signals` that name variables, found none");
  n.finish();
  return s;
}

}  // namespace rigor::plant

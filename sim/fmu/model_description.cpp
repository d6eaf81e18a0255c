#include "sim/fmu/model_description.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <pugixml.hpp>
#include <unordered_set>

namespace rigor::fmu {
namespace {

constexpr std::array<std::string_view, 15> kTypeNames{"Float32", "Float64",     "Int8",   "UInt8",  "Int16",
                                                      "UInt16",  "Int32",       "UInt32", "Int64",  "UInt64",
                                                      "Boolean", "Enumeration", "String", "Binary", "Clock"};
constexpr std::array<std::string_view, 8> kCausalityNames{
    "parameter", "calculatedParameter", "structuralParameter", "input", "output", "local", "independent",
    "dependent"};
constexpr std::array<std::string_view, 5> kVariabilityNames{"constant", "fixed", "tunable", "discrete",
                                                            "continuous"};

template <class E, std::size_t N>
std::optional<E> value_of(const std::array<std::string_view, N>& names, std::string_view word) {
  const auto it = std::find(names.begin(), names.end(), word);
  if (it == names.end()) return std::nullopt;
  return static_cast<E>(it - names.begin());
}

/// What went wrong, thrown to parse_model_description.
struct Refused {
  pugi::xml_node node;
  std::string message;
};

std::size_t line_at(std::string_view xml, std::ptrdiff_t offset) {
  const auto end = static_cast<std::size_t>(
      std::clamp<std::ptrdiff_t>(offset, 0, static_cast<std::ptrdiff_t>(xml.size())));
  return 1 + static_cast<std::size_t>(
                 std::count(xml.begin(), xml.begin() + static_cast<std::ptrdiff_t>(end), '\n'));
}

std::string text_of(pugi::xml_node n, const char* key) { return n.attribute(key).as_string(); }
std::string required(pugi::xml_node n, const char* key) {
  if (!n.attribute(key)) throw Refused{n, std::string("<") + n.name() + "> has no attribute " + key};
  return n.attribute(key).as_string();
}
bool flag(pugi::xml_node n, const char* key) {
  const std::string_view word = n.attribute(key).as_string();
  return word == "true" || word == "1";
}

template <class T>
std::optional<T> parse(std::string_view word) {
  T value{};
  while (!word.empty() && (word.front() == ' ' || word.front() == '+')) word.remove_prefix(1);
  while (!word.empty() && word.back() == ' ') word.remove_suffix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size()) return std::nullopt;
  return value;
}
std::optional<double> number(pugi::xml_node n, const char* key) {
  if (!n.attribute(key)) return std::nullopt;
  const auto value = parse<double>(n.attribute(key).as_string());
  if (!value || !std::isfinite(*value))
    throw Refused{
        n, std::string("expected a number for ") + key + ", got \"" + n.attribute(key).as_string() + "\""};
  return value;
}
std::uint32_t reference(pugi::xml_node n, const char* key) {
  const auto value = parse<std::uint32_t>(required(n, key));
  if (!value)
    throw Refused{n, std::string("expected a whole number for ") + key + ", got \"" +
                         n.attribute(key).as_string() + "\""};
  return *value;
}

Unit read_unit(pugi::xml_node n) {
  Unit u;
  u.name = required(n, "name");
  const pugi::xml_node base = n.child("BaseUnit");
  u.has_base = static_cast<bool>(base);
  const char* const names[] = {"kg", "m", "s", "A", "K", "mol", "cd", "rad"};
  for (std::size_t i = 0; i < u.exponents.size(); ++i) u.exponents[i] = base.attribute(names[i]).as_int();
  u.factor = number(base, "factor").value_or(1);
  u.offset = number(base, "offset").value_or(0);
  return u;
}

/// Units of declared types by their names.
using TypeUnits = std::map<std::string, std::string, std::less<>>;
TypeUnits read_types(pugi::xml_node definitions, FmiVersion version) {
  TypeUnits units;
  for (const pugi::xml_node type : definitions.children()) {
    const pugi::xml_node with_unit = version == FmiVersion::v2 ? type.first_child() : type;
    if (with_unit.attribute("unit")) units[text_of(type, "name")] = text_of(with_unit, "unit");
  }
  return units;
}

void read_kind(pugi::xml_node n, Variable& v) {
  const std::string causality = n.attribute("causality").as_string("local");
  const auto c = value_of<Causality>(kCausalityNames, causality);
  if (!c) throw Refused{n, v.name + ": unknown causality \"" + causality + "\""};
  v.causality = *c;
  // Without the attribute: of parameters fixed, of real numbers continuous, else discrete (2.4.7.4 of
  // FMI 3.0.2).
  const bool parameter = v.causality == Causality::parameter ||
                         v.causality == Causality::calculated_parameter ||
                         v.causality == Causality::structural_parameter;
  const bool real = v.type == VariableType::float64 || v.type == VariableType::float32;
  const std::string variability = n.attribute("variability")
                                      .as_string(parameter ? "fixed"
                                                 : real    ? "continuous"
                                                           : "discrete");
  const auto w = value_of<Variability>(kVariabilityNames, variability);
  if (!w) throw Refused{n, v.name + ": unknown variability \"" + variability + "\""};
  v.variability = *w;
}

Variable read_variable2(pugi::xml_node n, const TypeUnits& units) {
  Variable v;
  v.name = required(n, "name");
  v.description = text_of(n, "description");
  v.value_reference = reference(n, "valueReference");
  pugi::xml_node type;
  for (const auto& [name, t] : {std::pair{"Real", VariableType::float64},
                                {"Integer", VariableType::int32},
                                {"Boolean", VariableType::boolean},
                                {"String", VariableType::string},
                                {"Enumeration", VariableType::enumeration}})
    if (n.child(name)) type = n.child(name), v.type = t;
  if (!type)
    throw Refused{n, v.name + ": expected one of <Real>, <Integer>, <Boolean>, <String>, <Enumeration>"};
  v.unit = text_of(type, "unit");
  if (const auto it = units.find(type.attribute("declaredType").as_string());
      v.unit.empty() && it != units.end())
    v.unit = it->second;
  v.start = text_of(type, "start");
  read_kind(n, v);
  return v;
}

Variable read_variable3(pugi::xml_node n, VariableType type, const TypeUnits& units) {
  Variable v;
  v.type = type;
  v.name = required(n, "name");
  v.description = text_of(n, "description");
  v.value_reference = reference(n, "valueReference");
  v.unit = text_of(n, "unit");
  if (const auto it = units.find(n.attribute("declaredType").as_string());
      v.unit.empty() && it != units.end())
    v.unit = it->second;
  v.start = text_of(n, "start");
  if (v.start.empty()) v.start = n.child("Start").attribute("value").as_string();
  read_kind(n, v);
  for (const pugi::xml_node d : n.children("Dimension")) {
    if (v.dimensions.size() == 8) throw Refused{n, v.name + ": expected at most 8 dimensions"};
    if (d.attribute("valueReference")) {
      v.dimension_references.emplace_back(reference(d, "valueReference"));
      v.dimensions.push_back(0);  // by resolve_dimensions
    } else {
      v.dimension_references.emplace_back(std::nullopt);
      v.dimensions.push_back(reference(d, "start"));
    }
  }
  return v;
}

/// Sizes of arrays from the start values of structural parameters and constants. Empty: good.
std::string resolve_dimensions(ModelDescription& d) {
  std::map<std::uint32_t, std::size_t> by_reference;
  for (std::size_t i = 0; i < d.variables.size(); ++i)
    by_reference.emplace(d.variables[i].value_reference, i);
  std::size_t total = 0;
  for (Variable& v : d.variables) {
    std::size_t product = 1;
    for (std::size_t k = 0; k < v.dimensions.size(); ++k) {
      if (const auto ref = v.dimension_references[k]) {
        const auto it = by_reference.find(*ref);
        const auto size =
            it == by_reference.end() ? std::nullopt : parse<std::uint32_t>(d.variables[it->second].start);
        if (!size)
          return v.name + ": its dimension refers to the value reference " + std::to_string(*ref) +
                 ", which is no variable with a whole number as start value";
        v.dimensions[k] = *size;
      }
      if (v.dimensions[k] > kMaxElements || product * v.dimensions[k] > kMaxElements)
        return v.name + ": expected an array of at most " + std::to_string(kMaxElements) +
               " elements, got more";
      product *= v.dimensions[k];
    }
    v.elements = product;
    total += product;
    if (total > kMaxTotalElements)
      return "expected at most " + std::to_string(kMaxTotalElements) + " values in all, got more";
  }
  return {};
}

bool is_identifier(std::string_view word) {
  return !word.empty() && word.size() <= 256 && !(word[0] >= '0' && word[0] <= '9') &&
         word.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_") ==
             std::string_view::npos;
}

CoSimulation read_co_simulation(pugi::xml_node n) {
  CoSimulation c;
  c.model_identifier = required(n, "modelIdentifier");
  if (!is_identifier(c.model_identifier))
    throw Refused{n, "expected an identifier of C as modelIdentifier, got \"" + c.model_identifier + "\""};
  c.variable_step = flag(n, "canHandleVariableCommunicationStepSize");
  c.event_mode = flag(n, "hasEventMode");
  c.might_return_early = flag(n, "mightReturnEarlyFromDoStep");
  c.once_per_process = flag(n, "canBeInstantiatedOnlyOncePerProcess");
  c.needs_execution_tool = flag(n, "needsExecutionTool");
  c.fixed_internal_step_s = number(n, "fixedInternalStepSize");
  return c;
}

void read_variables(pugi::xml_node list, const TypeUnits& units, ModelDescription& d) {
  std::unordered_set<std::string> names;
  const auto add = [&](pugi::xml_node n, Variable v) {
    if (!names.insert(v.name).second)
      throw Refused{n, "expected a name for each variable, got \"" + v.name + "\" twice"};
    d.variables.push_back(std::move(v));
  };
  for (const pugi::xml_node n : list.children()) {
    if (n.type() != pugi::node_element) continue;
    if (d.variables.size() >= kMaxVariables)
      throw Refused{n, "expected at most " + std::to_string(kMaxVariables) + " variables, got more"};
    if (d.version == FmiVersion::v2) {
      if (std::string_view(n.name()) == "ScalarVariable") add(n, read_variable2(n, units));
      continue;
    }
    const auto type = value_of<VariableType>(kTypeNames, n.name());
    if (!type) throw Refused{n, std::string("unknown type of a variable: <") + n.name() + ">"};
    const Variable base = read_variable3(n, *type, units);
    add(n, base);
    for (const pugi::xml_node alias : n.children("Alias")) {
      if (d.variables.size() >= kMaxVariables) break;
      Variable a = base;
      a.name = required(alias, "name");
      a.description = text_of(alias, "description");
      add(alias, std::move(a));
    }
  }
}

ModelDescription read(pugi::xml_node root) {
  ModelDescription d;
  d.fmi_version = required(root, "fmiVersion");
  if (d.fmi_version.starts_with("2."))
    d.version = FmiVersion::v2;
  else if (d.fmi_version.starts_with("3."))
    d.version = FmiVersion::v3;
  else
    throw Refused{root, "expected fmiVersion 2.0 or 3.0, got \"" + d.fmi_version + "\""};
  d.model_name = required(root, "modelName");
  d.token = required(root, d.version == FmiVersion::v2 ? "guid" : "instantiationToken");
  d.description = text_of(root, "description");
  d.generation_tool = text_of(root, "generationTool");
  if (const auto n = root.child("CoSimulation")) d.co_simulation = read_co_simulation(n);
  d.model_exchange = static_cast<bool>(root.child("ModelExchange"));
  d.scheduled_execution = static_cast<bool>(root.child("ScheduledExecution"));
  const pugi::xml_node experiment = root.child("DefaultExperiment");
  d.start_time_s = number(experiment, "startTime");
  d.stop_time_s = number(experiment, "stopTime");
  d.step_s = number(experiment, "stepSize");
  for (const pugi::xml_node n : root.child("UnitDefinitions").children("Unit"))
    d.units.push_back(read_unit(n));
  read_variables(root.child("ModelVariables"), read_types(root.child("TypeDefinitions"), d.version), d);
  if (const std::string why = resolve_dimensions(d); !why.empty())
    throw Refused{root.child("ModelVariables"), why};
  return d;
}

Result<std::unique_ptr<pugi::xml_document>> load(std::string_view xml, const std::string& where) {
  if (xml.size() > kMaxDescriptionBytes)
    return fail(ErrorCode::bad_input, where,
                "expected at most " + std::to_string(kMaxDescriptionBytes >> 20) + " MiB, got more");
  auto document = std::make_unique<pugi::xml_document>();
  if (const auto parsed = document->load_buffer(xml.data(), xml.size()); !parsed)
    return fail(ErrorCode::bad_input, where + ":" + std::to_string(line_at(xml, parsed.offset)),
                std::string("expected XML: ") + parsed.description());
  return document;
}

}  // namespace

std::string_view name_of(VariableType type) { return kTypeNames[static_cast<std::size_t>(type)]; }
std::string_view name_of(Causality c) { return kCausalityNames[static_cast<std::size_t>(c)]; }
std::string_view name_of(Variability v) { return kVariabilityNames[static_cast<std::size_t>(v)]; }
bool is_number(VariableType type) { return type <= VariableType::enumeration; }

const Unit* ModelDescription::unit(std::string_view name) const {
  const auto it = std::find_if(units.begin(), units.end(), [&](const Unit& u) { return u.name == name; });
  return it == units.end() ? nullptr : &*it;
}

std::optional<ModelDescription::Element> ModelDescription::find(std::string_view name) const {
  const auto exact = [&](std::string_view word) -> std::optional<std::size_t> {
    const auto it =
        std::find_if(variables.begin(), variables.end(), [&](const Variable& v) { return v.name == word; });
    if (it == variables.end()) return std::nullopt;
    return static_cast<std::size_t>(it - variables.begin());
  };
  if (const auto i = exact(name)) return Element{*i, 0, !variables[*i].dimensions.empty()};
  if (const std::size_t open = name.rfind('['); name.ends_with(']') && open != std::string_view::npos) {
    const auto i = exact(name.substr(0, open));
    if (!i) return std::nullopt;
    std::string_view rest = name.substr(open + 1, name.size() - open - 2);
    std::size_t element = 0;
    for (std::size_t k = 0; k < variables[*i].dimensions.size(); ++k) {
      const std::size_t comma = rest.find(',');
      const auto index = parse<std::uint32_t>(rest.substr(0, comma));
      const bool last = k + 1 == variables[*i].dimensions.size();
      if (!index || *index < 1 || *index > variables[*i].dimensions[k] ||
          last != (comma == std::string_view::npos))
        return std::nullopt;
      element = element * variables[*i].dimensions[k] + *index - 1;
      if (!last) rest.remove_prefix(comma + 1);
    }
    if (variables[*i].dimensions.empty()) return std::nullopt;
    return Element{*i, element, false};
  }
  for (const Terminal& t : terminals)
    if (name.size() > t.name.size() + 1 && name.starts_with(t.name) && name[t.name.size()] == '.')
      for (const Terminal::Member& m : t.members)
        if (m.name == name.substr(t.name.size() + 1))
          if (const auto i = exact(m.variable)) return Element{*i, 0, !variables[*i].dimensions.empty()};
  return std::nullopt;
}

std::vector<std::string> ModelDescription::names_of(std::initializer_list<Causality> causalities) const {
  std::vector<std::string> names;
  for (const Variable& v : variables)
    if (causalities.size() == 0 ||
        std::find(causalities.begin(), causalities.end(), v.causality) != causalities.end())
      names.push_back(v.name);
  return names;
}

Result<ModelDescription> parse_model_description(std::string_view xml, const std::string& where) {
  const auto document = load(xml, where);
  if (!document) return tl::unexpected<Error>(document.error());
  const pugi::xml_node root = (*document)->document_element();
  if (std::string_view(root.name()) != "fmiModelDescription")
    return fail(ErrorCode::bad_input, where,
                std::string("expected <fmiModelDescription>, got <") + root.name() + ">");
  try {
    return read(root);
  } catch (const Refused& e) {
    return fail(ErrorCode::bad_input, where + ":" + std::to_string(line_at(xml, e.node.offset_debug())),
                e.message);
  }
}

Status parse_terminals(std::string_view xml, const std::string& where, ModelDescription& description) {
  const auto document = load(xml, where);
  if (!document) return tl::unexpected<Error>(document.error());
  const pugi::xml_node root = (*document)->document_element();
  if (std::string_view(root.name()) != "fmiTerminalsAndIcons")
    return fail(ErrorCode::bad_input, where,
                std::string("expected <fmiTerminalsAndIcons>, got <") + root.name() + ">");
  for (const pugi::xml_node n : root.child("Terminals").children("Terminal")) {
    if (description.terminals.size() >= 10'000)
      return fail(ErrorCode::bad_input, where, "expected at most 10000 terminals, got more");
    Terminal t{text_of(n, "name"), text_of(n, "matchingRule"), text_of(n, "terminalKind"), {}};
    for (const pugi::xml_node m : n.children("TerminalMemberVariable")) {
      const std::string variable = text_of(m, "variableName");
      t.members.push_back({m.attribute("memberName").as_string(variable.c_str()), variable});
    }
    description.terminals.push_back(std::move(t));
  }
  return {};
}

Status set_structural_parameter(ModelDescription& description, std::uint32_t value_reference,
                                std::uint64_t value, const std::string& where) {
  for (Variable& v : description.variables)
    if (v.value_reference == value_reference) v.start = std::to_string(value);
  if (const std::string why = resolve_dimensions(description); !why.empty())
    return fail(ErrorCode::bad_input, where, why);
  return {};
}

}  // namespace rigor::fmu

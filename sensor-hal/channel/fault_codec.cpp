// Faults as text: JSON for programs and recordings, YAML in one line for people. One list of keys stands
// behind both.
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>
#include <utility>

#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/config/json_text.h"

namespace rigor {
namespace {

using Entries = nlohmann::ordered_json;

// By a division, so that a number with a few digits comes out as it was written.
double in_s(Duration d) { return static_cast<double>(d.ns()) / 1e9; }
double in_ms(Duration d) { return static_cast<double>(d.ns()) / 1e6; }

Entries trigger_entries(const FaultTrigger& t) {
  Entries e{{"channel", t.channel}};
  switch (t.when) {
    case FaultTrigger::When::overdue:
      e["is"] = "overdue";
      break;
    case FaultTrigger::When::disconnected:
      e["is"] = "disconnected";
      break;
    case FaultTrigger::When::above:
    case FaultTrigger::When::below:
      e["value"] = t.value;
      e[t.when == FaultTrigger::When::above ? "above" : "below"] = t.threshold;
      break;
    case FaultTrigger::When::always:
      break;
  }
  return e;
}

void add_own_keys(const FaultSpec& f, Entries& e) {
  switch (f.kind) {
    case FaultKind::burst_loss:
      e["share"] = f.share;
      e["mean_burst"] = f.mean_burst;
      break;
    case FaultKind::delay:
      e["delay_ms"] = in_ms(f.delay);
      break;
    case FaultKind::jitter:
      if (f.shape == JitterShape::uniform) {
        if (f.jitter_a.ns() != 0) e["min_ms"] = in_ms(f.jitter_a);
        e["max_ms"] = in_ms(f.jitter_b);
        break;
      }
      e["shape"] = f.shape == JitterShape::normal ? "normal" : "exponential";
      e["mean_ms"] = in_ms(f.jitter_a);
      if (f.shape == JitterShape::normal) e["sigma_ms"] = in_ms(f.jitter_b);
      break;
    case FaultKind::stuck:
      if (f.freeze) e["freeze"] = true;
      break;
    case FaultKind::bias:
    case FaultKind::drift:
    case FaultKind::noise:
    case FaultKind::spike:
      if (!f.dbc.empty()) e["dbc"] = f.dbc;
      if (!f.value.empty()) e["value"] = f.value;
      e[f.kind == FaultKind::drift   ? fault_key("rate", f.unit, "_per_s")
        : f.kind == FaultKind::noise ? fault_key("sigma", f.unit)
                                     : fault_key("amount", f.unit)] = f.amount;
      if (f.element_share) e["share"] = *f.element_share;
      break;
    case FaultKind::corrupt:
      e["flips"] = f.flips;
      if (f.keep < 1) e["keep"] = f.keep;
      if (!f.flagged) e["flagged"] = false;
      break;
    case FaultKind::timestamp:
      e["offset_ms"] = in_ms(f.delay);
      break;
    case FaultKind::clock_skew:
      e["ppm"] = f.ppm;
      break;
    case FaultKind::clock_step:
      e["step_ms"] = in_ms(f.delay);
      break;
    case FaultKind::slow_consumer:
      if (!f.hold) break;
      e["mode"] = "hold";
      e["leases"] = f.leases;
      break;
    case FaultKind::drop:
    case FaultKind::disconnect:
      break;
  }
  // Of a spike the default is another one.
  if (f.probability < 1 || f.kind == FaultKind::spike) e["probability"] = f.probability;
}

Entries entries(const FaultSpec& f) {
  Entries e{{"kind", std::string(fault_kind_name(f.kind))}};
  add_own_keys(f, e);
  if (f.from.ns() != 0) e["from_s"] = in_s(f.from);
  if (f.until != FaultSpec{}.until) e["until_s"] = in_s(f.until);
  if (f.every.ns() != 0) e["every_s"] = in_s(f.every);
  if (f.on_for.ns() != 0) e["for_s"] = in_s(f.on_for);
  if (f.trigger.when != FaultTrigger::When::always) e["when"] = trigger_entries(f.trigger);
  return e;
}

/// 80 and not 80.0.
std::string number(double v) {
  std::array<char, 40> text{};
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), v).ptr};
}

std::string text_of(const Entries& v, bool yaml) {
  if (v.is_number_float()) return number(v.get<double>());
  if (v.is_string() && yaml) {
    const std::string& text = v.get_ref<const std::string&>();
    // Plain where no parser takes it for anything else.
    constexpr std::string_view kPlain = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_./-";
    if (!text.empty() && text.find_first_not_of(kPlain) == std::string::npos && text.front() != '-')
      return text;
  }
  if (!v.is_object()) return v.dump(-1, ' ', false, Entries::error_handler_t::replace);
  std::string out;
  for (const auto& [key, value] : v.items()) {
    out += out.empty() ? "{" : ", ";
    out += (yaml ? text_of(key, true) : Entries(key).dump()) + ": " + text_of(value, yaml);
  }
  return out + "}";
}

}  // namespace

std::string fault_key(std::string key, const std::string& unit, const char* after) {
  if (!unit.empty()) key += "_" + unit;
  return key + after;
}

std::string fault_json(const FaultSpec& fault) { return text_of(entries(fault), false); }
std::string fault_yaml(const FaultSpec& fault) { return text_of(entries(fault), true); }

Result<ConfigNode> fault_node(std::string_view json, const std::string& where) {
  const auto object = parse_json(json, where);
  if (!object) return fail(ErrorCode::bad_input, where, "fault: " + object.error().message);
  if (!object->is_object())
    return fail(ErrorCode::bad_input, where,
                "fault: expected an object of JSON with the keys of a fault, as rigs have them, got " +
                    std::string(object->type_name()));
  // JSON is YAML: the reader of rigs reads it.
  return ConfigDocument::parse(json, where);
}

}  // namespace rigor

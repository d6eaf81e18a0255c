#include "sensor-hal/channel/fault_spec.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sensor-hal/channel/fault_values.h"

namespace rigor {
namespace {

constexpr std::array<std::string_view, kFaultKinds> kNames{
    "drop",  "burst_loss", "delay",     "jitter",     "stuck",      "bias",       "drift",        "noise",
    "spike", "corrupt",    "timestamp", "clock_skew", "clock_step", "disconnect", "slow_consumer"};

bool fits(FaultKind kind, const FaultSubject& s) {
  switch (kind) {
    case FaultKind::corrupt:  // of what is sent as bytes, and comes without a checksum that would refuse it
      return !s.is_sink && (s.kind == SampleKind::image || s.kind == SampleKind::range_image ||
                            s.kind == SampleKind::point_cloud || s.kind == SampleKind::can_frame);
    case FaultKind::bias:
    case FaultKind::drift:
    case FaultKind::noise:
    case FaultKind::spike:
      return !fault_components(s.kind, *s.description).empty();
    case FaultKind::timestamp:
    case FaultKind::clock_skew:
    case FaultKind::clock_step:
    case FaultKind::slow_consumer:
      return !s.is_sink;
    case FaultKind::drop:
    case FaultKind::burst_loss:
    case FaultKind::delay:
    case FaultKind::jitter:
    case FaultKind::stuck:
    case FaultKind::disconnect:
      return true;
  }
  return false;
}

FaultKind read_kind(const ConfigNode& n, const FaultSubject& subject) {
  std::vector<std::string> all, fitting;
  for (std::size_t i = 0; i < kFaultKinds; ++i) {
    all.emplace_back(kNames[i]);
    if (fits(static_cast<FaultKind>(i), subject)) fitting.emplace_back(kNames[i]);
  }
  if (!n.has("kind"))
    throw n.error("kind", "expected one of " + joined_or_none(fitting) + ", got nothing: the key is missing");
  const std::string word = n.text("kind");
  const auto at = std::find(all.begin(), all.end(), word);
  if (at == all.end()) {
    const std::string near = nearest(word, all);
    throw n.error("kind", "expected one of " + joined_or_none(fitting) + ", got " + word +
                              (near.empty() ? "" : "; did you mean '" + near + "'?"));
  }
  const auto kind = static_cast<FaultKind>(at - all.begin());
  if (!fits(kind, subject))
    throw n.error("kind", "expected a fault that " + subject.channel +
                              (subject.is_sink ? ", which takes commands," : "") + " can have: one of " +
                              joined_or_none(fitting) + "; got " + word);
  return kind;
}

double per_cent_or_share(const ConfigNode& n, std::string_view key, double fallback) {
  return n.number_or(key, fallback, {.min = 0, .max = 1});
}

Duration read_s(const ConfigNode& n, std::string_view key, Range range) {
  return seconds_from(n.number(key, range));
}
Duration read_ms(const ConfigNode& n, std::string_view key, Range range) {
  return seconds_from(n.number(key, range) * 1e-3);
}

/// Which value, and returns its unit.
std::string read_component(const ConfigNode& n, const FaultSubject& subject, FaultReading& r) {
  if (subject.kind == SampleKind::can_frame && n.has("dbc")) {
    if (!subject.find_signal)
      throw n.error("dbc", "expected `value: byte_N`; signals of DBC files are not known here");
    r.spec.dbc = n.text("dbc");
    r.spec.value = n.text("value");
    r.signal = subject.find_signal(n, r.spec.value);
    return {};
  }
  const auto components = fault_components(subject.kind, *subject.description);
  std::vector<std::string> names;
  for (const FaultComponent& c : components) names.push_back(c.name);
  const bool has_first = has_elements(subject.kind) || names.size() == 1;
  const std::string name =
      has_first ? n.choice_or("value", names, names.front())
      : subject.kind == SampleKind::can_frame && !n.has("value")
          ? throw n.error({}, "expected `dbc: FILE` and `value: SIGNAL`, or `value: byte_N`")
          : n.choice("value", names);
  r.component = static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
  if (n.has("value")) r.spec.value = name;
  return r.spec.unit = components[static_cast<std::size_t>(r.component)].unit;
}

void read_schedule(const ConfigNode& n, FaultSpec& f) {
  const Range time{.min = 0, .max = 1e7}, span{.min = 0, .max = 1e7, .exclusive_min = true};
  if (n.has("from_s")) f.from = read_s(n, "from_s", time);
  if (n.has("until_s")) {
    f.until = read_s(n, "until_s", time);
    if (f.until <= f.from) throw n.error("until_s", "expected a time after from_s");
  }
  if (n.has("every_s")) f.every = read_s(n, "every_s", span);
  if (n.has("for_s")) f.on_for = read_s(n, "for_s", span);
  if (f.every.ns() > 0 && f.on_for.ns() == 0)
    throw n.error("every_s", "expected `for_s` beside it: how long in each period");
  if (f.every.ns() > 0 && f.on_for > f.every) throw n.error("for_s", "expected at most every_s, got more");
  const ConfigNode w = n.map_or_absent("when");
  if (w.present()) {
    f.trigger.channel = w.text("channel");
    if (w.has("is")) {
      f.trigger.when = w.choice("is", {"overdue", "disconnected"}) == "overdue"
                           ? FaultTrigger::When::overdue
                           : FaultTrigger::When::disconnected;
    } else {
      if (w.has("above") == w.has("below"))
        throw w.error({},
                      "expected one of `above: NUMBER`, `below: NUMBER`, `is: overdue`, `is: disconnected`");
      f.trigger.value = w.text("value");
      f.trigger.when = w.has("above") ? FaultTrigger::When::above : FaultTrigger::When::below;
      f.trigger.threshold = w.number(w.has("above") ? "above" : "below");
    }
    w.finish();
    if (f.every.ns() > 0) throw n.error("every_s", "expected either `every_s` or `when`, got both");
  } else if (f.every.ns() == 0 && f.on_for.ns() > 0) {
    if (n.has("until_s")) throw n.error("for_s", "expected either `until_s` or `for_s`, got both");
  }
}

void read_jitter(const ConfigNode& n, FaultSpec& f) {
  const std::string shape = n.choice_or("shape", {"uniform", "exponential", "normal"}, "uniform");
  const Range range{.min = 0, .max = 1e6};
  if (shape == "uniform") {
    f.jitter_a = seconds_from(n.number_or("min_ms", 0, range) * 1e-3);
    f.jitter_b = read_ms(n, "max_ms", range);
    if (f.jitter_b < f.jitter_a) throw n.error("max_ms", "expected at least min_ms");
  } else {
    f.shape = shape == "normal" ? JitterShape::normal : JitterShape::exponential;
    f.jitter_a = read_ms(n, "mean_ms", range);
    if (f.shape == JitterShape::normal) f.jitter_b = read_ms(n, "sigma_ms", range);
  }
}

void read_own_keys(const ConfigNode& n, const FaultSubject& subject, FaultReading& r) {
  FaultSpec& f = r.spec;
  const auto read_probability = [&](double fallback) {
    f.probability = per_cent_or_share(n, "probability", fallback);
  };
  const Range positive{.min = 0, .max = 1e6, .exclusive_min = true};
  switch (f.kind) {
    case FaultKind::drop:
      read_probability(1);
      break;
    case FaultKind::burst_loss: {
      f.share = n.number("share", {.min = 0, .max = 1});
      f.mean_burst = n.number("mean_burst", {.min = 1, .max = 1e9});
      // The way into a burst is share / ((1 − share) · mean_burst), which is a probability.
      const double most = f.mean_burst / (f.mean_burst + 1);
      if (f.share > most)
        throw n.error("share",
                      "expected at most mean_burst / (mean_burst + 1): bursts that short cannot "
                      "lose more, as one good sample lies between two of them");
      break;
    }
    case FaultKind::delay:
      f.delay = read_ms(n, "delay_ms", positive);
      read_probability(1);
      break;
    case FaultKind::jitter:
      read_jitter(n, f);
      read_probability(1);
      break;
    case FaultKind::stuck:
      f.freeze = !subject.is_sink && n.flag_or("freeze", false);
      break;
    case FaultKind::bias:
    case FaultKind::drift:
    case FaultKind::noise:
    case FaultKind::spike: {
      const std::string unit = read_component(n, subject, r);
      if (f.kind == FaultKind::drift)
        f.amount = n.number(fault_key("rate", unit, "_per_s"));
      else if (f.kind == FaultKind::noise)
        f.amount = n.number(fault_key("sigma", unit), {.min = 0});
      else
        f.amount = n.number(fault_key("amount", unit));
      if (f.kind == FaultKind::spike && has_elements(subject.kind))
        f.element_share = n.number_or("share", 0.001, {.min = 0, .max = 1});
      if (f.kind != FaultKind::drift) read_probability(f.kind == FaultKind::spike ? 0.01 : 1);
      break;
    }
    case FaultKind::corrupt:
      f.flips =
          static_cast<std::uint32_t>(n.integer_or("flips", n.has("keep") ? 0 : 8, {.min = 0, .max = 65536}));
      f.keep = per_cent_or_share(n, "keep", 1);
      f.flagged = n.flag_or("flagged", true);
      read_probability(1);
      break;
    case FaultKind::timestamp:
      f.delay = read_ms(n, "offset_ms", {.min = -1e7, .max = 1e7});
      read_probability(1);
      break;
    case FaultKind::clock_skew:
      f.ppm = n.number("ppm", {.min = -1e6, .max = 1e6});
      break;
    case FaultKind::clock_step:
      f.delay = read_ms(n, "step_ms", {.min = -1e7, .max = 1e7});
      break;
    case FaultKind::disconnect:
      break;
    case FaultKind::slow_consumer:
      f.hold = n.choice_or("mode", {"unread", "hold"}, "unread") == "hold";
      if (f.hold) f.leases = static_cast<std::uint32_t>(n.integer("leases", {.min = 1, .max = 256}));
      break;
  }
}

}  // namespace

std::string_view fault_kind_name(FaultKind kind) { return kNames[static_cast<std::size_t>(kind)]; }
std::optional<FaultKind> fault_kind_named(std::string_view name) {
  const auto at = std::find(kNames.begin(), kNames.end(), name);
  return at == kNames.end() ? std::nullopt : std::optional(static_cast<FaultKind>(at - kNames.begin()));
}

FaultReading read_fault(const ConfigNode& node, const FaultSubject& subject, bool live) {
  FaultReading r;
  r.node = node;
  r.spec.kind = read_kind(node, subject);
  read_own_keys(node, subject, r);
  if (live) {
    if (node.has("for_s"))
      r.spec.on_for = seconds_from(node.number("for_s", {.min = 0, .max = 1e7, .exclusive_min = true}));
  } else {
    read_schedule(node, r.spec);
  }
  node.finish();
  return r;
}

}  // namespace rigor

// From a rig to expectations whose ports and values are found.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <span>

#include "bench/expect/check.h"
#include "sensor-hal/channel/typed_values.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using expect::Bounds;
using expect::Quantity;
using expect::Subject;
using expect::Wrong;

struct Named {
  const char* key;
  Quantity quantity;
};
constexpr std::array kOfChannel{Named{"rate_hz", Quantity::rate_hz}, Named{"missing", Quantity::missing},
                                Named{"late", Quantity::late}, Named{"age_ms", Quantity::age_ms},
                                Named{"age_p99_ms", Quantity::age_p99_ms}};
constexpr std::array kOfValue{Named{"value", Quantity::value}, Named{"per_s", Quantity::per_s}};
constexpr std::array kOfSink{Named{"failed", Quantity::failed}, Named{"late", Quantity::late_commands},
                             Named{"dropped", Quantity::dropped}};
constexpr std::array kOfLoop{
    Named{"wake_p50_us", Quantity::wake_p50_us}, Named{"wake_p99_us", Quantity::wake_p99_us},
    Named{"wake_max_us", Quantity::wake_max_us}, Named{"cycle_p99_us", Quantity::cycle_p99_us},
    Named{"skipped", Quantity::skipped},         Named{"misses", Quantity::misses}};
constexpr std::array kOfApplication{
    Named{"late", Quantity::late_answers}, Named{"skipped", Quantity::skipped_turns},
    Named{"restarts", Quantity::restarts}, Named{"answer_p99_ms", Quantity::answer_p99_ms}};
constexpr std::array kOfEstimate{Named{"position_m", Quantity::position_m},
                                 Named{"yaw_deg", Quantity::yaw_deg}};

constexpr std::array kOfReaction{Named{"safe_after_ms", Quantity::safe_after_ms}};

std::span<const Named> quantities_of(Subject s) {
  switch (s) {
    case Subject::channel:
      return kOfChannel;
    case Subject::value:
      return kOfValue;
    case Subject::sink:
      return kOfSink;
    case Subject::loop:
      return kOfLoop;
    case Subject::application:
      return kOfApplication;
    case Subject::estimate:
      return kOfEstimate;
    case Subject::reaction:
      return kOfReaction;
  }
  return {};
}

/// `left.value` of a channel or a sink.
std::pair<std::string, std::string> split(const std::string& of) {
  const auto dot = of.find('.');
  return {of.substr(0, dot), dot == std::string::npos ? "" : of.substr(dot + 1)};
}

Bounds read_bounds(const ConfigNode& entry, const char* key) {
  const ConfigNode n = entry.map(key);
  Bounds b;
  if (n.has("min")) b.min = n.number("min");
  if (n.has("max")) b.max = n.number("max");
  n.finish();
  if (!b.min && !b.max) throw entry.error(key, "expected { min: … }, { max: … } or both, got neither");
  if (b.min && b.max && *b.min > *b.max)
    throw entry.error(key, fmt::format("expected min up to max, got {} and {}", *b.min, *b.max));
  return b;
}

std::vector<std::string> names_of(const auto& ports) {
  std::vector<std::string> names;
  for (const auto& [name, port] : ports) names.push_back(name);
  return names;
}

/// " from 0.1 to 0.5 s"; empty: the whole run.
std::string window_text(Duration from, Duration until) {
  if (from.ns() > 0 && until.ns() > 0)
    return fmt::format(" from {:g} to {:g} s", from.seconds(), until.seconds());
  if (from.ns() > 0) return fmt::format(" from {:g} s", from.seconds());
  return until.ns() > 0 ? fmt::format(" until {:g} s", until.seconds()) : "";
}

struct Found {
  Subject subject{};
  const ChannelEntry* channel = nullptr;
  const SinkEntry* sink = nullptr;
};

Found find_subject(const RigConfig& rig, const ConfigNode& n, const std::string& name,
                   const std::string& value) {
  if (value.empty() && name == "loop") return {Subject::loop};
  if (value.empty() && name == "application") {
    if (rig.application.empty()) throw n.error("of", "expected an application in the rig, found none");
    return {Subject::application};
  }
  Found found;
  for (const ChannelEntry& c : rig.channels)
    if (c.name == name) found.channel = &c;
  for (const SinkEntry& s : rig.sinks)
    if (s.name == name) found.sink = &s;
  if (!found.channel && !found.sink) {
    std::vector<std::string> names{"loop", "application"};
    for (const ChannelEntry& c : rig.channels) names.push_back(c.name);
    for (const SinkEntry& s : rig.sinks) names.push_back(s.name);
    throw n.error(
        "of",
        fmt::format("expected one of {}, or a value of a channel or sink as in NAME.VALUE, got \"{}\"{}",
                    fmt::join(names, ", "), name, did_you_mean(name, names)));
  }
  found.subject = !value.empty()                            ? Subject::value
                  : n.has("against")                        ? Subject::estimate
                  : n.has("when") || n.has("safe_after_ms") ? Subject::reaction
                  : found.channel                           ? Subject::channel
                                                            : Subject::sink;
  if (found.subject == Subject::estimate && !found.sink)
    throw n.error("of", "expected a sink that receives an estimate, got a channel");
  if (found.subject == Subject::reaction && !found.sink)
    throw n.error("of", "expected a sink, which has `safe:` values, got a channel");
  return found;
}

/// `when: { fault: left, kind: drop }` or `when: { channel: left, is: disconnected }`.
Wrong read_when(const RigConfig& rig, const ConfigNode& entry) {
  if (!entry.has("when"))
    throw entry.error(
        "safe_after_ms",
        "expected `when:` beside it, { fault: NAME } or { channel: NAME, is: disconnected }, found none");
  const ConfigNode n = entry.map("when");
  Wrong wrong;
  std::vector<std::string> names;
  for (const ChannelEntry& c : rig.channels) names.push_back(c.name);
  wrong.fault = n.has("fault");
  if (wrong.fault) {
    for (const ChannelEntry& c : rig.channels)
      if (c.is_pair) names.insert(names.end(), {c.name + ".real", c.name + ".simulated"});
    for (const SinkEntry& s : rig.sinks) names.push_back(s.name);
    if (n.has("kind")) {
      std::vector<std::string> kinds;
      for (std::size_t i = 0; i < kFaultKinds; ++i)
        kinds.emplace_back(fault_kind_name(static_cast<FaultKind>(i)));
      wrong.kind = fault_kind_named(n.choice("kind", kinds));
    }
  } else {
    wrong.disconnected_alone = n.choice("is", {"overdue", "disconnected"}) == "disconnected";
  }
  const char* key = wrong.fault ? "fault" : "channel";
  wrong.name = n.text(key);
  n.finish();
  if (std::ranges::find(names, wrong.name) == names.end())
    throw n.error(key, fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "), wrong.name,
                                   did_you_mean(wrong.name, names)));
  return wrong;
}

/// `safe:` of a sink.
std::vector<std::pair<std::string, double>> read_safe_values(const SinkEntry& sink, const ConfigNode& entry) {
  std::vector<std::pair<std::string, double>> values;
  if (sink.sink.params.has("safe")) {
    const ConfigNode safe = sink.sink.params.map("safe");
    for (const std::string& name : safe.keys()) values.emplace_back(name, safe.number(name));
  }
  if (values.empty())
    throw entry.error("of",
                      fmt::format("expected a sink with `safe:` values, got {}, which has none", sink.name));
  return values;
}

}  // namespace

Result<std::unique_ptr<Expectations>> Expectations::read(const RigConfig& rig) {
  return catch_config([&] {
    std::unique_ptr<Expectations> out(new Expectations);
    for (const ConfigNode& n : rig.expect) {
      const std::string of = n.text("of");
      const auto [name, value] = split(of);
      const Found found = find_subject(rig, n, name, value);
      Check base;
      base.node = n;
      base.expected.of = of;
      base.name = name;
      base.value_name = value;
      base.subject = found.subject;
      if (found.channel) base.period = found.channel->period, base.latency = found.channel->latency;
      const bool windowed = base.subject == Subject::channel || base.subject == Subject::value ||
                            base.subject == Subject::estimate || base.subject == Subject::reaction;
      if (windowed) {
        base.from = seconds_from(n.number_or("from_s", 0, {.min = 0, .max = 1e9}));
        base.until = seconds_from(n.number_or("until_s", 0, {.min = 0, .max = 1e9}));
        if (base.until.ns() > 0 && base.until <= base.from)
          throw n.error("until_s", "expected an instant after from_s");
      }
      if (base.subject == Subject::estimate) base.against = n.text("against");
      if (base.subject == Subject::reaction) {
        base.wrong = read_when(rig, n);
        base.safe_values = read_safe_values(*found.sink, n);
      }
      const std::size_t before = out->checks_.size();
      for (const Named& q : quantities_of(base.subject)) {
        if (!n.has(q.key)) continue;
        auto check = std::make_unique<Check>(base);
        check->quantity = q.quantity;
        check->bounds = read_bounds(n, q.key);
        check->expected.quantity = q.key;
        check->expected.bounds = check->bounds.text();
        if (base.subject == Subject::reaction) {
          if (!check->bounds.max || check->bounds.min || *check->bounds.max < 0)
            throw n.error(q.key, "expected { max: MILLISECONDS } alone");
          check->expected.bounds += " " + base.wrong.text();
        }
        check->expected.bounds += window_text(base.from, base.until);
        const bool needs_rate = q.quantity == Quantity::missing;
        if (needs_rate && base.period.ns() <= 0)
          throw n.error(q.key, "expected a channel with a rate, got one that has none: nothing of it is due");
        out->checks_.push_back(std::move(check));
      }
      if (base.subject == Subject::channel && n.has("alarm")) {
        if (!found.channel->is_pair) throw n.error("alarm", "expected a pair, got a channel that is none");
        auto check = std::make_unique<Check>(base);
        check->quantity = Quantity::alarm;
        check->wanted_alarm = n.flag("alarm");
        check->expected.quantity = "alarm";
        check->expected.bounds =
            (check->wanted_alarm ? "to come" : "not to come") + window_text(base.from, base.until);
        out->checks_.push_back(std::move(check));
      }
      n.finish();
      if (out->checks_.size() == before) {
        std::vector<std::string> names;
        for (const Named& q : quantities_of(base.subject)) names.emplace_back(q.key);
        if (base.subject == Subject::channel && found.channel->is_pair) names.emplace_back("alarm");
        throw n.error("of",
                      fmt::format("expected one or more of {} beside it, got none", fmt::join(names, ", ")));
      }
    }
    for (std::size_t i = 0; i < out->checks_.size(); ++i)
      out->board_->seen.push_back(std::make_unique<Published<expect::Seen>>());
    if (out->checks_.empty()) out.reset();
    return out;
  });
}

Status Expectations::bind(const ApplicationPorts& ports) {
  const auto bound = catch_config([&] {
    for (const auto& check : checks_) {
      Check& c = *check;
      const auto input = ports.inputs.find(c.subject == Subject::estimate ? c.against : c.name);
      const auto output = ports.outputs.find(c.name);
      const bool needs_port = c.subject == Subject::channel || c.subject == Subject::value ||
                              c.subject == Subject::sink || c.subject == Subject::estimate ||
                              c.subject == Subject::reaction;
      if (needs_port && !ports.inputs.contains(c.name) && output == ports.outputs.end())
        throw c.node.error("of", fmt::format("expected a channel that was recorded ({}), got \"{}\"",
                                             fmt::join(names_of(ports.inputs), ", "), c.name));
      const auto place = [&](const std::vector<std::string>& names, const std::string& value) {
        const auto it = std::ranges::find(names, value);
        if (it == names.end())
          throw c.node.error(
              "of", fmt::format("expected a value of {} ({}), got \"{}\"{}", c.name,
                                names.empty() ? "it has none" : fmt::format("{}", fmt::join(names, ", ")),
                                value, did_you_mean(value, names)));
        return static_cast<std::size_t>(it - names.begin());
      };
      if (c.subject == Subject::channel || c.subject == Subject::value || c.subject == Subject::estimate) {
        if (input != ports.inputs.end()) {
          c.port = input->second.port;
          c.kind = input->second.description->kind;
        }
      }
      if (c.subject == Subject::value && c.port) {
        std::vector<std::string> names = input->second.description->names;
        if (c.kind != SampleKind::register_block) {
          names.clear();
          for (const ValueName& v : values_of_kind(c.kind)) names.emplace_back(v.name);
        }
        c.index = place(names, c.value_name);
      } else if (c.subject == Subject::value) {
        c.commands = output->second;
        c.index = place(output->second->describe().names, c.value_name);
      } else if (c.subject == Subject::reaction) {
        c.commands = output->second;
        const auto& names = output->second->describe().names;
        std::vector<std::pair<std::size_t, double>> safe;
        for (const auto& [name, value] : c.safe_values)  // what is never commanded stays as it is
          if (const auto it = std::ranges::find(names, name); it != names.end())
            safe.emplace_back(it - names.begin(), value);
        if (safe.empty())
          throw c.node.error("of",
                             fmt::format("expected a sink that is commanded a value of its `safe:`, got "
                                         "{}, which is commanded {}",
                                         c.name, fmt::join(names, ", ")));
        c.safe_state.emplace(seconds_from(*c.bounds.max * 1e-3), std::move(safe));
        if (c.wrong.fault) continue;
        const auto watched = ports.inputs.find(c.wrong.name);
        if (watched == ports.inputs.end())
          throw c.node.error("when", fmt::format("expected a channel that was recorded ({}), got \"{}\"",
                                                 fmt::join(names_of(ports.inputs), ", "), c.wrong.name));
        c.port = watched->second.port;
      } else if (c.subject == Subject::estimate) {
        if (!c.port || c.kind != SampleKind::pose)
          throw c.node.error("against",
                             fmt::format("expected a channel of kind pose, got \"{}\"", c.against));
        c.commands = output->second;
        const auto& names = output->second->describe().names;
        c.x = place(names, "x"), c.y = place(names, "y");
        if (c.quantity == Quantity::yaw_deg) c.yaw = place(names, "yaw");
        if (const auto it = std::ranges::find(names, "state"); it != names.end())
          c.state = it - names.begin();
      }
    }
    return 0;
  });
  return bound ? Status{} : Status(tl::unexpected<Error>(bound.error()));
}

}  // namespace rigor

#include "bridges/ros2/incoming.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "bridges/ros2/names.h"
#include "bridges/ros2/settings.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor::ros2 {
namespace {

constexpr std::size_t kMostValues = std::tuple_size_v<decltype(BridgeCommand::value)>;

std::vector<std::string> names_of(const std::vector<BridgeRig::Sink>& sinks) {
  std::vector<std::string> names;
  for (const auto& s : sinks) names.push_back(s.name);
  return names;
}

/// Numbers by the names of the sink's values, at `key`. Throws for a name that the sink does not have.
template <class Read>
void each_value(const ConfigNode& n, std::string_view key, CommandSettings& settings, Read&& read) {
  const ConfigNode map = n.map_or_absent(key);
  if (!map.present()) return;
  for (const std::string& name : map.keys()) {
    const auto value = std::find_if(settings.values.begin(), settings.values.end(),
                                    [&](const auto& v) { return v.name == name; });
    if (value == settings.values.end()) {
      std::vector<std::string> names;
      for (const auto& v : settings.values) names.push_back(v.name);
      throw map.error(name, fmt::format("expected a value of {}, one of {}, got \"{}\"{}", settings.sink_name,
                                        joined_or_none(names), name, did_you_mean(name, names)));
    }
    read(map, name, *value);
  }
  map.finish();
}

/// What `values` means where it is left out: the type says it by itself, or there is no default.
std::string usual_path(const CommandSettings& s, std::size_t place) {
  if (s.type == "sensor_msgs/msg/JointState") return "position." + s.values[place].name;
  if (s.type.ends_with("MultiArray")) return "data." + std::to_string(place);
  if (s.type.starts_with("std_msgs/") && s.values.size() == 1) return "data";
  return {};
}

void read_values(const ConfigNode& n, CommandSettings& s, const Definition& definition) {
  if (!n.has("values")) {
    for (std::size_t i = 0; i < s.values.size(); ++i) s.values[i].path = usual_path(s, i);
    for (const auto& v : s.values)
      if (v.path.empty())
        throw n.error(
            "values",
            fmt::format("expected a number of {} for each value of {} ({}), got nothing: the key is "
                        "missing; its numbers are {}",
                        s.type, s.sink_name, v.name, joined_or_none(value_paths(definition))));
    (void)n.map_or_absent("values");
    return;
  }
  std::vector<bool> given(s.values.size());
  each_value(n, "values", s, [&](const ConfigNode& map, const std::string& name, CommandSettings::Value& v) {
    const std::string text = map.text(name);
    char* end = nullptr;
    const double constant = std::strtod(text.c_str(), &end);
    if (!text.empty() && end && *end == '\0' && std::isfinite(constant)) {
      v.constant = constant;
    } else {
      v.path = text;
      if (auto reader = ValueReader::make(definition, {text}); !reader)
        throw map.error(name, reader.error().message);
    }
    given[static_cast<std::size_t>(&v - s.values.data())] = true;
  });
  for (std::size_t i = 0; i < given.size(); ++i)
    if (!given[i])
      throw n.error("values", fmt::format("expected all values of {}, found none for {}; a number that stays "
                                          "the same is written as it is",
                                          s.sink_name, s.values[i].name));
}

}  // namespace

CommandSettings read_command(const ConfigNode& n, const std::string& topic, const BridgeRig& rig) {
  CommandSettings s;
  check_topic(n, "", topic);
  s.topic = topic;
  s.sink_name = n.text("sink");
  const auto sink =
      std::find_if(rig.sinks.begin(), rig.sinks.end(), [&](const auto& k) { return k.name == s.sink_name; });
  if (sink == rig.sinks.end()) {
    const auto names = names_of(rig.sinks);
    throw n.error("sink", fmt::format("expected a sink of the rig, one of {}, got \"{}\"{}",
                                      joined_or_none(names), s.sink_name, did_you_mean(s.sink_name, names)));
  }
  s.sink = static_cast<std::uint32_t>(sink - rig.sinks.begin());
  if (sink->value_names.empty() || sink->value_names.size() > kMostValues)
    throw n.error("sink", fmt::format("expected a sink of 1 to {} values, got {} with {}", kMostValues,
                                      s.sink_name, sink->value_names.size()));
  for (const std::string& name : sink->value_names) s.values.push_back({.name = name, .path = {}});
  const std::string type = n.text("type");
  s.type = full_type(type);
  s.definition = definition_text(s.type);
  const auto definition = read_definition(s.type, s.definition);
  if (s.definition.empty() || !definition) {
    const auto known = command_types();
    throw n.error("type", fmt::format("expected a type of messages with numbers, such as {}, got \"{}\"{}",
                                      joined_or_none(known), type, did_you_mean(type, known)));
  }
  s.qos = read_qos(n, {Qos::Profile::reliable, 0});
  read_values(n, s, *definition);
  each_value(n, "scale", s, [](const ConfigNode& map, const std::string& name, CommandSettings::Value& v) {
    v.scale = map.number(name);
  });
  each_value(n, "limits", s, [](const ConfigNode& map, const std::string& name, CommandSettings::Value& v) {
    const auto limits = map.numbers(name, 2);
    if (limits[0] > limits[1])
      throw map.error(name,
                      fmt::format("expected the lower limit first, got {:g} and {:g}", limits[0], limits[1]));
    v.min = limits[0], v.max = limits[1];
  });
  s.clamp = n.choice_or("beyond", {"reject", "clamp"}, "reject") == "clamp";
  s.timeout = seconds_from(n.number_or("timeout_ms", 0, {.min = 0, .max = 1e7}) * 1e-3);
  if (n.has("on_timeout") && s.timeout.ns() == 0)
    throw n.error("on_timeout", "expected `timeout_ms` with it, found none");
  each_value(n, "on_timeout", s,
             [](const ConfigNode& map, const std::string& name, CommandSettings::Value& v) {
               v.on_timeout = map.number(name, {.min = v.min, .max = v.max});
             });
  for (const auto& v : s.values)
    if (s.timeout.ns() > 0 && (v.on_timeout < v.min || v.on_timeout > v.max))
      throw n.error("on_timeout",
                    fmt::format("expected a value for {} within its limits from {:g} to {:g}, got "
                                "none, and 0 is beyond them",
                                v.name, v.min, v.max));
  n.finish();
  return s;
}

// ------------------------------------------------------------------ conversion

Result<CommandConverter> CommandConverter::make(const CommandSettings& settings) {
  auto definition = read_definition(settings.type, settings.definition);
  if (!definition) return tl::unexpected<Error>(definition.error());
  std::vector<std::string> paths;
  for (const auto& v : settings.values)
    if (!v.path.empty()) paths.push_back(v.path);
  auto reader = ValueReader::make(std::move(*definition), std::move(paths));
  if (!reader) return tl::unexpected<Error>(reader.error());
  return CommandConverter(settings, std::move(*reader));
}

Result<CommandConverter::Converted> CommandConverter::convert(record::Bytes message) {
  if (auto s = reader_.read(message, numbers_); !s) return tl::unexpected<Error>(s.error());
  Converted out;
  out.command.sink = settings_.sink;
  out.command.count = static_cast<std::uint32_t>(settings_.values.size());
  std::size_t number = 0;
  for (std::size_t i = 0; i < settings_.values.size(); ++i) {
    const CommandSettings::Value& v = settings_.values[i];
    double value = v.path.empty() ? v.constant : numbers_[number++] * v.scale;
    if (!std::isfinite(value))
      return fail(ErrorCode::bad_input, settings_.topic,
                  fmt::format("expected a finite number for {}, got {}", v.name, value));
    if (value < v.min || value > v.max) {
      if (!settings_.clamp)
        return fail(ErrorCode::bad_input, settings_.topic,
                    fmt::format("expected {} from {:g} to {:g}, got {:g}", v.name, v.min, v.max, value));
      value = std::clamp(value, v.min, v.max);
      out.clamped = true;
    }
    out.command.value[i] = value;
  }
  return out;
}

// ------------------------------------------------------------------ topics

Incoming::~Incoming() { close(); }

Status Incoming::open(const std::shared_ptr<Participant>& participant) {
  if (settings_.empty()) return {};
  waiter_ = std::make_unique<Waiter>();
  for (const CommandSettings& s : settings_) {
    auto converter = CommandConverter::make(s);
    if (!converter) return tl::unexpected<Error>(converter.error());
    auto topic = std::make_unique<Topic>(std::move(*converter));
    auto reader = participant->read(s.topic, {s.type, s.definition}, s.qos);
    if (!reader) return tl::unexpected<Error>(reader.error());
    topic->reader = std::move(*reader);
    waiter_->add(*topic->reader);
    topics_.push_back(std::move(topic));
  }
  stopping_ = false;
  thread_ = std::thread([this] { work(); });
  return {};
}

void Incoming::close() {
  if (!thread_.joinable()) return;
  stopping_ = true;
  waiter_->stop();
  thread_.join();
  std::vector<std::string> last = problems();
  const std::lock_guard lock(mutex_);
  closed_problems_ = std::move(last);
  for (const auto& topic : topics_) {
    CommandConverter::Converted left;
    while (topic->ring.try_pop(left)) topic->dropped.fetch_add(1, std::memory_order_relaxed);
    topic->closed_peers = topic->reader->peers();
    topic->reader.reset();
  }
  waiter_.reset();
}

void Incoming::work() {
  while (!stopping_) {
    waiter_->wait(seconds(1));
    for (const auto& topic : topics_) take(*topic);
  }
}

void Incoming::take(Topic& topic) {
  std::vector<std::byte> joined;
  while (ddsi_serdata* message = topic.reader->take()) {
    topic.received.fetch_add(1, std::memory_order_relaxed);
    auto converted = topic.converter.convert(bytes_of(message, joined));
    Reader::release(message);
    if (!converted) {
      topic.rejected.fetch_add(1, std::memory_order_relaxed);
      const std::lock_guard lock(mutex_);
      topic.last_rejection = converted.error().message;
    } else if (!topic.ring.try_push(*converted)) {
      topic.dropped.fetch_add(1, std::memory_order_relaxed);
    }
  }
}

bool Incoming::poll(BenchTime now, BridgeCommand& command) noexcept {
  for (; next_ < topics_.size(); ++next_) {
    Topic& topic = *topics_[next_];
    CommandConverter::Converted newest;
    std::uint64_t popped = 0;
    while (topic.ring.try_pop(newest)) ++popped;
    if (popped > 0) {
      topic.superseded.fetch_add(popped - 1, std::memory_order_relaxed);
      topic.accepted.fetch_add(1, std::memory_order_relaxed);
      if (newest.clamped) topic.clamped.fetch_add(1, std::memory_order_relaxed);
      topic.last = now;
      topic.seen = true;
      topic.timed_out = false;
      command = newest.command;
      ++next_;
      return true;
    }
    const CommandSettings& s = settings_[next_];
    if (s.timeout.ns() == 0 || !topic.seen || topic.timed_out || now - topic.last < s.timeout) continue;
    topic.timed_out = true;
    topic.timeouts.fetch_add(1, std::memory_order_relaxed);
    command.sink = s.sink;
    command.count = static_cast<std::uint32_t>(s.values.size());
    for (std::size_t i = 0; i < s.values.size(); ++i) command.value[i] = s.values[i].on_timeout;
    ++next_;
    return true;
  }
  next_ = 0;
  return false;
}

std::vector<BridgeReport::Commands> Incoming::report() const {
  std::vector<BridgeReport::Commands> all;
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < topics_.size(); ++i) {
    const Topic& t = *topics_[i];
    const CommandSettings& s = settings_[i];
    BridgeReport::Commands r;
    r.topic = s.topic;
    r.type = s.type;
    r.sink = s.sink_name;
    r.received = t.received.load(std::memory_order_relaxed);
    r.accepted = t.accepted.load(std::memory_order_relaxed);
    r.rejected = t.rejected.load(std::memory_order_relaxed);
    r.superseded = t.superseded.load(std::memory_order_relaxed);
    r.dropped = t.dropped.load(std::memory_order_relaxed);
    r.clamped = t.clamped.load(std::memory_order_relaxed);
    r.timeouts = t.timeouts.load(std::memory_order_relaxed);
    r.peers = t.reader ? t.reader->peers() : t.closed_peers;
    r.last_rejection = t.last_rejection;
    all.push_back(std::move(r));
  }
  return all;
}

std::vector<std::string> Incoming::problems() const {
  const std::lock_guard lock(mutex_);
  if (!waiter_) return closed_problems_;
  std::vector<std::string> all;
  for (std::size_t i = 0; i < topics_.size(); ++i) {
    if (!topics_[i]->reader) continue;
    const Mismatch m = topics_[i]->reader->mismatch();
    if (m.count == 0) continue;
    all.push_back(fmt::format(
        "{}: {} publishers offer another {} than it asks for ({}){}", settings_[i].topic, m.count,
        m.policy.empty() ? "quality of service" : m.policy, name_of(settings_[i].qos),
        m.policy == "RELIABILITY"
            ? fmt::format("; set `commands: {{ {}: {{ qos: sensor_data }} }}`", settings_[i].topic)
        : m.policy == "DURABILITY"
            ? fmt::format("; set `commands: {{ {}: {{ qos: reliable }} }}`", settings_[i].topic)
            : std::string()));
  }
  return all;
}

std::optional<std::uint32_t> Incoming::peers(const std::string& topic) const {
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < topics_.size(); ++i)
    if (settings_[i].topic == topic && topics_[i]->reader) return topics_[i]->reader->peers();
  return std::nullopt;
}

}  // namespace rigor::ros2

#include "drivers/can/can_settings.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "drivers/can/signal_codec.h"
#include "rt-core/numbers.h"

namespace rigor::can {
namespace {

Duration read_ms(const ConfigNode& n, std::string_view key, double fallback_ms, Range range) {
  return seconds_from(n.number_or(key, fallback_ms, range) * 1e-3);
}

std::shared_ptr<const Dbc> read_dbc(const ConfigNode& n) {
  const auto file = n.base_dir() / n.text("dbc");
  auto dbc = load_dbc(file);
  if (!dbc) {
    if (dbc.error().code == ErrorCode::not_found)
      throw n.error("dbc", dbc.error().message + ": " + file.string());
    throw ConfigError(dbc.error());
  }
  return std::make_shared<const Dbc>(std::move(*dbc));
}

const Message& read_message(const Dbc& dbc, const ConfigNode& n, std::string_view key,
                            const std::string& name) {
  if (const Message* m = dbc.message(name)) {
    if (m->fits_a_frame()) return *m;
    throw n.error(key, "expected a message of at most 64 bytes, got one of " + std::to_string(m->length) +
                           ", which a transport protocol carries");
  }
  std::vector<std::string> names;
  for (const auto& m : dbc.messages) names.push_back(m.name);
  const auto near = nearest(name, names);
  throw n.error(key, "expected a message of " + dbc.name + ", got \"" + name + "\"" +
                         (near.empty() ? "" : "; did you mean " + near + "?"));
}

std::size_t read_signal(const Message& m, const ConfigNode& n, std::string_view key,
                        const std::string& name) {
  const int index = m.index_of(name);
  if (index >= 0) return static_cast<std::size_t>(index);
  std::vector<std::string> names;
  for (const auto& s : m.signals) names.push_back(s.name);
  const auto near = nearest(name, names);
  throw n.error(key, "expected a signal of " + m.name + ", got \"" + name + "\"" +
                         (near.empty() ? "" : "; did you mean " + near + "?"));
}

std::vector<NamedSignal> read_signals(const Dbc& dbc, const ConfigNode& n, std::size_t most) {
  std::vector<NamedSignal> out;
  std::set<std::string> names;
  for (const ConfigNode& item : n.list("signals")) {
    NamedSignal s;
    s.message = &read_message(dbc, item, "message", item.text("message"));
    const auto signal = item.text("signal");
    s.signal = read_signal(*s.message, item, "signal", signal);
    s.name = item.text_or("name", signal);
    if (!names.insert(s.name).second)
      throw item.error(item.has("name") ? "name" : "signal", "expected a name of its own, got \"" + s.name +
                                                                 "\" a second time; give it another `name`");
    out.push_back(std::move(s));
    item.finish();
    if (out.size() > most)
      throw n.error("signals", "expected at most " + std::to_string(most) + " signals, got more");
  }
  if (out.empty()) throw n.error("signals", "expected at least one signal, got none");
  return out;
}

std::vector<Filter> read_filters(const ConfigNode& n) {
  std::vector<Filter> out;
  for (const ConfigNode& item : n.list_or_empty("filters")) {
    Filter f;
    f.extended = item.flag_or("extended", false);
    const double most = f.extended ? kExtendedMask : kStandardMask;
    f.id = static_cast<std::uint32_t>(item.integer("id", {.min = 0, .max = most}));
    f.mask = static_cast<std::uint32_t>(
        item.integer_or("mask", static_cast<std::int64_t>(most), {.min = 0, .max = most}));
    item.finish();
    out.push_back(f);
  }
  if (out.size() > 512) throw n.error("filters", "expected at most 512 filters, which is the kernel's limit");
  return out;
}

void describe_signals(const std::vector<NamedSignal>& signals, const std::string& name,
                      ChannelDescription& d) {
  d.kind = SampleKind::register_block;
  d.frame_id = name;
  for (const auto& s : signals) {
    d.names.push_back(s.name);
    d.units.push_back(s.of().unit);
  }
}

}  // namespace

std::string read_interface(const ConfigNode& n) {
  auto name = n.text("interface");
  if (name.empty() || name.size() > 15 || name.find_first_of(" /") != std::string::npos)
    throw n.error("interface",
                  "expected the name of a network interface of up to 15 characters, such as can0, got \"" +
                      name + "\"");
  return name;
}

SourceSettings SourceSettings::parse(const ChannelConfig& config, ChannelDescription& description) {
  const auto& n = config.params;
  SourceSettings s;
  s.interface = read_interface(n);
  s.restart = read_ms(n, "restart_ms", 0, {.min = 0, .max = 60000});
  s.receive_buffer_bytes =
      static_cast<int>(n.integer_or("receive_buffer_kib", 0, {.min = 0, .max = 65536})) * 1024;
  const double rate = config.period.ns() > 0 ? 1 / config.period.seconds() : 2000;
  const double waiting = std::clamp(2 * rate * config.latency.seconds(), 0.0, 8192.0);
  s.slots = static_cast<std::size_t>(
      n.integer_or("slots", 512 + static_cast<std::int64_t>(waiting), {.min = 4, .max = 65536}));
  if (n.has("log")) s.log = n.text("log");
  if (n.has("time")) {
    const std::string time = n.choice_or("time", {"hardware", "kernel", "arrival"}, "kernel");
    s.time = time == "hardware"  ? StampKind::hardware
             : time == "arrival" ? StampKind::arrival
                                 : StampKind::kernel;
  }
  if (config.kind != SampleKind::register_block && config.kind != SampleKind::can_frame)
    throw n.error("kind", "expected can_frame (raw frames) or registers (signals of a DBC file)");
  if (config.kind == SampleKind::can_frame) {
    s.filters = read_filters(n);
    s.fd = n.flag_or("fd", false);
    s.errors = n.flag_or("errors", true);
    description.kind = SampleKind::can_frame;
    description.frame_id = config.name;
    return s;
  }
  s.errors = false;
  s.dbc = read_dbc(n);
  s.signals = read_signals(*s.dbc, n, RegisterBlock::kMax);
  s.sampled = config.period.ns() > 0;
  const double timeout_ms = n.number_or("timeout_ms", -1, {.min = 0, .max = 1e7});
  std::set<const Message*> messages;
  for (const auto& named : s.signals) {
    const Signal& signal = named.of();
    // A message that stays away for three cycles is gone; how long the others may be silent nobody knows.
    Duration timeout = signal.multiplexed_by >= 0 ? Duration{} : named.message->cycle * 3;
    if (timeout_ms >= 0) timeout = seconds_from(timeout_ms * 1e-3);
    s.timeouts.push_back(timeout);
    s.fd |= named.message->fd;
    if (messages.insert(named.message).second)
      s.filters.push_back({named.message->id, named.message->extended ? kExtendedMask : kStandardMask,
                           named.message->extended});
  }
  describe_signals(s.signals, config.name, description);
  return s;
}

SignalTable::SignalTable(const SourceSettings& settings) {
  for (std::size_t i = 0; i < settings.signals.size(); ++i) {
    const auto& s = settings.signals[i];
    auto it =
        std::find_if(groups_.begin(), groups_.end(), [&](const Group& g) { return g.message == s.message; });
    if (it == groups_.end()) it = groups_.insert(groups_.end(), Group{s.message, {}});
    it->signals.emplace_back(s.signal, i);
  }
  timeouts_ = settings.timeouts;
  values_.resize(settings.signals.size());
  seen_.resize(settings.signals.size());
  clear();
}

void SignalTable::clear() noexcept {
  std::fill(values_.begin(), values_.end(), kNaN);
  std::fill(seen_.begin(), seen_.end(), BenchTime{});
}

bool SignalTable::take(const CanFrame& f, BenchTime t) noexcept {
  if (f.error || f.remote) return false;
  for (const auto& g : groups_) {
    if (g.message->id != f.id || g.message->extended != f.extended) continue;
    const std::span<const std::uint8_t> data(f.data.data(), std::min<std::size_t>(f.length, f.data.size()));
    for (const auto& [signal, place] : g.signals)
      if (is_shown(*g.message, signal, data)) {
        values_[place] = decode(*g.message, signal, data);
        seen_[place] = t;
      }
    return true;
  }
  return false;
}

void SignalTable::fill(Sample& sample, BenchTime now) const noexcept {
  auto& block = sample.info.emplace<RegisterBlock>();
  block.count = static_cast<std::uint32_t>(values_.size());
  sample.stamp.validity = kValid;
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const bool old = timeouts_[i].ns() > 0 && now - seen_[i] > timeouts_[i];
    block.value[i] = old ? kNaN : values_[i];
    if (std::isnan(block.value[i])) sample.stamp.validity |= kIncomplete;
  }
  sample.size_bytes = 0;
}

namespace {

/// Multiplexors that a commanded signal needs and nobody sets are set by it.
void set_multiplexors(const Message& m, std::size_t signal, std::vector<double>& values,
                      const ConfigNode& n) {
  const Signal* s = &m.signals[signal];
  for (; s->multiplexed_by >= 0; s = &m.signals[static_cast<std::size_t>(s->multiplexed_by)]) {
    const auto by = static_cast<std::size_t>(s->multiplexed_by);
    const Signal& multiplexor = m.signals[by];
    if (s->shown.empty())
      throw n.error("signals",
                    s->name + " is multiplexed, but no value of " + multiplexor.name + " shows it");
    if (std::isnan(values[by])) {
      values[by] = value_of(multiplexor, s->shown.front().first);
      continue;
    }
    std::uint64_t raw = 0;
    if (raw_of(multiplexor, values[by], raw) != EncodeStatus::good || !s->shown_by(raw))
      throw n.error("signals", "expected signals that can be in one frame of " + m.name + ", but " + s->name +
                                   " needs another value of " + multiplexor.name + "; use a second sink");
  }
}

}  // namespace

SinkSettings SinkSettings::parse(const ChannelConfig& config, ChannelDescription& description) {
  const auto& n = config.params;
  SinkSettings s;
  s.interface = read_interface(n);
  s.dbc = read_dbc(n);
  s.signals = read_signals(*s.dbc, n, Command{}.value.size());
  s.announce = n.flag_or("announce", true);
  std::vector<std::vector<double>> constants;
  const auto message_at = [&](const Message& m) {
    for (std::size_t i = 0; i < s.messages.size(); ++i)
      if (s.messages[i].message == &m) return i;
    s.messages.push_back({&m, m.cycle, blank_frame(m)});
    constants.emplace_back(m.signals.size(), kNaN);
    return s.messages.size() - 1;
  };
  for (const auto& signal : s.signals) (void)message_at(*signal.message);
  for (const ConfigNode& item : n.list_or_empty("constants")) {
    const Message& m = read_message(*s.dbc, item, "message", item.text("message"));
    const auto signal = read_signal(m, item, "signal", item.text("signal"));
    const double value = item.number("value");
    item.finish();
    std::uint64_t raw = 0;
    if (raw_of(m.signals[signal], value, raw) != EncodeStatus::good)
      throw item.error(
          "value", "expected a value that " + m.signals[signal].name + " can hold, got one that it cannot");
    constants[message_at(m)][signal] = value;
  }
  for (const auto& signal : s.signals)
    set_multiplexors(*signal.message, signal.signal, constants[message_at(*signal.message)], n);
  if (const ConfigNode periods = n.map_or_absent("period_ms"); periods.present())
    for (const auto& name : periods.keys()) {
      const Message& m = read_message(*s.dbc, periods, name, name);
      const auto period = read_ms(periods, name, 0, {.min = 0, .max = 3.6e6});
      if (period.ns() != 0 && period < microseconds(100))
        throw periods.error(name, "expected 0 (with each command alone) or at least 0.1 ms");
      s.messages[message_at(m)].period = period;
    }
  for (std::size_t i = 0; i < s.messages.size(); ++i) {
    std::size_t bad = 0;
    if (encode(*s.messages[i].message, constants[i], s.messages[i].start, bad) != EncodeStatus::good)
      throw n.error("constants", "expected a value that " + s.messages[i].message->signals[bad].name +
                                     " can hold, got one that it cannot");
  }
  s.safe.resize(s.signals.size());
  const auto safe = n.map("safe");
  bool any = false;
  for (std::size_t i = 0; i < s.signals.size(); ++i) {
    const auto& signal = s.signals[i];
    if (!safe.has(signal.name)) continue;
    const double value = safe.number(signal.name);
    std::uint64_t raw = 0;
    if (raw_of(signal.of(), value, raw) != EncodeStatus::good)
      throw safe.error(signal.name, "expected a value that the signal can hold, got one that it cannot");
    s.safe[i] = value;
    any = true;
  }
  safe.finish();
  if (!any)
    throw n.error(
        "safe", "expected a value for at least one of the signals, got none; the device needs a safe state");
  describe_signals(s.signals, config.name, description);
  return s;
}

CommandFrames::CommandFrames(const SinkSettings& settings) : settings_(&settings) {
  for (const auto& m : settings.messages) {
    frames_.push_back(m.start);
    by_message_.emplace_back(m.message->signals.size(), kNaN);
  }
  next_ = frames_;
  for (const auto& s : settings.signals)
    for (std::size_t i = 0; i < settings.messages.size(); ++i)
      if (settings.messages[i].message == s.message) places_.push_back({i, s.signal});
  values_.resize(places_.size());
}

bool CommandFrames::put(const std::vector<double>& values) noexcept {
  for (auto& m : by_message_) std::fill(m.begin(), m.end(), kNaN);
  for (std::size_t i = 0; i < places_.size(); ++i)
    by_message_[places_[i].frame][places_[i].signal] = values[i];
  next_ = frames_;  // of the same size: nothing is allocated
  for (std::size_t i = 0; i < next_.size(); ++i) {
    std::size_t bad = 0;
    if (encode(*settings_->messages[i].message, by_message_[i], next_[i], bad) != EncodeStatus::good)
      return false;
  }
  std::swap(frames_, next_);
  return true;
}

bool CommandFrames::apply(const Command& c) noexcept {
  if (c.count != places_.size()) return false;
  for (std::size_t i = 0; i < places_.size(); ++i) {
    if (!std::isfinite(c.value[i])) return false;  // NaN would mean "as it was" to the encoder
    values_[i] = c.value[i];
  }
  return put(values_);
}

void CommandFrames::make_safe() noexcept {
  for (std::size_t i = 0; i < places_.size(); ++i) values_[i] = settings_->safe[i].value_or(kNaN);
  (void)put(values_);  // each was tried when it was read
}

NodeSettings NodeSettings::parse(const ConfigNode& n) {
  NodeSettings s;
  s.interface = read_interface(n);
  s.rates.nominal =
      static_cast<std::uint32_t>(n.integer_or("bitrate", s.rates.nominal, {.min = 5000, .max = 1e6}));
  s.rates.data =
      static_cast<std::uint32_t>(n.integer_or("data_bitrate", s.rates.data, {.min = 5000, .max = 15e6}));
  s.create = n.flag_or("create", false);
  if (n.has("log")) s.log = n.text("log");
  if (n.has("replay")) {
    s.replay = n.base_dir() / n.text("replay");
    s.repeat = n.flag_or("repeat", false);
  }
  if (!n.has("dbc")) {
    if (s.replay.empty())
      throw n.error(
          {}, "expected `dbc` with `node` or `messages`, or `replay` with a candump log, got none of them");
    return s;
  }
  s.dbc = read_dbc(n);
  s.change_check = read_ms(n, "change_check_ms", 10, {.min = 0.1, .max = 60000});
  const auto add = [&](const Message& m, Duration period) {
    for (auto& known : s.messages)
      if (known.message == &m) {
        known.period = period;
        return;
      }
    s.messages.push_back({&m, period});
  };
  if (n.has("node")) {
    const auto node = n.text("node");
    if (std::find(s.dbc->nodes.begin(), s.dbc->nodes.end(), node) == s.dbc->nodes.end()) {
      const auto near = nearest(node, s.dbc->nodes);
      throw n.error("node", "expected a node of " + s.dbc->name + ", got \"" + node + "\"" +
                                (near.empty() ? "" : "; did you mean " + near + "?"));
    }
    for (const auto& m : s.dbc->messages)
      if (m.fits_a_frame() && std::find(m.senders.begin(), m.senders.end(), node) != m.senders.end())
        add(m, m.cycle);
  }
  for (const ConfigNode& item : n.list_or_empty("messages")) {
    if (!item.is_map()) {
      const Message& m = read_message(*s.dbc, item, {}, item.as_text());
      add(m, m.cycle);
      continue;
    }
    const Message& m = read_message(*s.dbc, item, "name", item.text("name"));
    add(m, item.has("period_ms") ? read_ms(item, "period_ms", 0, {.min = 0, .max = 3.6e6}) : m.cycle);
    item.finish();
  }
  if (!n.has("node") && s.messages.empty() && s.replay.empty())
    throw n.error({}, "expected `node` (one of the DBC's) or `messages` that the device sends, got neither");
  if (const ConfigNode bind = n.map_or_absent("bind"); bind.present())
    for (const auto& signal : bind.keys()) {
      bool found = false;
      for (const auto& m : s.dbc->messages) found |= m.index_of(signal) >= 0;
      if (!found)
        throw bind.error(signal, "expected a signal of " + s.dbc->name + ", got \"" + signal + "\"");
      s.bind.emplace_back(signal, bind.text(signal));
    }
  return s;
}

}  // namespace rigor::can

#include "sensor-hal/channel/simulated_sink.h"

namespace rigor {
namespace {

/// How often the thread looks: also how far behind the model may be, of which others ask where it is.
constexpr Duration kTick = milliseconds(2);

}  // namespace

SimulatedSink::~SimulatedSink() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status SimulatedSink::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  if (find_) {
    auto found = find_(config);
    if (!found) return tl::unexpected<Error>(found.error());
    model_ = std::move(*found);
  }
  if (!model_) return fail(ErrorCode::internal, config.name, "a simulated sink was made without a device");
  signals_.clear();
  safe_.clear();
  description_ = {};
  std::vector<std::string> known;
  for (const auto& s : model_->signals())
    if (s.commanded) known.push_back(s.name);
  const auto find = [&](const std::string& name) {
    for (std::size_t i = 0; i < model_->signals().size(); ++i)
      if (model_->signals()[i].commanded && model_->signals()[i].name == name) return i;
    return model_->signals().size();
  };
  for (const ConfigNode& item : n.list("signals")) {
    const std::string name = item.as_text();
    const std::size_t i = find(name);
    if (i == model_->signals().size())
      throw item.error("", "expected a signal that the device can be told (" + joined_or_none(known) +
                               "), got \"" + name + "\"");
    signals_.push_back(i);
    description_.names.push_back(name);
    description_.units.push_back(model_->signals()[i].unit);
  }
  if (signals_.empty() || signals_.size() > Command{}.value.size())
    throw n.error("signals", "expected 1 to 16 signals");
  const ConfigNode safe = n.map_or_absent("safe");
  if (safe.present())
    for (const std::string& name : safe.keys()) {
      const std::size_t i = find(name);
      if (i == model_->signals().size())
        throw safe.error(name, "expected a signal that the device can be told (" + joined_or_none(known) +
                                   "), got \"" + name + "\"");
      safe_.emplace_back(i, safe.number(name));
    }
  safe.finish();
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  return {};
}

Status SimulatedSink::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  if (auto s = open_ring(context.loop_period, kTick); !s) return s;
  if (!virtual_time_) start_thread();
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status SimulatedSink::do_start(BenchTime t0) {
  make_safe(t0);  // the thread touches the model when the origin is known, which is later
  return {};
}

Status SimulatedSink::do_stop() {
  stop_thread();
  if (!virtual_time_ && state() == ChannelState::running) make_safe(bench_now());
  health_.connected.store(false, std::memory_order_release);
  return {};
}

/// Virtual time: called on the loop's thread, between its cycles.
void SimulatedSink::complete_until(BenchTime now) {
  if (state() == ChannelState::running) (void)apply_until(now);
}

void SimulatedSink::keep_safe() {
  if (!is_safe_) make_safe(bench_now());
  after();
}

/// The model goes on while nobody commands. What takes effect by then has been applied, but for what the loop
/// gives with less latency than a tick.
void SimulatedSink::after() {
  if (origin().get()) (void)model_->read(signals_.front(), bench_now() - kTick * 2);
}

void SimulatedSink::apply(const Command& c) {
  if (!virtual_time_ && is_late(bench_now() - c.t_effect))
    counters_.late.fetch_add(1, std::memory_order_relaxed);
  is_safe_ = false;
  bool taken = c.count == signals_.size();
  for (std::size_t i = 0; taken && i < signals_.size(); ++i)
    taken = model_->write(signals_[i], c.value[i], c.t_effect);
  (taken ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
}

void SimulatedSink::make_safe(BenchTime t) {
  for (const auto& [signal, value] : safe_)
    if (!model_->write(signal, value, t)) counters_.failed.fetch_add(1, std::memory_order_relaxed);
  is_safe_ = true;
}

}  // namespace rigor

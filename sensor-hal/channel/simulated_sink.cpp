#include "sensor-hal/channel/simulated_sink.h"

#include <algorithm>

#include "rt-core/time_slice.h"

namespace rigor {
namespace {

constexpr std::size_t kRingPlaces = 256;
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
  loop_period_ = context.loop_period;
  ring_ = std::make_unique<SpscRing<Command>>(kRingPlaces);
  want_safe_ = false;
  if (!virtual_time_) {
    if (auto s = deadline_.open(); !s) return s;
    thread_ = std::thread([this] { run(); });
  }
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status SimulatedSink::do_start(BenchTime t0) {
  make_safe(t0);  // the model's lock is free: the thread waits for the origin
  return {};
}

Status SimulatedSink::do_stop() {
  if (thread_.joinable()) {
    deadline_.cut();
    thread_.join();
    if (state() == ChannelState::running) make_safe(bench_now());
  }
  Command c;
  while (ring_ && ring_->try_pop(c)) counters_.dropped.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void SimulatedSink::watch(const Heartbeat* heartbeat, Duration deadline) {
  heartbeat_ = heartbeat;
  heartbeat_deadline_ = deadline;
}

bool SimulatedSink::command(const Command& c) noexcept {
  if (!ring_ || !ring_->try_push(c)) {
    counters_.dropped.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  counters_.accepted.fetch_add(1, std::memory_order_relaxed);
  return true;
}

/// Virtual time: called on the loop's thread, between its cycles.
void SimulatedSink::complete_until(BenchTime now) {
  if (state() == ChannelState::running) apply_until(now);
}

void SimulatedSink::run() {
  ask_for_time_slice(kShortTimeSlice);
  if (!origin().wait(deadline_)) return;
  while (deadline_.wait_until(monotonic_now() + kTick)) {
    const MonotonicTime now = monotonic_now();
    const bool unsafe_loop = heartbeat_ && must_be_safe(heartbeat_->check(now, heartbeat_deadline_));
    if (unsafe_loop && !want_safe_) {
      counters_.made_safe.fetch_add(1, std::memory_order_relaxed);
      make_safe(BenchTime(now.ns()));
    }
    want_safe_ = unsafe_loop;
    if (want_safe_) {
      Command c;
      while (ring_->try_pop(c)) counters_.dropped.fetch_add(1, std::memory_order_relaxed);
    }
    apply_until(BenchTime(now.ns()));  // wall runs: bench time is CLOCK_MONOTONIC
    // The model goes on while nobody commands. What takes effect by then has been applied above, but for what
    // the loop gives with less latency than a tick.
    (void)model_->read(signals_.front(), BenchTime(now.ns()) - kTick * 2);
  }
}

/// A sink has one latency, so that commands stand in the ring in the order of their instants.
void SimulatedSink::apply_until(BenchTime now) {
  for (const Command* c = ring_->peek(); c && c->t_effect <= now; c = ring_->peek()) {
    apply(*c);
    ring_->drop_front();
  }
}

void SimulatedSink::apply(const Command& c) {
  if (!virtual_time_ && monotonic_now().ns() - c.t_effect.ns() > std::max(loop_period_, kTick * 2).ns())
    counters_.late.fetch_add(1, std::memory_order_relaxed);
  bool taken = c.count == signals_.size();
  for (std::size_t i = 0; taken && i < signals_.size(); ++i)
    taken = model_->write(signals_[i], c.value[i], c.t_effect);
  (taken ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
}

void SimulatedSink::make_safe(BenchTime t) {
  for (const auto& [signal, value] : safe_)
    if (!model_->write(signal, value, t)) counters_.failed.fetch_add(1, std::memory_order_relaxed);
}

}  // namespace rigor

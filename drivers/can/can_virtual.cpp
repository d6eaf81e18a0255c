#include "drivers/can/can_virtual.h"

#include <algorithm>

#include "rt-core/epoch.h"
#include "rt-core/heartbeat.h"
#include "sensor-hal/channel/pending_commands.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::can {
namespace {

LogEntry log_entry(const CanFrame& f, BenchTime t, const std::string& interface) noexcept {
  LogEntry e;
  e.t = kVirtualEpoch.to_utc(t);
  e.set_interface(interface);
  e.frame = f;
  if (f.fd) e.fd_flags = static_cast<std::uint8_t>(4 | (f.bit_rate_switch ? 1 : 0));
  return e;
}

bool wanted(const SourceSettings& s, const CanFrame& f) noexcept {
  if (f.fd && !s.fd) return false;
  if (f.error) return s.errors;
  return s.filters.empty() ||
         std::any_of(s.filters.begin(), s.filters.end(), [&](const Filter& x) { return passes(x, f); });
}

class VirtualSource final : public StreamSource, private VirtualBus::Participant {
 public:
  explicit VirtualSource(std::shared_ptr<NodeOnBus> node) : node_(std::move(node)) {}
  ~VirtualSource() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  void complete_until(BenchTime now) override { node_->bus()->advance(now); }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    settings_ = SourceSettings::parse(config, description_);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (!context.virtual_time)
      return fail(ErrorCode::wrong_state, config().name, "expected virtual time, got a wall-clock run");
    if (!settings_.log.empty())
      if (auto s = log_.open(settings_.log); !s) return s;
    table_ = SignalTable(settings_);
    open_stream(settings_.slots, 0, true);
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_start(BenchTime t0) override {
    t0_ = t0;
    index_ = 0;
    running_ = true;
    if (auto s = node_->start(t0); !s) return s;
    node_->bus()->join(this, VirtualBus::Rank::sample);
    return {};
  }
  Status do_stop() override {
    node_->bus()->leave(this);
    if (std::exchange(running_, false)) node_->stop();
    close_stream();
    health_.connected.store(false, std::memory_order_release);
    return log_.close();
  }

 private:
  [[nodiscard]] BenchTime next_action(BenchTime now) const noexcept override {
    if (!settings_.sampled) return BenchTime::never();
    const auto t = t0_ + config().period * static_cast<std::int64_t>(index_);
    return t <= now ? t : BenchTime::never();
  }
  void act(BenchTime t) override {
    auto slot = take_slot();
    if (slot) table_.fill(*slot, t);
    give(std::move(slot), t);
  }
  void receive(const CanFrame& f, BenchTime t) override {
    if (!wanted(settings_, f)) return;
    if (log_.is_open()) log_.write(log_entry(f, t, settings_.interface));
    if (!settings_.raw()) {
      if (!table_.take(f, t) || settings_.sampled) return;
      auto slot = take_slot();
      if (slot) table_.fill(*slot, t);
      return give(std::move(slot), t);
    }
    auto slot = take_slot();
    if (slot) {
      auto& sample = *slot;
      sample.info = f;
      sample.size_bytes = 0;
      sample.stamp.validity = kValid;
    }
    give(std::move(slot), t);
  }
  void give(SampleSlot&& slot, BenchTime t) {
    if (slot) {
      auto& stamp = slot->stamp;
      stamp.sequence = index_;
      stamp.t_capture = t;
      stamp.t_release = stamp.t_arrival = t + config().latency;
      stamp.sigma_capture = {};
    }
    ++index_;
    hand_over(std::move(slot));
  }

  std::shared_ptr<NodeOnBus> node_;
  SourceSettings settings_;
  SignalTable table_;
  LogWriter log_;
  BenchTime t0_;
  std::uint64_t index_ = 0;
  bool running_ = false;
};

class VirtualSink final : public Sink, private VirtualBus::Participant {
 public:
  explicit VirtualSink(std::shared_ptr<NodeOnBus> node) : node_(std::move(node)) {}
  ~VirtualSink() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  [[nodiscard]] bool command(const Command& c) noexcept override {
    if (!pending_.push(c)) {
      counters_.dropped.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    counters_.accepted.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  void complete_until(BenchTime now) override { node_->bus()->advance(now); }
  void watch(const Heartbeat* heartbeat, Duration) override { heartbeat_ = heartbeat; }

 protected:
  Status do_configure(const ChannelConfig& config) override {
    settings_ = SinkSettings::parse(config, description_);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (!context.virtual_time)
      return fail(ErrorCode::wrong_state, config().name, "expected virtual time, got a wall-clock run");
    frames_ = CommandFrames(settings_);
    frames_.make_safe();
    (void)pending_.clear();
    next_.assign(settings_.messages.size(), BenchTime::never());
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_start(BenchTime t0) override {
    running_ = true;
    next_.assign(settings_.messages.size(), t0);
    if (auto s = node_->start(t0); !s) return s;
    node_->bus()->join(this, VirtualBus::Rank::command);
    return {};
  }
  Status do_stop() override {
    node_->bus()->leave(this);
    counters_.dropped.fetch_add(pending_.clear(), std::memory_order_relaxed);
    if (std::exchange(running_, false)) node_->stop();
    health_.connected.store(false, std::memory_order_release);
    return {};
  }

 private:
  [[nodiscard]] BenchTime next_action(BenchTime now) const noexcept override {
    auto t = pending_.next();
    for (const auto next : next_) t = std::min(t, next);
    return t <= now ? t : BenchTime::never();
  }
  void act(BenchTime t) override {
    while (pending_.next() <= t) apply(pending_.pop(), t);
    for (std::size_t i = 0; i < next_.size(); ++i) {
      if (next_[i] > t) continue;
      send(i);
      const Duration period = settings_.messages[i].period;
      next_[i] = period.ns() > 0 ? next_[i] + period : BenchTime::never();
    }
  }
  void apply(const Command& c, BenchTime t) {
    if (heartbeat_ && heartbeat_->stop_reason() != StopReason::none) {
      // The loop has ended: what it wanted last no longer counts.
      counters_.dropped.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    if (c.t_effect < t) counters_.late.fetch_add(1, std::memory_order_relaxed);
    if (!frames_.apply(c)) {
      counters_.failed.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    counters_.applied.fetch_add(1, std::memory_order_relaxed);
    for (std::size_t i = 0; i < next_.size(); ++i)
      if (next_[i] > t && (settings_.announce || settings_.messages[i].period.ns() == 0)) send(i);
  }
  void send(std::size_t i) {
    if (node_->bus()->send(this, frames_.frames()[i]))
      health_.received.fetch_add(1, std::memory_order_relaxed);
    else
      counters_.failed.fetch_add(1, std::memory_order_relaxed);
  }
  void receive(const CanFrame&, BenchTime) override {}

  std::shared_ptr<NodeOnBus> node_;
  SinkSettings settings_;
  CommandFrames frames_;
  PendingCommands pending_;
  std::vector<BenchTime> next_;
  const Heartbeat* heartbeat_ = nullptr;
  bool running_ = false;
};

}  // namespace

Status NodeOnBus::start(BenchTime t0) {
  if (users_++ > 0) return {};
  node_->start(t0);
  if (!node_->settings().log.empty())
    if (auto s = log_.open(node_->settings().log); !s) return s;
  bus_->join(this, VirtualBus::Rank::node);
  return {};
}

void NodeOnBus::stop() {
  if (users_ == 0 || --users_ > 0) return;
  bus_->leave(this);
  (void)log_.close();
}

BenchTime NodeOnBus::next_action(BenchTime now) const noexcept {
  const auto t = node_->next_event();
  return t <= now ? t : BenchTime::never();
}

void NodeOnBus::act(BenchTime t) {
  node_->act(t, [&](const CanFrame& f) {
    if (log_.is_open()) log_.write(log_entry(f, t, node_->settings().interface));
    return bus_->send(this, f);
  });
}

void NodeOnBus::receive(const CanFrame& f, BenchTime t) {
  if (log_.is_open()) log_.write(log_entry(f, t, node_->settings().interface));
  node_->receive(f, t);
}

Result<std::shared_ptr<NodeOnBus>> VirtualBuses::node(const DeviceParts& parts, const ConfigNode& params) {
  auto parsed = catch_config([&] {
    auto s = NodeSettings::parse(params);
    params.finish();
    return s;
  });
  if (!parsed) return tl::unexpected<Error>(parsed.error());
  std::erase_if(buses_, [](const auto& entry) { return entry.second.expired(); });
  std::erase_if(nodes_, [](const auto& entry) { return entry.second.expired(); });
  const void* world = parts.motion ? static_cast<const void*>(parts.motion.get()) : parts.signals.get();
  auto& known = nodes_[{world, params.path() + params.place()}];
  if (auto node = known.lock()) return node;
  auto& known_bus = buses_[{world, parsed->interface}];
  auto bus = known_bus.lock();
  if (!bus) known_bus = bus = std::make_shared<VirtualBus>(parsed->rates);
  if (bus->rates().nominal != parsed->rates.nominal || bus->rates().data != parsed->rates.data)
    return tl::unexpected<Error>(
        params.error("bitrate", "expected the rates that the other nodes of " + parsed->interface + " state")
            .error());
  auto made = EmulatedNode::make(*parsed, parts.signals);
  if (!made) {
    const auto& e = made.error();
    return fail(e.code, params.place(), e.text());
  }
  auto node = std::make_shared<NodeOnBus>(std::move(bus), std::move(*made));
  known = node;
  return node;
}

std::unique_ptr<Source> make_virtual_source(std::shared_ptr<NodeOnBus> node) {
  return std::make_unique<VirtualSource>(std::move(node));
}
std::unique_ptr<Sink> make_virtual_sink(std::shared_ptr<NodeOnBus> node) {
  return std::make_unique<VirtualSink>(std::move(node));
}

}  // namespace rigor::can

#include "bench/plant/plant_source.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cstring>

#include "bench/plant/plants.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor::plant {
namespace {

constexpr std::size_t kEvents = 32;

/// Samples that wait for their release, and those that the application and the recorder hold.
std::size_t slots_of(const ChannelConfig& config) {
  const auto waiting = config.latency.ns() / config.period.ns();
  return 64 + static_cast<std::size_t>(std::clamp<std::int64_t>(2 * waiting, 0, 4096));
}

}  // namespace

PlantSource::~PlantSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status PlantSource::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  plant_ = plants_.of(n);
  signals_.clear();
  description_ = {};
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  const auto& known = plant_->signals();
  const auto add = [&](std::size_t i) {
    signals_.push_back(i);
    description_.names.push_back(known[i].name);
    description_.units.push_back(known[i].unit);
  };
  if (!n.has("signals")) {
    for (std::size_t i = 0; i < known.size(); ++i)
      if (!known[i].commanded) add(i);
  } else {
    std::vector<std::string> names;
    for (const auto& s : known) names.push_back(s.name);
    for (const ConfigNode& item : n.list("signals")) {
      const std::string name = item.as_text();
      const auto it = std::ranges::find(names, name);
      if (it == names.end())
        throw item.error(
            "", fmt::format("expected a signal of the plant {} ({}), got \"{}\"{}", plant_->settings().name,
                            fmt::join(names, ", "), name, did_you_mean(name, names)));
      add(static_cast<std::size_t>(it - names.begin()));
    }
  }
  if (signals_.empty() || signals_.size() > RegisterBlock::kMax)
    throw n.error(
        n.has("signals") ? "signals" : "",
        fmt::format(
            "expected 1 to {} signals in a channel, got {}; name those that are wanted with `signals`",
            RegisterBlock::kMax, signals_.size()));
  if (config.period.ns() <= 0) throw n.error("rate_hz", "expected a rate, found none");
  plant_->keep(config.latency);
  return {};
}

Status PlantSource::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  open_stream(slots_of(config()), 0, virtual_time_);
  events_ = std::make_unique<SpscRing<SampleLease>>(kEvents);
  if (!event_pool_) event_pool_ = make_sample_pool(2 * kEvents, 0);
  late_told_ = false;
  restarts_ = 0;
  index_ = 0;
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status PlantSource::do_start(BenchTime t0) {
  t0_ = t0;
  if (!virtual_time_) {
    plant_->subscribe(this);  // its thread waits for t0, and holds no lock meanwhile
    subscribed_ = true;
  }
  return {};
}

Status PlantSource::do_stop() {
  if (std::exchange(subscribed_, false)) plant_->unsubscribe(this);
  close_stream();
  SampleLease left;
  while (events_ && events_->try_pop(left)) {
  }
  health_.connected.store(false, std::memory_order_release);
  return {};
}

SampleLease PlantSource::poll_event() noexcept {
  SampleLease lease;
  if (events_) (void)events_->try_pop(lease);
  return lease;
}

/// Virtual time, on the loop's thread.
void PlantSource::complete_until(BenchTime now) {
  if (state() != ChannelState::running) return;
  while (capture_time() + config().latency <= now) capture();
}

/// Wall clock, on the plant's thread.
void PlantSource::plant_reached(BenchTime t) noexcept {
  while (capture_time() <= t) capture();
}

void PlantSource::capture() noexcept {
  const BenchTime t = capture_time();
  std::array<double, RegisterBlock::kMax> value{};
  const bool known = plant_->read_all(signals_, t, value);
  look_at_plant(t);
  if (!known) {
    count_lost(1);
  } else {
    auto slot = take_slot();
    if (slot) {
      auto& sample = *slot;
      auto& block = sample.info.emplace<RegisterBlock>();
      block.count = static_cast<std::uint32_t>(signals_.size());
      std::copy_n(value.begin(), signals_.size(), block.value.begin());
      sample.size_bytes = 0;
      sample.stamp = {};
      sample.stamp.sequence = index_;
      sample.stamp.t_capture = t;
      sample.stamp.t_release = t + config().latency;
      sample.stamp.t_arrival = virtual_time_ ? sample.stamp.t_release : bench_now();
    }
    hand_over(std::move(slot));
  }
  ++index_;
}

/// What happened to the FMU since the capture before.
void PlantSource::look_at_plant(BenchTime t) {
  const PlantFacts f = plant_->facts();
  const bool was = health_.connected.load(std::memory_order_relaxed);
  if (f.faulty && was) tell(kEventFault, static_cast<double>(f.faults), f.fault, t);
  // It may have failed and come back between two captures.
  if (!f.faulty && (!was || f.restarts != restarts_))
    tell(kEventBack, static_cast<double>(f.restarts), "the FMU was started again", t);
  if (f.late > 0 && !std::exchange(late_told_, true))
    tell(kEventLate, static_cast<double>(f.late), "a step of the FMU missed its deadline", t);
  restarts_ = f.restarts;
  health_.connected.store(!f.faulty, std::memory_order_release);
  health_.protocol_errors.store(f.faults, std::memory_order_relaxed);
  health_.reconnects.store(f.restarts, std::memory_order_relaxed);
}

void PlantSource::tell(std::uint32_t code, double value, const std::string& text, BenchTime t) noexcept {
  auto slot = event_pool_->try_acquire();
  if (!slot) return;
  auto& sample = *slot;
  EventInfo info{.code = code, .value = value};
  std::strncpy(info.text.data(), text.c_str(), info.text.size() - 1);
  sample.info = info;
  sample.size_bytes = 0;
  sample.stamp = {};
  sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = virtual_time_ ? t : bench_now();
  (void)events_->try_push(std::move(slot));  // told to nobody: the counters have it all the same
}

}  // namespace rigor::plant

#include "sensor-hal/channel/pair_source.h"

#include <algorithm>
#include <limits>
#include <string_view>

#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/channel/pair_monitor.h"

namespace rigor {

bool PairSource::SideState::push(SampleLease&& s) noexcept {
  if (pending.full()) return false;
  pending.push_back(std::move(s));
  return true;
}

const SampleLease* PairSource::SideState::due(BenchTime now) const noexcept {
  return !pending.empty() && pending.front()->stamp.t_release <= now ? &pending.front() : nullptr;
}

PairSource::PairSource(std::unique_ptr<Source> real, std::unique_ptr<FollowerSource> simulated,
                       WorkerPool& workers)
    : real_(std::move(real)), simulated_(std::move(simulated)), statistics_(workers) {}

PairSource::~PairSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
}

void PairSource::watch(std::unique_ptr<PairMonitor> monitor) {
  monitor_ = std::move(monitor);
  statistics_.watch(monitor_.get());
}

Status PairSource::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  if (config.period.ns() <= 0)
    return fail(ErrorCode::bad_input, n.place(),
                config.name + ": expected a rate: a pair compares at periodic instants");
  const bool real_first = n.choice_or("active", {"real", "simulated"}, "real") == "real";
  const double latency_ms = config.latency.seconds() * 1e3, period_ms = config.period.seconds() * 1e3;
  const double default_ms = config.latency.ns() > 0 ? latency_ms / 2 : period_ms / 2;
  const auto overdue = seconds_from(n.number_or("overdue_ms", default_ms, {.min = 0, .max = 60e3}) * 1e-3);
  const auto phase = seconds_from(n.number_or("phase_us", 0, {.min = 0, .max = period_ms * 1e3}) * 1e-6);

  ChannelConfig side = config;
  side.name = config.name + ".real";
  side.params = n.map_or_absent("real");
  if (auto s = real_->configure(side); !s) return s;
  side.name = config.name + ".simulated";
  side.params = n.map_or_absent("simulated");
  if (auto s = simulated_->configure(side); !s) return s;

  period_ = config.period;
  latency_ = config.latency;
  overdue_ = overdue;
  phase_ = phase;
  initial_ = real_first ? PairSide::real : PairSide::simulated;
  description_ = real_->describe();
  const ChannelDescription& simulated = simulated_->describe();
  description_.max_bytes = std::max(description_.max_bytes, simulated.max_bytes);
  if (description_.width_px == 0) {  // the device tells its size when it is opened
    description_.width_px = simulated.width_px;
    description_.height_px = simulated.height_px;
    description_.format = simulated.format;
  }
  if (description_.frame_id.empty()) description_.frame_id = simulated.frame_id;
  // Both sides are one sensor at one place: a frame that a side made of its own name is called after the
  // channel.
  if (const std::string real = config.name + ".real"; description_.frame_id.starts_with(real))
    description_.frame_id.replace(0, real.size(), config.name);
  return {};
}

Status PairSource::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  if (auto s = real_->arm(context); !s) return s;
  if (auto s = simulated_->arm(context); !s) {
    (void)real_->stop();
    return s;
  }
  if (!event_pool_) event_pool_ = make_sample_pool(events_.capacity() * 2, 0);
  if (!statistics_.start(virtual_time_)) {
    (void)simulated_->stop();
    (void)real_->stop();
    return fail(ErrorCode::unavailable, config().name, "more simulated channels than the worker pool takes");
  }
  return {};
}

Status PairSource::do_start(BenchTime t0) {
  for (SideState& s : sides_) s = SideState{};
  ahead_.reset();
  after_switch_.reset();
  events_.clear();
  event_sequence_ = 0;
  any_cycle_ = any_real_ = any_handed_ = false;
  misplaced_.store(0, std::memory_order_relaxed);
  anchor_index_ = next_simulated_ = last_handed_ = 0;
  t0_ = t0;
  anchor_t_ = t0 + phase_;
  last_simulated_t_ = last_handed_t_ = BenchTime(std::numeric_limits<std::int64_t>::min());
  switch_.start(initial_);
  handed_side_ = initial_;
  if (monitor_) monitor_->start(t0);
  if (auto s = real_->start(t0); !s) return s;
  if (auto s = simulated_->start(t0); !s) return s;  // `stop` ends the real side: it is armed or running
  running_ = true;
  return {};
}

Status PairSource::do_stop() {
  running_ = false;
  statistics_.stop();
  Status first;
  for (Source* side : {real_.get(), static_cast<Source*>(simulated_.get())})
    if (side->state() == ChannelState::armed || side->state() == ChannelState::running)
      if (auto s = side->stop(); !s && first) first = s;
  for (SideState& s : sides_) s = SideState{};
  ahead_.reset();
  after_switch_.reset();
  return first;
}

std::vector<std::string> PairSource::warnings() const {
  std::vector<std::string> all = real_->warnings();
  for (std::string& w : simulated_->warnings()) all.push_back(std::move(w));
  return all;
}

BenchTime PairSource::predicted(std::uint64_t index) const noexcept {
  // By the grid and how far the anchor lies from it, so that the instants of a device on the grid come out to
  // the nanosecond.
  const auto on_grid = [this](std::uint64_t k) { return period_ * static_cast<std::int64_t>(k); };
  const BenchTime t = anchor_t_ + (on_grid(index) - on_grid(anchor_index_));
  return std::max(t, last_simulated_t_ == BenchTime(std::numeric_limits<std::int64_t>::min())
                         ? t
                         : last_simulated_t_ + Duration(1));
}

void PairSource::begin_cycle(BenchTime now) noexcept {
  if (!running_) return;
  real_->begin_cycle(now);
  if (!virtual_time_) request_overdue(now, overdue_);
}

void PairSource::complete_until(BenchTime now) {
  if (!running_) return;
  statistics_.drain();
  take_notes();
  real_->complete_until(now);
  take_in(now);
  request_overdue(now, latency_);
  simulated_->complete_until(now);
}

void PairSource::take_in(BenchTime now) noexcept {
  while (true) {
    if (!ahead_) ahead_ = real_->poll(now);
    if (!ahead_) break;
    // In virtual time a sample that happens to be there early must not be seen early: the simulated side's
    // request would depend on it.
    if (virtual_time_ && ahead_->stamp.t_release > now) break;
    take_real(std::move(ahead_));
    ahead_.reset();
  }
  while (SampleLease s = simulated_->poll(now))
    if (!state_of(PairSide::simulated).push(std::move(s)))
      health_.ring_full.fetch_add(1, std::memory_order_relaxed);
}

void PairSource::take_real(SampleLease&& sample) noexcept {
  const Stamp& stamp = sample->stamp;
  // A camera that runs freely was measuring while the bench was still starting: that is not of this run.
  if (stamp.t_capture + period_ / 2 < t0_) {
    // and a clock that was right before is wrong now
    misplaced_.fetch_add(any_real_, std::memory_order_relaxed);
    return;
  }
  const std::int64_t steps = period_.nearest_index(stamp.t_capture - anchor_t_);
  const std::uint64_t index =
      any_real_ ? anchor_index_ + static_cast<std::uint64_t>(std::max<std::int64_t>(1, steps))
                : static_cast<std::uint64_t>(std::max<std::int64_t>(0, steps));
  // Instants that were not yet requested of the simulated side, because the real side ran ahead of its
  // prediction.
  constexpr std::uint64_t kCatchUp = 8;
  if (index > next_simulated_ + kCatchUp) next_simulated_ = index - kCatchUp;
  while (next_simulated_ < index) request_simulated(next_simulated_, predicted(next_simulated_));
  anchor_index_ = index;
  anchor_t_ = stamp.t_capture;
  any_real_ = true;
  if (next_simulated_ == index) request_simulated(index, stamp.t_capture);
  SampleSlot numbered = sample.take_back();
  if (!numbered) {  // the device's source keeps a lease, which it must not
    misplaced_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  numbered->stamp.sequence = index;
  if (!state_of(PairSide::real).push(std::move(numbered)))
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
}

void PairSource::request_simulated(std::uint64_t index, BenchTime t_capture) noexcept {
  (void)simulated_->request_at(index,
                               t_capture);  // a refusal is in its health counters, and a gap in its sequence
  last_simulated_t_ = t_capture;
  next_simulated_ = index + 1;
}

void PairSource::request_overdue(BenchTime now, Duration margin) noexcept {
  for (BenchTime t = predicted(next_simulated_); t + margin <= now; t = predicted(next_simulated_))
    request_simulated(next_simulated_, t);
}

void PairSource::new_cycle(BenchTime now) noexcept {
  cycle_ = now;
  any_cycle_ = true;
  take_in(now);
  if (switch_.advance()) tell_switch(active(), now);
  if (!virtual_time_) take_notes();
}

/// What the watch has to tell: windows to the observer, the rest as events of this pair.
void PairSource::take_notes() noexcept {
  if (!monitor_) return;
  while (SampleLease note = monitor_->take()) {
    const auto* told = note->as<EventInfo>();
    if (!told) continue;
    if (told->code == kEventPairWindow) {
      if (observer_) observer_->on_window(note);
      continue;
    }
    EventInfo info;
    info.code = told->code;
    info.value = told->value;
    EventText(info).add(config().name).add(": ").add(told->text.data());
    tell(note->stamp.t_capture, info);
  }
}

void PairSource::tell_switch(PairSide to, BenchTime now) noexcept {
  // What the other side had not handed on by now: the newest of this side is there already, so it goes out at
  // once.
  const SideState& side = state_of(to);
  if (side.any_due && (!any_handed_ || side.last_due_index > last_handed_)) after_switch_ = side.last_due;

  EventInfo info;
  info.code = kEventPairSwitch;
  info.value = to == PairSide::real ? 0 : 1;
  EventText(info)
      .add(config().name)
      .add(": ")
      .add(name_of(to))
      .add(" is handed on instead of ")
      .add(name_of(other(to)))
      .add(", from sequence ")
      .add(after_switch_ ? after_switch_->stamp.sequence
           : any_handed_ ? last_handed_ + 1
                         : 0);
  tell(now, info);
}

/// Queues an event. False: there is no place, because nobody takes them.
bool PairSource::tell(BenchTime now, const EventInfo& info) noexcept {
  if (events_.full()) return false;
  SampleSlot event = event_pool_->try_acquire();
  if (!event) return false;
  event->stamp = Stamp{};
  event->stamp.sequence = event_sequence_++;
  event->stamp.t_capture = event->stamp.t_release = event->stamp.t_arrival = now;
  event->info = info;
  event->size_bytes = 0;
  events_.push_back(std::move(event));
  return true;
}

/// Copied: whoever holds an event must not hold up the device's own few.
void PairSource::pass_on_events() noexcept {
  while (!events_.full()) {
    const SampleLease told = real_->poll_event();
    if (!told) return;
    const auto* theirs = told->as<EventInfo>();
    if (!theirs) continue;
    EventInfo info;
    info.code = theirs->code + kEventOfRealSide;
    info.value = theirs->value;
    EventText(info).add(real_->config().name).add(": ").add(theirs->text.data());
    // Where there is no place it is counted in the device's health all the same.
    if (!tell(told->stamp.t_release, info)) return;
  }
}

SampleLease PairSource::poll_event() noexcept {
  if (running_) pass_on_events();
  return events_.empty() ? SampleLease{} : events_.pop_front();
}

SampleLease PairSource::poll(BenchTime now) noexcept {
  if (!running_) return {};
  if (!any_cycle_ || now != cycle_) new_cycle(now);
  if (after_switch_) {
    const SampleLease sample = std::move(after_switch_);
    after_switch_.reset();
    return deliver(active(), sample);
  }
  while (true) {
    const SampleLease* real = state_of(PairSide::real).due(now);
    const SampleLease* simulated = state_of(PairSide::simulated).due(now);
    if (!real && !simulated) return {};
    const PairSide side = !simulated || (real && (*real)->stamp.sequence <= (*simulated)->stamp.sequence)
                              ? PairSide::real
                              : PairSide::simulated;
    const SampleLease sample = state_of(side).pending.pop_front();
    sample_due(side, sample);
    if (side != active()) continue;
    if (any_handed_ &&
        (sample->stamp.sequence <= last_handed_ || sample->stamp.t_capture <= last_handed_t_)) {
      // a device's clock that was set back
      misplaced_.fetch_add(sample->stamp.sequence > last_handed_, std::memory_order_relaxed);
      continue;
    }
    return deliver(side, sample);
  }
}

void PairSource::sample_due(PairSide side, const SampleLease& sample) noexcept {
  SideState& mine = state_of(side);
  SideState& theirs = state_of(other(side));
  const std::uint64_t index = sample->stamp.sequence;
  statistics_.came(side, mine.any_due ? index - mine.last_due_index - 1 : index);
  mine.last_due = sample;
  mine.last_due_index = index;
  mine.any_due = true;
  const auto shown = [](const SideState& s) { return s.any_due ? s.last_due_index + 1 : 0; };
  const std::uint64_t mine_shown = shown(mine), theirs_shown = shown(theirs);
  statistics_.behind(side, theirs_shown > mine_shown ? theirs_shown - mine_shown : 0);
  statistics_.behind(other(side), mine_shown > theirs_shown ? mine_shown - theirs_shown : 0);
  if (observer_) observer_->on_side_sample(side, sample);
  if (theirs.last_due && theirs.last_due_index == index &&
      theirs.last_due->stamp.t_capture == sample->stamp.t_capture)
    statistics_.compare(state_of(PairSide::real).last_due, state_of(PairSide::simulated).last_due);
}

SampleLease PairSource::deliver(PairSide side, const SampleLease& sample) noexcept {
  any_handed_ = true;
  last_handed_ = sample->stamp.sequence;
  last_handed_t_ = sample->stamp.t_capture;
  handed_side_ = side;
  health_.received.fetch_add(1, std::memory_order_relaxed);
  if (sample->stamp.validity & kIncomplete) health_.incomplete.fetch_add(1, std::memory_order_relaxed);
  return sample;
}

HealthSnapshot PairSource::health() const noexcept {
  HealthSnapshot h = health_.snapshot();  // received, incomplete and ring_full are the pair's own
  const HealthSnapshot real = real_->health(), simulated = simulated_->health();
  h.connected = (active() == PairSide::real ? real : simulated).connected;
  h.lost = real.lost + simulated.lost + misplaced_.load(std::memory_order_relaxed);
  h.no_slot = real.no_slot + simulated.no_slot;
  h.protocol_errors = real.protocol_errors + simulated.protocol_errors;
  h.retries = real.retries + simulated.retries;
  h.reconnects = real.reconnects + simulated.reconnects;
  return h;
}

}  // namespace rigor

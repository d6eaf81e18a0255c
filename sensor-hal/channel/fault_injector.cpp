#include "sensor-hal/channel/fault_injector.h"

#include <algorithm>
#include <cmath>

#include "sensor-hal/channel/event_text.h"

namespace rigor {
namespace {

void forget_run(Fault& f) noexcept {
  for (auto* n : {&f.count.begins, &f.count.seen, &f.count.dropped, &f.count.changed, &f.count.delayed})
    n->store(0, std::memory_order_relaxed);
  f.on = f.over = f.left = false;
  f.span_count = 0;
  f.triggered = f.was_true = f.in_burst = f.burst_known = f.has_kept_values = false;
  f.kept.reset();
  f.held.clear();
}

/// As much of it as an event shows, not ending within a character.
std::string_view shown(std::string_view text) noexcept {
  constexpr std::size_t kMost = 240;
  if (text.size() <= kMost) return text;
  std::size_t n = kMost;
  while (n > 0 && (static_cast<unsigned char>(text[n]) & 0xc0) == 0x80) --n;
  return text.substr(0, n);
}

}  // namespace

std::unique_ptr<Fault> FaultInjector::make(FaultReading reading, std::uint32_t index, bool live) const {
  auto f = std::make_unique<Fault>();
  // The channel's key, and from it one of each fault's own, so that no two share a draw.
  const auto channel = models::channel_key(seed_, models::channel_id_from_name(subject_.channel));
  f->key = models::channel_key((std::uint64_t{channel.word1} << 32) | channel.word0, index);
  f->spec = std::move(reading.spec);
  f->component = reading.component;
  f->signal = std::move(reading.signal);
  // Of a live one it would only keep a parsed document alive.
  if (!live) f->node = std::move(reading.node);
  f->index = index;
  f->live = live;
  f->from = f->spec.from;
  f->until = f->spec.until;
  f->on_for = f->spec.on_for;
  const bool once = f->spec.every.ns() == 0 && f->spec.trigger.when == FaultTrigger::When::always;
  if (!live && once && f->on_for.ns() > 0) {
    f->until = f->from + f->on_for;
    f->on_for = {};
  }
  f->identity = std::make_shared<const FaultIdentity>(
      FaultIdentity{subject_.channel, index, f->spec.kind, live, fault_json(f->spec), fault_yaml(f->spec)});
  f->spans.resize(live ? 1 : Fault::kSpans);
  f->held.reserve(f->spec.leases);
  return f;
}

void FaultInjector::configure(const FaultSubject& subject, std::uint64_t seed, const ConfigNode& params) {
  subject_ = subject;
  seed_ = seed;
  scheduled_.clear();
  live_.clear();
  earlier_ = {};
  next_index_ = 0;
  const std::vector<ConfigNode> nodes = params.list_or_empty("faults");
  if (nodes.size() > kMost)
    throw params.error("faults", "expected at most " + std::to_string(kMost) +
                                     " faults of one channel, got " + std::to_string(nodes.size()));
  for (const ConfigNode& node : nodes) {
    scheduled_.push_back(make(read_fault(node, subject_), next_index_, false));
    ++next_index_;
  }
}

Result<Fault*> FaultInjector::make_live(const ConfigNode& node) {
  auto reading = catch_config([&] { return read_fault(node, subject_, true); });
  if (!reading) return tl::unexpected<Error>(reading.error());
  const std::lock_guard lock(live_mutex_);
  if (ended_) return fail(ErrorCode::wrong_state, subject_.channel, "the run has ended; no fault can begin");
  std::size_t there = scheduled_.size();
  for (const auto& f : live_) there += !f->over.load(std::memory_order_acquire);
  if (there >= kMost)
    return fail(ErrorCode::unavailable, subject_.channel,
                "has " + std::to_string(there) + " faults, which is as many as it can have; clear some");
  if (make_room)
    if (auto s = make_room(reading->spec.kind); !s) return tl::unexpected<Error>(s.error());
  forget_oldest();
  live_.push_back(make(std::move(*reading), next_index_++, true));
  return live_.back().get();
}

/// So that a run of days does not grow with each fault that it was ever given.
void FaultInjector::forget_oldest() {
  std::size_t left = 0;
  for (const auto& f : live_) {
    if (!f->left.load(std::memory_order_acquire)) continue;
    f->signal.reset();
    ++left;
  }
  std::erase_if(live_, [&](const std::unique_ptr<Fault>& f) {
    if (left <= kRemembered || !f->left.load(std::memory_order_acquire)) return false;
    --left;
    ++earlier_.faults;
    earlier_.begins += f->count.begins;
    earlier_.seen += f->count.seen;
    earlier_.dropped += f->count.dropped;
    earlier_.changed += f->count.changed;
    earlier_.delayed += f->count.delayed;
    return true;
  });
}

Status FaultInjector::schedule_live(const ConfigNode& node, std::uint32_t index, Duration from,
                                    Duration until) {
  auto reading = catch_config([&] { return read_fault(node, subject_, true); });
  if (!reading) return tl::unexpected<Error>(reading.error());
  if (index < next_index_)
    return fail(ErrorCode::bad_input, subject_.channel,
                "expected the recorded rig, in which the first live fault of this channel had the index " +
                    std::to_string(index) + "; this rig has " + std::to_string(next_index_) +
                    " scheduled ones");
  next_index_ = index + 1;
  auto fault = make(std::move(*reading), index, true);
  fault->from = from;
  fault->until = until;
  fault->on_for = {};
  scheduled_.push_back(std::move(fault));
  return {};
}

void FaultInjector::arm() {
  // A recording may have brought more than one run takes at a time.
  all_.reserve(scheduled_.size() + 2 * kMost);
  active_.reserve(scheduled_.size() + 2 * kMost);
  if (!event_pool_) event_pool_ = make_sample_pool(2 * changes_.capacity(), 0);
  const std::lock_guard lock(live_mutex_);
  ended_ = false;
}

void FaultInjector::start(BenchTime t0, Period loop_period) noexcept {
  t0_ = t0;
  period_ = loop_period;
  any_cycle_ = false;
  all_.clear();
  active_.clear();
  for (const auto& f : scheduled_) {
    forget_run(*f);
    all_.push_back(f.get());
  }
  changes_.clear();
  event_sequence_ = 0;
  running_ = true;
}

void FaultInjector::stop() noexcept {
  const std::lock_guard lock(live_mutex_);
  ended_ = true;
  running_ = false;
  for (const auto* list : {&scheduled_, &live_})
    for (const auto& f : *list) {
      f->kept.reset();
      f->held.clear();
      if (f->on && f->span_count > 0 && f->span_count <= f->spans.size())
        f->spans[f->span_count - 1].until = cycle_ + period_;
      f->on = false;
    }
  all_.clear();
  active_.clear();
}

void FaultInjector::add(Fault* live) noexcept {
  // Ended ones leave the list in the next cycle; make_live sees to it that there are never so many.
  if (!running_ || all_.size() == all_.capacity()) {
    live->over = live->left = true;
    return;
  }
  live->from = Duration(-1);  // from this cycle on
  all_.push_back(live);
}

void FaultInjector::end_live() noexcept {
  for (Fault* f : all_)
    if (f->live && (f->from < Duration(0) || f->on.load(std::memory_order_relaxed))) {
      f->from = f->until = f->on_for = Duration(0);
    }
}

bool FaultInjector::wanted(Fault& f, Duration elapsed) const noexcept {
  const FaultSpec& s = f.spec;
  if (elapsed < f.from || elapsed >= f.until) return false;
  if (s.every.ns() > 0) return (elapsed - f.from).ns() % s.every.ns() < f.on_for.ns();
  if (s.trigger.when == FaultTrigger::When::always) return true;
  bool is_true = false;
  if (f.trigger_port) switch (s.trigger.when) {
      case FaultTrigger::When::overdue:
        is_true = f.trigger_port->status() == PortStatus::overdue;
        break;
      case FaultTrigger::When::disconnected:
        is_true = f.trigger_port->status() == PortStatus::disconnected;
        break;
      default:
        if (const SampleLease& sample = f.trigger_port->sample()) {
          const double v = read_component(*sample, f.trigger_component);
          is_true =
              s.trigger.when == FaultTrigger::When::above ? v > s.trigger.threshold : v < s.trigger.threshold;
        }
    }
  if (f.on_for.ns() == 0) return is_true;
  if (is_true && !f.was_true) {
    f.triggered = true;
    f.t_triggered = t0_ + elapsed;
  }
  f.was_true = is_true;
  return f.triggered && t0_ + elapsed < f.t_triggered + f.on_for;
}

void FaultInjector::begin_cycle(BenchTime now) noexcept {
  if (!running_ || (any_cycle_ && now == cycle_)) return;
  cycle_ = now;
  any_cycle_ = true;
  if (all_.empty()) return;
  const Duration elapsed = now - t0_;
  bool changed = false;
  for (Fault* f : all_) {
    if (f->live && f->from < Duration(0)) {
      f->from = elapsed;
      if (f->on_for.ns() > 0) f->until = elapsed + f->on_for;
      f->on_for = {};
    }
    const bool want = wanted(*f, elapsed);
    if (want != f->on.load(std::memory_order_relaxed)) {
      want ? switch_on(*f, now) : switch_off(*f, now);
      changed = true;
    }
    if (f->live && !want && elapsed >= f->until) {
      f->over.store(true, std::memory_order_release);
      changed = true;
    }
  }
  if (!changed) return;
  active_.clear();
  for (Fault* f : all_)
    if (f->on.load(std::memory_order_relaxed)) active_.push_back(f);
  std::erase_if(all_, [](Fault* f) {
    if (!f->over.load(std::memory_order_relaxed)) return false;
    f->left.store(true, std::memory_order_release);  // from here on it may be gone
    return true;
  });
}

void FaultInjector::switch_on(Fault& f, BenchTime now) noexcept {
  f.t_on = now;
  f.burst_known = false;
  f.on.store(true, std::memory_order_relaxed);
  count(f.count.begins);
  if (f.span_count < f.spans.size()) f.spans[f.span_count] = {now, BenchTime(0)};
  ++f.span_count;
  tell(f, true, now);
}

void FaultInjector::switch_off(Fault& f, BenchTime now) noexcept {
  f.on.store(false, std::memory_order_relaxed);
  if (f.span_count <= f.spans.size()) f.spans[f.span_count - 1].until = now;
  f.kept.reset();
  f.has_kept_values = false;
  f.held.clear();
  tell(f, false, now);
}

void FaultInjector::tell(const Fault& f, bool begins, BenchTime now) noexcept {
  if (changes_.full()) return;  // its counters and spans say it all the same
  const auto now_at = [](const std::atomic<std::uint64_t>& n) { return n.load(std::memory_order_relaxed); };
  FaultChange& change = changes_.push_back({f.identity,
                                            begins,
                                            now,
                                            now_at(f.count.seen),
                                            now_at(f.count.dropped),
                                            now_at(f.count.changed),
                                            now_at(f.count.delayed),
                                            {}});
  SampleSlot event = event_pool_->try_acquire();
  if (!event) return;
  Sample& sample = *event;
  sample.stamp = Stamp{};
  sample.stamp.sequence = event_sequence_++;
  sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = now;
  sample.size_bytes = 0;
  EventInfo info;
  info.code = f.live ? (begins ? kEventLiveFaultBegin : kEventLiveFaultEnd)
                     : (begins ? kEventFaultBegin : kEventFaultEnd);
  info.value = f.index;
  EventText text(info);
  text.add(f.live ? "live fault " : "fault ").add(f.index).add(" of ").add(subject_.channel);
  text.add(begins ? " begins in cycle " : " ends in cycle ");
  text.add(static_cast<std::uint64_t>(std::max<std::int64_t>(0, (now - t0_) / period_)));
  if (!begins) {
    text.add(": ").add(change.seen).add(" seen, ").add(change.dropped).add(" dropped, ");
    text.add(change.changed).add(" changed, ").add(change.delayed).add(" delayed");
  }
  text.add(": ").add(shown(f.identity->yaml));
  sample.info = info;
  change.event = std::move(event);
}

FaultChange FaultInjector::poll_change() noexcept {
  return changes_.empty() ? FaultChange{} : changes_.pop_front();
}

// ------------------------------------------------------------------ one sample

namespace {
// Elements of fault_choice.
constexpr std::uint32_t kWhether = 0, kHowLong = 1, kBurst = 2;
}  // namespace

bool fault_hits(const Fault& f, std::uint64_t sequence) noexcept {
  return f.spec.probability >= 1 || fault_uniform(f.key, sequence, kWhether) < f.spec.probability;
}

// Gilbert's channel: out of a burst with 1 / mean_burst, into one with what gives the share in the long run.
bool burst_loses(Fault& f, std::uint64_t sequence) noexcept {
  const double share = f.spec.share, u = fault_uniform(f.key, sequence, kBurst);
  if (share >= 1) return true;
  const double leave = 1 / f.spec.mean_burst, enter = share / (1 - share) * leave;
  if (!f.burst_known)
    f.in_burst = u < share;
  else
    f.in_burst = f.in_burst ? u >= leave : u < enter;
  f.burst_known = true;
  return f.in_burst;
}

Duration fault_delay(const Fault& f, std::uint64_t sequence) noexcept {
  const FaultSpec& s = f.spec;
  if (s.kind == FaultKind::delay) return s.delay;
  const double a = s.jitter_a.seconds(), b = s.jitter_b.seconds();
  switch (s.shape) {
    case JitterShape::uniform:
      return seconds_from(a + (b - a) * fault_uniform(f.key, sequence, kHowLong));
    case JitterShape::exponential:
      return seconds_from(-a * std::log(fault_uniform(f.key, sequence, kHowLong)));
    case JitterShape::normal:
      return seconds_from(std::max(0.0, a + b * fault_normal(f.key, sequence, kHowLong)));
  }
  return {};
}

Duration fault_clock_offset(const Fault& f, BenchTime t_capture) noexcept {
  if (f.spec.kind != FaultKind::clock_skew) return f.spec.delay;
  return seconds_from(f.spec.ppm * 1e-6 * std::max(0.0, (t_capture - f.t_on).seconds()));
}

SampleEdit fault_edit(const Fault& f, std::uint64_t sequence, BenchTime t) noexcept {
  const FaultSpec& s = f.spec;
  SampleEdit e;
  e.kind = s.kind == FaultKind::drift ? FaultKind::bias : s.kind;
  e.component = f.component;
  e.signal = f.signal.get();
  e.amount = s.kind == FaultKind::drift ? s.amount * std::max(0.0, (t - f.t_on).seconds()) : s.amount;
  e.element_share = s.element_share.value_or(1);
  e.flips = s.flips;
  e.keep = s.keep;
  e.key = f.key;
  e.sequence = sequence;
  return e;
}

}  // namespace rigor

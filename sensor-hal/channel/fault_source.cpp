#include "sensor-hal/channel/fault_source.h"

#include <time.h>

#include <algorithm>
#include <cstring>
#include <limits>

namespace rigor {
namespace {

// Visible, application, recorder, pair: of the slots in which samples are changed.
constexpr std::size_t kForOthers = 14;

/// Which faults need slots of the decorator's own.
bool needs_room(FaultKind kind, bool elements) {
  switch (kind) {
    case FaultKind::stuck:
    case FaultKind::bias:
    case FaultKind::drift:
    case FaultKind::noise:
    case FaultKind::spike:
    case FaultKind::corrupt:
      return true;
    case FaultKind::delay:
    case FaultKind::jitter:
    case FaultKind::timestamp:
    case FaultKind::clock_skew:
    case FaultKind::clock_step:
      return !elements;  // what is held back is small, and copied, so that the inner source has its slots
    case FaultKind::drop:
    case FaultKind::burst_loss:
    case FaultKind::disconnect:
    case FaultKind::slow_consumer:
      return false;
  }
  return false;
}

void copy_sample(const Sample& content, Sample& to) noexcept {
  to.info = content.info;
  to.size_bytes = std::min(content.size_bytes, to.memory().size());
  if (to.size_bytes > 0) std::memcpy(to.memory().data(), content.bytes().data(), to.size_bytes);
}

}  // namespace

FaultySource::EditBuffers::EditBuffers(std::size_t slots, std::size_t bytes)
    : pool(make_sample_pool(slots, bytes)), slot_bytes(bytes), jobs(slots), done(slots) {}

FaultySource::FaultySource(std::unique_ptr<Source> inner, WorkerPool* workers, FrameSignalFinder find_signal)
    : inner_(std::move(inner)), workers_(workers), find_signal_(std::move(find_signal)) {
  faults_.make_room = [this](FaultKind kind) { return make_buffers(kind); };
}
FaultySource::FaultySource(std::unique_ptr<FollowerSource> inner, WorkerPool* workers,
                           FrameSignalFinder find_signal)
    : FaultySource(std::unique_ptr<Source>(), workers, std::move(find_signal)) {
  follower_ = inner.get();
  inner_ = std::move(inner);
}

FaultySource::~FaultySource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)do_stop();
  if (owned_buffers_) owned_buffers_->strand.reset();
}

Status FaultySource::do_configure(const ChannelConfig& config) {
  (void)config.params.list_or_empty("faults");  // a key of ours, which the inner source is not to refuse
  if (auto s = inner_->configure(config); !s) return s;
  description_ = inner_->describe();
  faults_.configure({config.name, config.kind, false, &description_, find_signal_}, config.seed,
                    config.params);
  return {};
}

Status FaultySource::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  slot_wait_.begin(virtual_time_);
  loop_period_ = context.loop_period;
  if (auto s = inner_->arm(context); !s) return s;
  description_ = inner_->describe();  // a device tells its size when it is opened
  faults_.arm();
  Status made;
  bool used_before = false;
  {
    const std::lock_guard lock(buffers_mutex_);
    armed_ = true;
    if (owned_buffers_ && owned_buffers_->slot_bytes != description_.max_bytes) {
      buffers_.store(nullptr, std::memory_order_release);
      owned_buffers_.reset();
    }
    used_before = owned_buffers_ != nullptr;
  }
  // A fault of the run before may still be waiting to be taken up.
  if (used_before) made = make_buffers(FaultKind::stuck);
  for (const auto& f : faults_.scheduled())
    if (made) made = make_buffers(f->spec.kind);
  if (made) return {};
  const std::lock_guard lock(buffers_mutex_);
  armed_ = false;
  (void)inner_->stop();
  return made;
}

Status FaultySource::make_buffers(FaultKind kind) {
  const bool elements = has_elements(faults_.subject().kind);
  if (!needs_room(kind, elements)) return {};
  const std::lock_guard lock(buffers_mutex_);
  if (!armed_ || buffers_.load(std::memory_order_relaxed)) return {};
  if (!owned_buffers_) {
    // Pictures: as many as are in use at a time. Small ones: as many as may wait, and some.
    constexpr std::size_t kBudgetBytes = 64 << 20;
    const std::size_t bytes = description_.max_bytes;
    const std::size_t slots =
        elements ? std::clamp<std::size_t>(kBudgetBytes / std::max<std::size_t>(bytes, 1), 20, 32)
                 : kWaiting + 64;
    owned_buffers_ = std::make_unique<EditBuffers>(slots, bytes);
  }
  EditBuffers& buffers = *owned_buffers_;
  if (workers_ && elements && !buffers.strand) {
    buffers.strand = workers_->make_strand([&buffers] {
      Job job;
      if (!buffers.jobs.try_pop(job)) return;
      copy_sample(*job.from, *job.to);
      for (std::size_t i = 0; i < job.edit_count; ++i) apply_edit(job.edits[i], *job.to);
      (void)buffers.done.try_push(std::move(job.to));  // there is a place for each slot
    });
    if (!buffers.strand)
      return fail(ErrorCode::unavailable, faults_.subject().channel,
                  "more channels with faults than the worker pool takes");
  }
  buffers_.store(&buffers, std::memory_order_release);
  return {};
}

Status FaultySource::do_start(BenchTime t0) {
  if (auto s = inner_->start(t0); !s) return s;
  waiting_.clear();
  own_waiting_ = 0;
  ahead_.reset();
  last_at_ = BenchTime(std::numeric_limits<std::int64_t>::min());
  lost_before_ = 0;
  gone_.store(false, std::memory_order_relaxed);
  for (auto* n : {&accounts_.taken, &accounts_.handed_on, &accounts_.dropped, &accounts_.disconnected,
                  &accounts_.no_slot, &accounts_.waiting, &incomplete_, &returns_})
    n->store(0, std::memory_order_relaxed);
  faults_.start(t0, loop_period_);
  running_ = true;
  return {};
}

Status FaultySource::do_stop() {
  running_ = false;
  {
    const std::lock_guard lock(buffers_mutex_);
    armed_ = false;
    buffers_.store(nullptr, std::memory_order_release);
    if (owned_buffers_) {
      owned_buffers_->strand.reset();  // waits for the sample that is being changed
      for (Job job; owned_buffers_->jobs.try_pop(job);) job = Job{};
      for (SampleLease made; owned_buffers_->done.try_pop(made);) made.reset();
    }
  }
  faults_.stop();
  waiting_.clear();
  own_waiting_ = 0;
  ahead_.reset();
  gone_.store(false, std::memory_order_relaxed);
  if (inner_->state() == ChannelState::armed || inner_->state() == ChannelState::running)
    return inner_->stop();
  return {};
}

void FaultySource::begin_cycle(BenchTime now) noexcept {
  if (!running_) return;
  faults_.begin_cycle(now);
  inner_->begin_cycle(now);
}

bool FaultySource::request_at(std::uint64_t index, BenchTime t_capture) noexcept {
  return follower_ && follower_->request_at(index, t_capture);
}

void FaultySource::complete_until(BenchTime now) {
  if (!running_) return;
  inner_->complete_until(now);
  take_in(now);
  if (EditBuffers* buffers = buffers_.load(std::memory_order_acquire); buffers && buffers->strand)
    buffers->strand->wait_idle();
}

SampleLease FaultySource::poll_event() noexcept {
  if (!running_) return {};
  while (FaultChange change = faults_.poll_change())
    if (change.event) return std::move(change.event);
  return inner_->poll_event();
}

SampleLease FaultySource::poll(BenchTime now) noexcept {
  if (!running_) return {};
  take_in(now);
  SampleLease sample;
  if (!waiting_.empty()) {
    Waiting& head = waiting_.front();
    EditBuffers* buffers = buffers_.load(std::memory_order_acquire);
    if (virtual_time_ && head.job > 0 && buffers) buffers->strand->wait_for(head.job);
    if (!head.sample && buffers) (void)buffers->done.try_pop(head.sample);
    if (head.at <= now && head.sample) {
      own_waiting_ -= head.own;
      sample = waiting_.pop_front().sample;
      count(accounts_.handed_on);
      accounts_.waiting.store(waiting_.size(), std::memory_order_relaxed);
    }
  }
  return sample;
}

bool FaultySource::cycle_allows_reading(BenchTime now) noexcept {
  faults_.begin_cycle(now);
  bool gone = false, unread = false;
  for (const Fault* f : faults_.active()) {
    gone |= f->spec.kind == FaultKind::disconnect;
    unread |= f->spec.kind == FaultKind::slow_consumer && !f->spec.hold;
  }
  if (gone_.load(std::memory_order_relaxed) && !gone) count(returns_);
  gone_.store(gone, std::memory_order_relaxed);
  return !unread;
}

void FaultySource::take_in(BenchTime now) noexcept {
  if (!cycle_allows_reading(now)) return;
  while (!waiting_.full()) {  // beyond that the inner source has to keep them, and counts what it cannot
    if (!ahead_) ahead_ = inner_->poll(now);
    // What happens to be there early in virtual time must not be seen early: when faults are on depends on
    // it.
    if (!ahead_ || (virtual_time_ && ahead_->stamp.t_release > now)) return;
    admit(std::move(ahead_));
    ahead_.reset();
  }
}

void FaultySource::lose(const Stamp& stamp, std::atomic<std::uint64_t>& account) noexcept {
  count(account);
  const std::uint64_t lost = std::uint64_t{lost_before_} + 1 + stamp.lost_before;
  lost_before_ =
      static_cast<std::uint32_t>(std::min<std::uint64_t>(lost, std::numeric_limits<std::uint32_t>::max()));
}

void FaultySource::judge(const SampleLease& sample, Verdict& v) noexcept {
  const Stamp& stamp = sample->stamp;
  const std::uint64_t sequence = stamp.sequence;
  for (Fault* f : faults_.active()) {
    count(f->count.seen);
    switch (f->spec.kind) {
      case FaultKind::drop:
      case FaultKind::burst_loss:
        // Bursts go on, whatever else happens to the sample.
        if (f->spec.kind == FaultKind::drop ? fault_hits(*f, sequence) : burst_loses(*f, sequence)) {
          if (!v.lost) {
            count(f->count.dropped);
            lose(stamp, accounts_.dropped);
          }
          v.lost = true;
        }
        break;
      case FaultKind::disconnect:
        if (!v.lost) {
          count(f->count.dropped);
          lose(stamp, accounts_.disconnected);
        }
        v.lost = true;
        break;
      case FaultKind::delay:
      case FaultKind::jitter:
        if (v.lost || !fault_hits(*f, sequence)) break;
        v.delay += fault_delay(*f, sequence);
        v.delayed = true;
        count(f->count.delayed);
        break;
      case FaultKind::timestamp:
      case FaultKind::clock_skew:
      case FaultKind::clock_step:
        if (v.lost || !fault_hits(*f, sequence)) break;
        v.shift += fault_clock_offset(*f, stamp.t_capture);
        count(f->count.changed);
        break;
      case FaultKind::stuck:
        if (v.lost) break;
        if (f->kept) {
          if (!v.stuck) v.stuck = f;
          count(f->count.changed);
        } else {
          f->kept = sample;
          v.keeps = true;
        }
        break;
      case FaultKind::bias:
      case FaultKind::drift:
      case FaultKind::noise:
      case FaultKind::spike:
      case FaultKind::corrupt:
        if (v.lost || !fault_hits(*f, sequence)) break;
        v.edits[v.edit_count++] = fault_edit(*f, sequence, stamp.t_capture);
        if (f->spec.kind == FaultKind::corrupt && f->spec.flagged)
          v.validity |= (f->spec.flips > 0 ? kCorrupt : kValid) | (f->spec.keep < 1 ? kIncomplete : kValid);
        count(f->count.changed);
        break;
      case FaultKind::slow_consumer:
        if (!v.lost && f->spec.hold && f->held.size() < f->held.capacity()) f->held.push_back(sample.hold());
        break;
    }
  }
}

SampleSlot FaultySource::take_slot(EditBuffers* buffers) noexcept {
  if (!buffers) return {};
  // Those that are held back here leave some for the others, so that in virtual time it is not waited for in
  // vain.
  if (virtual_time_ && own_waiting_ + kForOthers > buffers->pool->size()) return {};
  return slot_wait_.acquire(*buffers->pool);
}

/// Puts into `slot`, whose stamp is made already, what the faults make of the sample, at once or by a worker:
/// then the answer is the number of its job, and `sample` is empty until that is done.
std::uint64_t FaultySource::change(SampleLease& sample, const Verdict& v, EditBuffers& buffers,
                                   SampleSlot&& slot) noexcept {
  SampleLease content = v.stuck ? v.stuck->kept : std::move(sample);
  sample.reset();
  if (buffers.strand && content->size_bytes > kInlineBytes) {
    Job work;
    work.from = std::move(content);
    work.to = std::move(slot);
    work.edits = v.edits;
    work.edit_count = v.edit_count;
    (void)buffers.jobs.try_push(std::move(work));  // there is a place for each slot
    buffers.strand->submit();
    return buffers.strand->submitted();
  }
  copy_sample(*content, *slot);
  for (std::size_t i = 0; i < v.edit_count; ++i) apply_edit(v.edits[i], *slot);
  sample = std::move(slot);
  return 0;
}

/// The answer: not to be handed on before.
BenchTime FaultySource::restamp(Stamp& stamp, const Verdict& v) noexcept {
  BenchTime at(std::numeric_limits<std::int64_t>::min());
  if (virtual_time_) at = stamp.t_release;
  if (v.stuck && v.stuck->spec.freeze) stamp.t_capture = v.stuck->kept->stamp.t_capture;
  if (v.shift.ns() != 0) {
    stamp.t_capture = stamp.t_capture + v.shift;
    stamp.t_release = stamp.t_release + v.shift;
    if (virtual_time_) at = std::max(at, stamp.t_release);
  }
  if (v.delayed) {
    at = std::max(at, stamp.t_release + v.delay);
    stamp.t_arrival = std::max(stamp.t_arrival, at);
  }
  if (!waiting_.empty() && last_at_ > at) {
    at = last_at_;
    stamp.t_arrival = std::max(stamp.t_arrival, at);
  }
  if (lost_before_ > 0) {
    stamp.lost_before += lost_before_;
    lost_before_ = 0;
  }
  if (v.validity != 0) {
    if ((v.validity & kIncomplete) != 0 && (stamp.validity & kIncomplete) == 0) count(incomplete_);
    stamp.validity |= v.validity;
  }
  return at;
}

void FaultySource::admit(SampleLease&& sample) noexcept {
  count(accounts_.taken);
  Verdict v;
  if (!faults_.active().empty()) judge(sample, v);
  if (v.lost) return;

  EditBuffers* buffers = buffers_.load(std::memory_order_acquire);
  SampleSlot slot;
  const bool changes = v.stuck || v.edit_count > 0;
  // What is small and will wait does so in a slot of ours, where there is one.
  const bool moves =
      !changes && (v.delayed || v.shift.ns() > 0 || !waiting_.empty()) && sample->size_bytes == 0;
  if (changes || moves || v.keeps) slot = take_slot(buffers);
  if (changes && !slot) return lose(sample->stamp, accounts_.no_slot);
  if (v.keeps && !slot)  // the next one is repeated
    for (Fault* f : faults_.active())
      if (f->kept.same_as(sample)) f->kept.reset();

  const bool own = static_cast<bool>(slot);
  Stamp stamp = sample->stamp;
  const BenchTime at = restamp(stamp, v);
  std::uint64_t job = 0;
  if (own) {
    slot->stamp = stamp;
    job = change(sample, v, *buffers, std::move(slot));
  } else if (stamp != sample->stamp) {
    if (SampleSlot back = sample.take_back()) {
      back->stamp = stamp;
      sample = std::move(back);
    } else {                                          // the inner source keeps a lease, which it must not
      stamp.lost_before = sample->stamp.lost_before;  // the gap in the sequence says it, too
      if (stamp != sample->stamp) return lose(sample->stamp, accounts_.no_slot);
    }
  }
  last_at_ = at;
  waiting_.push_back({std::move(sample), at, job, own});
  own_waiting_ += own;
  accounts_.waiting.store(waiting_.size(), std::memory_order_relaxed);
}

HealthSnapshot FaultySource::health() const noexcept {
  const auto own = [](const std::atomic<std::uint64_t>& n) { return n.load(std::memory_order_relaxed); };
  HealthSnapshot h = inner_->health();
  h.connected = h.connected && !gone_.load(std::memory_order_relaxed);
  h.incomplete += own(incomplete_);
  h.lost += own(accounts_.dropped) + own(accounts_.disconnected);
  h.no_slot += own(accounts_.no_slot);
  h.reconnects += own(returns_);
  return h;
}

}  // namespace rigor

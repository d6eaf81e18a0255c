#include "sensor-hal/channel/pair_monitor.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "sensor-hal/channel/event_text.h"

namespace rigor {

using pair_watch::PairWatchSnapshot;
using pair_watch::WatchState;

static_assert(std::is_trivially_copyable_v<PairWindow>, "it travels as the bytes of a sample");

namespace {
constexpr std::size_t kNotes = 64;
}

PairMonitor::PairMonitor(pair_watch::PairWatch watch)
    : fresh_(std::move(watch)), watch_(fresh_), pool_(make_sample_pool(kNotes, sizeof(PairWindow))) {
  kept_.reserve(kKept);
  notes_.emplace(kNotes);
}

void PairMonitor::start(BenchTime t0) {
  const std::lock_guard lock(mutex_);
  watch_ = fresh_;
  t0_ = t_newest_ = t0;
  kept_.clear();
  newest_ = {};
  stride_ = 1;
  text_.clear();
  unreported_ = sequence_ = compared_ = unlike_ = 0;
  count_ = mean_ = m2_ = 0;
  for (SampleLease old; notes_->try_pop(old);) old.reset();
}

void PairMonitor::add(const Sample& real, const Sample& simulated,
                      const std::optional<Difference>& difference) {
  const std::lock_guard lock(mutex_);
  const WatchState state = watch_.watch().state();
  const std::uint64_t windows = watch_.watch().windows(), compared = watch_.compared(),
                      unlike = watch_.unlike();
  watch_.add(real, simulated);
  t_newest_ = real.stamp.t_capture;
  // The pair that ends a window is the first of the next one.
  if (watch_.watch().windows() != windows) window_ended(state, compared, unlike);
  if (!difference || difference->count == 0) return;
  const double n = static_cast<double>(difference->count), all = count_ + n;
  const double delta = difference->bias - mean_;
  mean_ += delta * n / all;
  m2_ += difference->sigma * difference->sigma * n + delta * delta * count_ * n / all;
  count_ = all;
}

void PairMonitor::window_ended(WatchState before, std::uint64_t compared, std::uint64_t unlike) {
  const PairWatchSnapshot now = watch_.snapshot();
  PairWindow w;
  w.t_start = now.t_last;
  w.t_end = now.t_last + watch_.window();
  w.state = now.state;
  w.parameters = now.parameters;
  w.learned = now.learned, w.baseline = now.baseline_windows;
  w.number = now.windows - 1;
  w.compared = compared - compared_, w.unlike = unlike - unlike_;
  compared_ = compared, unlike_ = unlike;
  w.difference = {static_cast<std::uint64_t>(count_), mean_, count_ > 0 ? std::sqrt(m2_ / count_) : 0};
  count_ = mean_ = m2_ = 0;
  w.estimate = now.last;
  w.level = now.level;
  keep(w);
  note(kEventPairWindow, 0, w.t_end, {}, &w);
  if (before == WatchState::learning && now.state != WatchState::learning)
    note(kEventPairWatching, 0, w.t_end,
         "the baseline of " + std::to_string(w.baseline) + " windows is complete: changes are watched for",
         nullptr);
  if (before != WatchState::alarm && now.state == WatchState::alarm) {
    text_ = text_of(watch_, now, t0_);
    note(kEventPairAlarm, now.alarm.change, w.t_end, text_, nullptr);
  }
}

void PairMonitor::keep(const PairWindow& window) {
  newest_ = window;
  if (window.number % stride_ != 0) return;
  if (kept_.size() == kKept) {
    stride_ *= 2;
    std::erase_if(kept_, [&](const PairWindow& w) { return w.number % stride_ != 0; });
    if (window.number % stride_ != 0) return;
  }
  kept_.push_back(window);
}

void PairMonitor::note(std::uint32_t code, double value, BenchTime t, const std::string& text,
                       const PairWindow* window) {
  SampleSlot slot = pool_->try_acquire();
  if (!slot) {
    ++unreported_;
    return;
  }
  Sample& sample = *slot;
  sample.stamp = Stamp{};
  sample.stamp.sequence = sequence_++;
  sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = t;
  EventInfo info;
  info.code = code;
  info.value = value;
  EventText(info).add(text);
  sample.info = info;
  sample.size_bytes = window ? sizeof *window : 0;
  if (window) std::memcpy(sample.memory().data(), window, sizeof *window);
  if (!notes_->try_push(std::move(slot))) ++unreported_;
}

SampleLease PairMonitor::take() noexcept {
  SampleLease lease;
  (void)notes_->try_pop(lease);
  return lease;
}

PairMonitor::Status PairMonitor::status() const {
  const std::lock_guard lock(mutex_);
  return {watch_.snapshot(), text_, t0_, unreported_};
}

std::vector<PairWindow> PairMonitor::windows() const {
  const std::lock_guard lock(mutex_);
  std::vector<PairWindow> all = kept_;
  if (!all.empty() && all.back().number != newest_.number) all.push_back(newest_);
  return all;
}

std::vector<pair_watch::ParameterState> PairMonitor::baseline() const {
  const std::lock_guard lock(mutex_);
  std::vector<pair_watch::ParameterState> all;
  for (std::size_t i = 0; i < watch_.parameters().size(); ++i)
    all.push_back(watch_.watch().parameter_state(i));
  return all;
}

rigor::Status PairMonitor::acknowledge() {
  const std::lock_guard lock(mutex_);
  if (watch_.watch().state() != WatchState::alarm)
    return fail(ErrorCode::wrong_state, "acknowledge", "expected an alarm of this pair, there is none");
  watch_.acknowledge();
  note(kEventPairOrder, 0, t_newest_, "the alarm is acknowledged", nullptr);
  return {};
}

void PairMonitor::learn_again() {
  const std::lock_guard lock(mutex_);
  watch_.learn_again();
  note(kEventPairOrder, 1, t_newest_, "learning again: what is now is taken as normal", nullptr);
}

}  // namespace rigor

#include "rt-core/executive.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "rt-core/realtime_scope.h"
#include "rt-core/trace.h"

namespace rigor {
namespace {

using std::string;

// A stop request is seen within this time, however long the period is.
constexpr std::int64_t kSleepSlice_ns = 20'000'000;
// Events of a trace, 32 bytes each: 64 MiB.
constexpr std::size_t kMostTraced = std::size_t{1} << 21;
constexpr Duration kLongestPeriod = seconds(3600);
constexpr Duration kShortestPeriod = microseconds(10);

/// What the kernel counts for a thread.
struct Usage {
  std::int64_t cpu_ns = 0;
  long minor = 0, major = 0, voluntary = 0, preempted = 0;

  static Usage now() noexcept {
    rusage r{};
    getrusage(RUSAGE_THREAD, &r);
    return {(r.ru_utime.tv_sec + r.ru_stime.tv_sec) * 1'000'000'000 +
                (r.ru_utime.tv_usec + r.ru_stime.tv_usec) * 1'000,
            r.ru_minflt, r.ru_majflt, r.ru_nvcsw, r.ru_nivcsw};
  }
};

inline void relax() noexcept {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

/// Sleeps to the absolute instant `t_ns` of CLOCK_MONOTONIC, or less when a signal comes.
void sleep_until(std::int64_t t_ns) noexcept {
  const timespec at{t_ns / 1'000'000'000, t_ns % 1'000'000'000};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
}

// One writer: a plain load and store is cheaper than an atomic addition.
template <class T>
void bump(std::atomic<T>& counter, T by = 1) noexcept {
  counter.store(counter.load(std::memory_order_relaxed) + by, std::memory_order_relaxed);
}

string quoted_list(const std::vector<string>& names, const char* separator) {
  string text;
  for (const string& n : names) {
    if (!text.empty()) text += separator;
    text.append("`").append(n).append("`");
  }
  return text;
}

}  // namespace

/// Everything that a run writes, taken at arm.
struct Executive::LoopData {
  RunSummary summary;
  std::unique_ptr<MissObserver> observer;
  TraceThread* trace = nullptr;
  TraceName trace_wake = 0;
  std::uint32_t longest_step = 0;
  std::int64_t longest_step_ns = 0;
};

Executive::Executive(ExecutiveConfig config) : config_(std::move(config)) {}
Executive::~Executive() = default;

Status Executive::add_step(StepConfig config, Step& step) {
  if (state() != State::configuring)
    return fail(ErrorCode::wrong_state, config.name,
                "steps are added before arm; the executive is armed already: call disarm() first");
  if (config.name.empty()) return fail(ErrorCode::bad_input, "", "a step needs a name");
  if (config.divisor == 0 || config.phase >= config.divisor)
    return fail(ErrorCode::bad_input, config.name,
                "expected a divisor of at least 1 and a phase below it, got divisor " +
                    std::to_string(config.divisor) + " and phase " + std::to_string(config.phase));
  for (const Entry& e : entries_)
    if (e.config.name == config.name)
      return fail(ErrorCode::bad_input, config.name, "two steps have this name; each name may be used once");
  entries_.push_back({std::move(config), &step});
  return {};
}

// Kahn's algorithm; among the steps that are free the one added first goes first, so the order is the same
// each time.
Status Executive::sort_steps() {
  const std::size_t n = entries_.size();
  std::vector<std::vector<std::size_t>> users(n);
  std::vector<std::size_t> waits(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    for (const string& name : entries_[i].config.after) {
      const auto it = std::find_if(entries_.begin(), entries_.end(),
                                   [&](const Entry& e) { return e.config.name == name; });
      if (it == entries_.end())
        return fail(ErrorCode::bad_input, entries_[i].config.name,
                    "expected the name of a step in `after`, got `" + name + "`, which no step has");
      users[static_cast<std::size_t>(it - entries_.begin())].push_back(i);
      ++waits[i];
    }
  }
  order_.clear();
  std::vector<bool> done(n, false);
  while (order_.size() < n) {
    std::size_t next = n;
    for (std::size_t i = 0; i < n && next == n; ++i)
      if (!done[i] && waits[i] == 0) next = i;
    if (next == n) break;
    done[next] = true;
    order_.push_back(next);
    for (const std::size_t user : users[next]) --waits[user];
  }
  if (order_.size() == n) return {};
  // Every step that is left waits for another that is left: walking back along `after` must come round.
  std::size_t at = 0;
  while (done[at]) ++at;
  std::vector<std::size_t> path;
  while (std::find(path.begin(), path.end(), at) == path.end()) {
    path.push_back(at);
    for (std::size_t i = 0; i < n; ++i) {
      const auto& after = entries_[path.back()].config.after;
      if (!done[i] && std::find(after.begin(), after.end(), entries_[i].config.name) != after.end()) at = i;
    }
  }
  std::vector<string> circle;
  for (auto it = std::find(path.begin(), path.end(), at); it != path.end(); ++it)
    circle.push_back(entries_[*it].config.name);
  circle.push_back(entries_[at].config.name);
  order_.clear();
  return fail(ErrorCode::bad_input, circle.front(),
              "steps wait for each other in a circle: " + quoted_list(circle, " after ") +
                  "; take one name out of an `after`");
}

Status Executive::arm() {
  if (state() != State::configuring)
    return fail(ErrorCode::wrong_state, "", "arm() comes once, after the steps were added and before run()");
  if (config_.period < kShortestPeriod || config_.period > kLongestPeriod)
    return fail(ErrorCode::bad_input, "period",
                "expected 10 us to 3600 s, got " + std::to_string(config_.period.ns()) + " ns");
  if (config_.spin.ns() < 0 || config_.report_late.ns() < 0)
    return fail(ErrorCode::bad_input, "spin", "expected times of at least 0");
  if (Status sorted = sort_steps(); !sorted) return sorted;

  auto data = std::make_unique<LoopData>();
  if (config_.trace) {
    // A span for each step and the wake-up, in every cycle.
    const std::size_t each = 2 * entries_.size() + 1;
    const std::uint64_t most = kMostTraced / each;
    const std::uint64_t cycles = config_.cycles > 0 ? std::min(config_.cycles, most) : most;
    data->trace = &config_.trace->thread("loop", static_cast<std::size_t>(cycles) * each);
    data->trace_wake = config_.trace->name("wake-up error [us]");
  }
  slots_.clear();
  for (const std::size_t i : order_) {
    const Entry& e = entries_[i];
    slots_.push_back({e.step, e.config.divisor, e.config.phase,
                      config_.trace ? config_.trace->name(e.config.name) : TraceName{0}});
    data->summary.steps.push_back({e.config.name, 0, {}});
  }
  data_ = std::move(data);
  realtime_.prepare_process(config_.realtime);
  state_.store(State::armed, std::memory_order_release);
  return {};
}

Status Executive::disarm() {
  if (state() != State::armed)
    return fail(ErrorCode::wrong_state, "", "disarm() comes after arm(), when no run is in progress");
  realtime_.restore_process();
  data_.reset();
  slots_.clear();
  state_.store(State::configuring, std::memory_order_release);
  return {};
}

std::vector<string> Executive::order() const {
  std::vector<string> names;
  for (const std::size_t i : order_) names.push_back(entries_[i].config.name);
  return names;
}

Status Executive::prepare_run() {
  State armed = State::armed;
  if (!state_.compare_exchange_strong(armed, State::running))
    return fail(ErrorCode::wrong_state, "", "run() comes after arm(), and one run at a time");

  LoopData& data = *data_;
  RunSummary& s = data.summary;
  {  // A second run after the same arm starts from zero.
    std::vector<StepTiming> steps;
    for (const StepTiming& step : s.steps) steps.push_back({step.name, 0, {}});
    s = RunSummary{};
    s.steps = std::move(steps);
  }
  s.period = config_.period;
  failed_.store(StopReason::none, std::memory_order_relaxed);
  for (auto* c :
       {&counters_.cycle, &counters_.run, &counters_.skipped, &counters_.overruns, &counters_.misses})
    c->store(0);
  data.observer = std::make_unique<MissObserver>(config_.period, config_.miss_capacity);
  if (config_.heartbeat) config_.heartbeat->restart(config_.clock == RunClock::virtual_time);
  return {};
}

RunSummary Executive::close_run() {
  RunSummary& s = data_->summary;
  if (config_.heartbeat) config_.heartbeat->declare_stopped(s.reason);
  s.misses = data_->observer->finish();
  data_->observer.reset();
  s.settings = realtime_.settings();
  state_.store(State::armed, std::memory_order_release);
  return s;
}

void Executive::give_up() noexcept {
  if (config_.heartbeat) config_.heartbeat->declare_stopped(StopReason::failed);
  data_->observer.reset();
  state_.store(State::armed, std::memory_order_release);
}

Result<RunSummary> Executive::run(StopToken stop, BenchTime t0) {
  return run(stop, [&]() -> Result<BenchTime> {
    if (const BenchTime now = bench_now(); config_.clock == RunClock::wall && now > t0)
      return fail(ErrorCode::bad_input, "t0",
                  "the first cycle was to begin " + std::to_string((now - t0).ns() / 1000) +
                      " us ago; choose a later start (setting up the thread takes some ms)");
    return t0;
  });
}

Result<RunSummary> Executive::run(StopToken stop, const Begin& begin_run) {
  if (config_.clock == RunClock::virtual_time) {
    if (auto s = begin(begin_run); !s) return tl::unexpected<Error>(s.error());
    (void)advance(std::numeric_limits<std::uint64_t>::max(), stop);
    return end();
  }
  if (auto s = prepare_run(); !s) return tl::unexpected<Error>(s.error());
  LoopData& data = *data_;
  data.observer->start(gettid());  // before this thread becomes special: the observer inherits nothing
  realtime_.prepare_thread(config_.realtime);
  try {
    const Result<BenchTime> t0 = begin_run();
    if (!t0) {
      realtime_.restore_thread();
      give_up();
      return tl::unexpected<Error>(t0.error());
    }
    data.summary.t0 = *t0;
  } catch (...) {
    realtime_.restore_thread();
    give_up();
    throw;
  }
  loop_wall(stop, data);
  realtime_.restore_thread();
  return close_run();
}

Status Executive::begin(const Begin& begin_run) {
  if (config_.clock != RunClock::virtual_time)
    return fail(ErrorCode::wrong_state, "", "cycles are run one by one in virtual time alone");
  if (auto s = prepare_run(); !s) return s;
  try {
    const Result<BenchTime> t0 = begin_run();
    if (!t0) {
      give_up();
      return tl::unexpected<Error>(t0.error());
    }
    data_->summary.t0 = *t0;
  } catch (...) {
    give_up();
    throw;
  }
  return {};
}

RunSummary Executive::end() {
  RunSummary& s = data_->summary;
  if (s.reason == StopReason::none) s.reason = StopReason::requested;
  return close_run();
}

void Executive::run_steps(const CycleContext& cycle, LoopData& data) noexcept {
  if (config_.hooks) config_.hooks->cycle_begin(cycle);
  data.longest_step_ns = 0;
  std::int64_t began = monotonic_now().ns();
  for (std::size_t i = 0; i < slots_.size(); ++i) {
    const Slot& slot = slots_[i];
    if (slot.divisor != 1 && cycle.index % slot.divisor != slot.phase) continue;
    slot.step->run(cycle);
    const std::int64_t ended = monotonic_now().ns();
    const std::int64_t ran = ended - began;
    StepTiming& timing = data.summary.steps[i];
    ++timing.runs;
    timing.ran.record(Duration(ran));
    if (ran > data.longest_step_ns) {
      data.longest_step_ns = ran;
      data.longest_step = static_cast<std::uint32_t>(i);
    }
    if (data.trace) {
      data.trace->begin_at(slot.trace_name, began);
      data.trace->end_at(slot.trace_name, ended);
    }
    began = ended;
  }
  if (config_.hooks) config_.hooks->cycle_end(cycle);
}

void Executive::loop_wall(StopToken stop, LoopData& data) noexcept {
  RunSummary& s = data.summary;
  const Period period = config_.period;
  const std::int64_t spin = config_.spin.ns();
  const std::int64_t t0 = s.t0.ns();
  const std::int64_t report_late = config_.report_late.ns() > 0 ? config_.report_late.ns() : period.ns() / 2;
  const auto grid = [&](std::uint64_t k) { return t0 + (period * static_cast<std::int64_t>(k)).ns(); };
  const std::uint64_t last =
      config_.cycles > 0 ? config_.cycles : std::numeric_limits<std::uint64_t>::max() / 2;
  const OverrunPolicy policy = config_.on_overrun;

  const RealtimeScope scope;
  Usage usage = Usage::now();
  const Usage first_usage = usage;
  std::uint64_t k = 0;
  std::int64_t last_end = 0;
  bool behind = false;  // policy `log`: a late cycle follows without a pause

  const auto stop_now = [&] {
    s.reason = failed_.load(std::memory_order_acquire);
    if (s.reason == StopReason::none) s.reason = stop.reason();
    return s.reason != StopReason::none;
  };

  while (!stop_now()) {
    if (k >= last) {
      s.reason = StopReason::finished;
      break;
    }
    const std::int64_t t_k = grid(k);

    // Sleep to shortly before the grid point, spin the rest.
    std::int64_t now = monotonic_now().ns();
    if (s.cycles_run > 0) s.bookkeeping.record(Duration(now - last_end));
    std::int64_t spun = 0;
    {
      bool stopped = false;
      while (now < t_k - spin && !stopped) {
        const std::int64_t until = std::min(t_k - spin, now + kSleepSlice_ns);
        {
          const RealtimeSleep sleep(scope);
          sleep_until(until);
        }
        now = monotonic_now().ns();
        if (until < t_k - spin || now < until) stopped = stop_now();
      }
      if (stopped) break;
      const std::int64_t spin_from = now;
      while (now < t_k) {
        relax();
        now = monotonic_now().ns();
      }
      spun = now - spin_from;
    }

    const std::int64_t woke = now;
    const std::int64_t late = woke - t_k;
    if (!behind) {
      s.wake_error.record(Duration(late));
      counters_.last_wake_error_ns.store(late, std::memory_order_relaxed);
    }
    Miss miss;
    miss.cycle = k;
    miss.t_cycle = BenchTime(t_k);
    bool overran = false;
    bool abort_now = false;
    if (woke >= grid(k + 1)) {
      overran = true;
      if (policy == OverrunPolicy::abort) {
        abort_now = true;
      } else if (policy == OverrunPolicy::skip) {
        // The cycle of the present interval runs; those whose interval has passed do not.
        const std::uint64_t behind_by =
            std::min(static_cast<std::uint64_t>(Duration(woke - t0) / period) - k, last - 1 - k);
        miss.skipped += behind_by;
        k += behind_by;
      }
    }

    std::int64_t end = woke;
    if (!abort_now) {
      CycleContext cycle;
      cycle.index = k;
      cycle.t = BenchTime(grid(k));
      cycle.t_next = BenchTime(grid(k + 1));
      run_steps(cycle, data);
      end = monotonic_now().ns();
      ++s.cycles_run;
      s.cycle_time.record(Duration(end - woke));
      if (end > cycle.t_next.ns()) overran = true;
      if (in_charge()) config_.heartbeat->beat(BenchTime(end));
      if (data.trace) {
        data.trace->counter_at(data.trace_wake, woke, static_cast<double>(late) * 1e-3);
      }
      ++k;
    }
    const bool was_behind = behind;
    behind = false;
    if (overran && policy == OverrunPolicy::abort) {
      s.reason = StopReason::overrun;
    } else if (overran && policy == OverrunPolicy::skip) {
      // Continue on the first grid point that has not passed.
      const auto next = static_cast<std::uint64_t>(period.first_index_from(Duration(end - t0)));
      const std::uint64_t wanted = std::min(std::max(k, next), last);
      miss.skipped += wanted - k;
      k = wanted;
    } else if (policy == OverrunPolicy::log) {
      behind = end > grid(k);
    }
    s.cycles_skipped += miss.skipped;

    const Usage after = Usage::now();
    if (overran) ++s.overruns;
    if (late > report_late && !was_behind) ++s.late_wakeups;
    // While catching up, only a cycle that is too long by itself is another miss.
    if ((overran && (!was_behind || end - woke > period.ns())) || (late > report_late && !was_behind)) {
      miss.t_woke = BenchTime(woke);
      miss.t_end = BenchTime(end);
      miss.late = Duration(late);
      miss.ran = Duration(end - woke);
      miss.cpu = Duration(std::clamp<std::int64_t>(after.cpu_ns - usage.cpu_ns - spun, 0, end - woke));
      miss.overran = overran;
      miss.minor_faults = static_cast<std::uint32_t>(after.minor - usage.minor);
      miss.major_faults = static_cast<std::uint32_t>(after.major - usage.major);
      miss.voluntary_switches = static_cast<std::uint32_t>(after.voluntary - usage.voluntary);
      miss.preempted = static_cast<std::uint32_t>(after.preempted - usage.preempted);
      miss.longest_step = data.longest_step;
      miss.longest_step_ran = Duration(data.longest_step_ns);
      data.observer->report(miss);
      bump(counters_.misses);
    }
    usage = after;
    last_end = end;
    counters_.cycle.store(k, std::memory_order_relaxed);
    counters_.run.store(s.cycles_run, std::memory_order_relaxed);
    counters_.skipped.store(s.cycles_skipped, std::memory_order_relaxed);
    counters_.overruns.store(s.overruns, std::memory_order_relaxed);
    counters_.last_cycle_ns.store(end - woke, std::memory_order_relaxed);
    if (s.reason != StopReason::none) break;
  }
  s.minor_faults = static_cast<std::uint64_t>(usage.minor - first_usage.minor);
  s.major_faults = static_cast<std::uint64_t>(usage.major - first_usage.major);
}

bool Executive::advance(std::uint64_t cycles, StopToken stop) {
  if (state() != State::running) return false;
  LoopData& data = *data_;
  RunSummary& s = data.summary;
  const std::uint64_t last =
      config_.cycles > 0 ? config_.cycles : std::numeric_limits<std::uint64_t>::max() / 2;
  for (std::uint64_t n = 0;; ++n) {
    const std::uint64_t k = s.cycles_run;
    s.reason = failed_.load(std::memory_order_acquire);
    if (s.reason == StopReason::none) s.reason = stop.reason();
    if (s.reason == StopReason::none && k >= last) s.reason = StopReason::finished;
    if (s.reason != StopReason::none) return false;
    if (n == cycles) return true;
    CycleContext cycle;
    cycle.index = k;
    cycle.t = s.t0 + config_.period * static_cast<std::int64_t>(k);
    cycle.t_next = s.t0 + config_.period * static_cast<std::int64_t>(k + 1);
    cycle.virtual_time = true;
    try {
      if (config_.hooks) config_.hooks->before_cycle(cycle.t);
    } catch (...) {
      give_up();
      throw;
    }
    const std::int64_t began = monotonic_now().ns();
    {
      const RealtimeScope scope;
      run_steps(cycle, data);
    }
    const std::int64_t ran = monotonic_now().ns() - began;
    ++s.cycles_run;
    s.cycle_time.record(Duration(ran));
    if (in_charge()) config_.heartbeat->beat(cycle.t);
    counters_.cycle.store(k + 1, std::memory_order_relaxed);
    counters_.run.store(s.cycles_run, std::memory_order_relaxed);
    counters_.last_cycle_ns.store(ran, std::memory_order_relaxed);
  }
}

}  // namespace rigor

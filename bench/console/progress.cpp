#include "bench/console/progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <limits>
#include <mutex>
#include <nlohmann/json.hpp>
#include <system_error>
#include <thread>

#include "bench/console/terminal.h"

namespace rigor {
namespace {

constexpr double kNotKnown = std::numeric_limits<double>::quiet_NaN();
constexpr Duration kWindow = seconds(20), kApart = milliseconds(500);
constexpr std::size_t kFewest = 3;  ///< of what the meter keeps: two steps
/// Work that takes less is not shown.
constexpr Duration kSilent = seconds(2);
/// JSON lines, and rewritten ones, are so far apart; lines off a terminal a tenth of the task and at least
/// kPlain, or kSeldom.
constexpr Duration kOften = milliseconds(200), kPlain = seconds(5), kSeldom = seconds(30);

/// At most `columns` characters, each of which may be several bytes.
std::string cut_to(std::string text, std::size_t columns) {
  std::size_t characters = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if ((static_cast<unsigned char>(text[i]) & 0xC0U) == 0x80) continue;
    if (++characters <= columns) continue;
    text.resize(i);
    break;
  }
  return text;
}

}  // namespace

std::string text_of_span(double span_s) {
  const auto s = std::llround(std::clamp(span_s, 0.0, 1e12));
  if (s < 60) return fmt::format("{} s", s);
  if (s < 3600) return fmt::format("{} min {} s", s / 60, s % 60);
  if (s < 86400) return fmt::format("{} h {} min", s / 3600, s % 3600 / 60);
  return fmt::format("{} d {} h", s / 86400, s % 86400 / 3600);
}

// ---------------------------------------------------------------- ProgressMeter

void ProgressMeter::take(MonotonicTime now, double done) {
  const bool further = done > last_.done;
  last_ = {now, further ? done : last_.done};
  if (further && now - kept_.back().t >= kApart) kept_.push_back(last_);
  while (kept_.size() > kFewest && now - kept_[1].t > kWindow) kept_.pop_front();
}

double ProgressMeter::speed() const {
  const Duration over = last_.t - kept_.front().t;
  if (over < kApart) return kNotKnown;
  return (last_.done - kept_.front().done) / over.seconds();
}

double ProgressMeter::eta_s(double total) const {
  const double left = total - last_.done;
  if (!(total > 0)) return kNotKnown;
  if (left <= 0) return 0;
  const double v = speed();
  return v > 0 ? left / v : kNotKnown;
}

// ---------------------------------------------------------------- ProgressDisplay

std::string ProgressDisplay::json(const std::string& note) const {
  const Task& task = tasks_.back();
  const auto known = [](double x) { return std::isfinite(x) ? nlohmann::json(x) : nlohmann::json(); };
  const bool share = task.total > 0;
  const nlohmann::json object{{"task", task.name},
                              {"done", task.meter.done()},
                              {"total", share ? known(task.total) : nlohmann::json()},
                              {"unit", task.unit},
                              {"fraction", share ? known(task.meter.done() / task.total) : nlohmann::json()},
                              {"eta_s", known(task.meter.eta_s(task.total))},
                              {"speed", known(task.meter.speed())},
                              {"note", note}};
  return object.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

std::string ProgressDisplay::line(const std::string& note, MonotonicTime now) const {
  const Task& task = tasks_.back();
  const bool time = task.unit == "s";
  const double done = task.meter.done(), speed = task.meter.speed(), eta_s = task.meter.eta_s(task.total);
  std::string text;
  for (const Task& t : tasks_) text += (text.empty() ? "" : ": ") + t.name;
  if (task.total > 0) text += fmt::format("  {:.0f} %", std::floor(100 * done / task.total));
  const int digits = time ? 1 : 0;
  if (!task.unit.empty() && task.total > 0)
    text += fmt::format("  {:.{}f} of {:.{}f} {}", done, digits, task.total, digits, task.unit);
  else if (!task.unit.empty() && done > 0)
    text += fmt::format("  {:.{}f} {}", done, digits, task.unit);
  else if (!(task.total > 0))
    text += "  for " + text_of_span((now - task.begin).seconds());
  if (time && std::isfinite(speed)) text += fmt::format("  {:.3g} x real time", speed);
  if (std::isfinite(eta_s)) text += fmt::format("  {} left", text_of_span(eta_s));
  if (!note.empty()) text += "  " + note;
  return text;
}

ProgressDisplay::Output ProgressDisplay::begin(std::string name, double total, std::string unit,
                                               MonotonicTime now) {
  if (tasks_.empty()) shown_ = now;
  tasks_.push_back({std::move(name), std::move(unit), total, now, ProgressMeter(now)});
  if (format_ != ProgressFormat::json) return {};
  shown_ = now;
  return {json("")};
}

ProgressDisplay::Output ProgressDisplay::update(double done, const std::string& note, MonotonicTime now,
                                                std::size_t columns) {
  if (tasks_.empty() || format_ == ProgressFormat::none) return {};
  Task& task = tasks_.back();
  if (!std::isfinite(done)) done = 0;
  task.meter.take(now, task.total > 0 ? std::min(done, task.total) : done);
  if (format_ == ProgressFormat::json) {
    if (now - shown_ < kOften) return {};
    shown_ = now;
    return {json(note)};
  }
  if (terminal_) {
    if (now - tasks_.front().begin < kSilent || now - shown_ < kOften) return {};
    shown_ = now;
    return {cut_to(line(note, now), std::max<std::size_t>(columns, 20) - 1), true};
  }
  const double fraction = task.total > 0 ? task.meter.done() / task.total : 0;
  const bool tenth = fraction - task.shown_fraction >= 0.1 && now - shown_ >= kPlain;
  if (!tenth && now - shown_ < kSeldom) return {};
  shown_ = now;
  task.shown_fraction = fraction;
  return {line(note, now) + "\n"};
}

ProgressDisplay::Output ProgressDisplay::end(double done, const std::string& note, bool whole,
                                             MonotonicTime now) {
  if (tasks_.empty()) return {};
  Output out;
  Task& task = tasks_.back();
  if (format_ == ProgressFormat::json) {
    if (whole && task.total > 0) done = task.total;
    task.meter.take(now, task.total > 0 ? std::min(done, task.total) : done);
    out.text = json(note);
    shown_ = now;
  }
  tasks_.pop_back();
  out.rewritten = format_ == ProgressFormat::line && terminal_ && tasks_.empty();
  return out;
}

// ---------------------------------------------------------------- the process's display

struct ProgressTask::State {
  std::atomic<double> done{0};
  std::string note;
  std::function<double()> follow;
  std::function<std::string()> follow_note;

  [[nodiscard]] double now() const { return follow ? follow() : done.load(std::memory_order_relaxed); }
  [[nodiscard]] std::string text() const { return follow_note ? follow_note() : note; }
};

namespace {

ProgressFormat g_format = ProgressFormat::none;

std::size_t terminal_columns() {
  winsize size{};
  return ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

/// One for the process, as there is one stderr. Its mutex is held while tasks begin and end and while they
/// are shown, so that nothing that a task follows is read after its end.
template <class State>
class Console {
 public:
  static Console& get() {
    static auto* const console = new Console;  // for as long as any thread may write
    return *console;
  }
  void begin(State& state, std::string name, double total, std::string unit) {
    const std::lock_guard lock(mutex_);
    if (display_.idle()) display_ = ProgressDisplay(g_format, ::isatty(STDERR_FILENO) == 1);
    write(display_.begin(std::move(name), total, std::move(unit), monotonic_now()));
    tasks_.push_back(&state);
    if (tasks_.size() > 1 || g_format == ProgressFormat::none) return;
    stop_ = false;
    try {
      thread_ = std::thread([this] { show(); });
    } catch (const std::system_error&) {
      // The work itself matters more than what is said of it.
    }
  }
  void end(State& state, bool whole) {
    std::thread last;
    {
      const std::lock_guard lock(mutex_);
      if (std::find(tasks_.begin(), tasks_.end(), &state) == tasks_.end()) return;
      // Tasks within it end with it.
      for (bool ended = false; !ended && !tasks_.empty();) {
        State& inner = *tasks_.back();
        ended = &inner == &state;
        tasks_.pop_back();
        write(display_.end(inner.now(), inner.text(), whole && ended, monotonic_now()));
      }
      if (tasks_.empty()) {
        stop_ = true;
        last = std::move(thread_);
      }
    }
    wake_.notify_all();
    if (last.joinable()) last.join();
  }
  std::mutex& mutex() { return mutex_; }

 private:
  void show() {
    std::unique_lock lock(mutex_);
    while (!wake_.wait_for(lock, std::chrono::milliseconds(100), [this] { return stop_; }))
      if (!tasks_.empty())
        write(display_.update(tasks_.back()->now(), tasks_.back()->text(), monotonic_now(),
                              terminal_columns()));
  }
  static void write(const ProgressDisplay::Output& out) {
    if (out.rewritten)
      rewrite_line(out.text);
    else if (!out.text.empty())
      write_stderr(out.text);
  }

  std::mutex mutex_;
  std::condition_variable wake_;
  ProgressDisplay display_{ProgressFormat::none, false};
  std::vector<State*> tasks_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace

void set_progress_format(ProgressFormat format) { g_format = format; }

ProgressTask::ProgressTask(std::string name, double total, std::string unit)
    : state_(std::make_unique<State>()) {
  Console<State>::get().begin(*state_, std::move(name), total, std::move(unit));
}
ProgressTask::~ProgressTask() { end(false); }

void ProgressTask::set(double done) noexcept {
  if (state_) state_->done.store(done, std::memory_order_relaxed);
}
void ProgressTask::note(std::string text) {
  const std::lock_guard lock(Console<State>::get().mutex());
  if (state_) state_->note = std::move(text);
}
void ProgressTask::follow(std::function<double()> done, std::function<std::string()> note) {
  const std::lock_guard lock(Console<State>::get().mutex());
  if (!state_) return;
  state_->follow = std::move(done);
  state_->follow_note = std::move(note);
}
void ProgressTask::finish() { end(true); }
void ProgressTask::end(bool whole) {
  if (!state_) return;
  Console<State>::get().end(*state_, whole);
  state_.reset();
}

}  // namespace rigor

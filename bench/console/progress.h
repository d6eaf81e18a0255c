// How far a command has come: one line that is rewritten on a terminal, a line now and then elsewhere, one
// JSON object a line with `--progress json`. All of it goes to stderr; work below two seconds is not shown.
//
//   const ProgressTask start("start");                    // how long it takes is not known
//   ProgressTask run("run", 50.0, "s");                   // 50 s of bench time
//   run.follow([&] { return counters.cycle.load() * period_s; });   // read a few times a second, by a thread
//   of its own … run.finish();                                         // without it, the last line says how
//   far it came
//
// Tasks may stand within others: the innermost is shown. Work that runs in real time stores an atomic that
// `follow` reads, and calls nothing here.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/time.h"

namespace rigor {

enum class ProgressFormat : std::uint8_t { line, json, none };
/// `--progress`. Before the first task; none until then.
void set_progress_format(ProgressFormat format);

/// One piece of work. Made and ended on one thread; `set` and `note` may be called by any other. The
/// display's thread lives as long as the outermost task.
class ProgressTask {
 public:
  /// `total` in `unit`: "s" is simulated or bench time, whose speed is shown as a multiple of real time; ""
  /// with a total of 1 is a share. A total of 0 is not known.
  explicit ProgressTask(std::string name, double total = 0, std::string unit = "");
  ~ProgressTask();
  ProgressTask(const ProgressTask&) = delete;
  ProgressTask& operator=(const ProgressTask&) = delete;

  void set(double done) noexcept;
  /// Stands behind the numbers: "12 boards found".
  void note(std::string text);
  /// In place of `set` and `note`: called by the display's thread until the task ends.
  void follow(std::function<double()> done, std::function<std::string()> note = {});
  /// All of it was done. Ends the task.
  void finish();

 private:
  void end(bool whole);
  struct State;
  std::unique_ptr<State> state_;
};

// ---------------------------------------------------------------- what the display says, without threads

/// The speed of a task and the time that it still takes, by what was done in the last 20 s (of work that
/// advances in larger steps, by the last two).
class ProgressMeter {
 public:
  explicit ProgressMeter(MonotonicTime begin) : last_{begin, 0}, kept_{last_} {}
  void take(MonotonicTime now, double done);
  [[nodiscard]] double done() const { return last_.done; }
  /// Units in a second; NaN: not known yet.
  [[nodiscard]] double speed() const;
  /// NaN: not known, or it stands still.
  [[nodiscard]] double eta_s(double total) const;

 private:
  struct At {
    MonotonicTime t;
    double done;
  };
  At last_;
  std::deque<At> kept_;  ///< half a second and more apart
};

/// What is to be written as tasks begin, go on and end; calls in the order of time.
class ProgressDisplay {
 public:
  struct Output {
    std::string text;
    bool rewritten = false;  ///< in place of the terminal's last line; empty: which is cleared
  };
  ProgressDisplay(ProgressFormat format, bool terminal) : format_(format), terminal_(terminal) {}
  [[nodiscard]] bool idle() const { return tasks_.empty(); }
  Output begin(std::string name, double total, std::string unit, MonotonicTime now);
  /// Of the innermost task. `columns`: of the terminal.
  Output update(double done, const std::string& note, MonotonicTime now, std::size_t columns = 80);
  /// Ends it. `whole`: its total is reached.
  Output end(double done, const std::string& note, bool whole, MonotonicTime now);

 private:
  struct Task {
    std::string name, unit;
    double total;
    MonotonicTime begin;
    ProgressMeter meter;
    double shown_fraction = 0;
  };
  [[nodiscard]] std::string json(const std::string& note) const;
  [[nodiscard]] std::string line(const std::string& note, MonotonicTime now) const;

  ProgressFormat format_;
  bool terminal_;
  std::vector<Task> tasks_;
  MonotonicTime shown_;  ///< last; the begin of the outermost task
};

/// "34 s", "1 min 34 s", "2 h 5 min", "3 d 4 h".
[[nodiscard]] std::string text_of_span(double span_s);

}  // namespace rigor

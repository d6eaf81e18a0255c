// How the commands speak: errors on stderr, results on stdout, a live line only where there is a terminal.
#pragma once

#include <string>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

/// Prints `rigor: message` (or `{"error": …}` on stdout with --json) and returns the exit status that belongs
/// to it.
int report_error(const Error& error, bool json);

/// A line that is rewritten in place on a terminal, and otherwise printed once a second as a plain line.
class LiveLine {
 public:
  LiveLine();
  ~LiveLine();
  void show(const std::string& text);
  /// Leaves the last line standing.
  void done();
  [[nodiscard]] bool terminal() const { return terminal_; }

 private:
  bool terminal_;
  bool open_ = false;
};

/// "12.3 ms", "450 µs", "1.20 s": three digits, the unit that fits.
[[nodiscard]] std::string text_of(Duration d);

}  // namespace rigor

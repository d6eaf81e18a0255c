// How the commands speak: errors on stderr, results on stdout (how far work has come: progress.h).
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <utility>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

/// Text for stderr. What cannot be written there (its terminal has gone away) is lost, and the work goes on.
void write_stderr(std::string_view text) noexcept;
/// On a terminal: a line in place of the one that was written so before; empty: that is cleared. What
/// write_stderr writes in between takes its place.
void rewrite_line(std::string_view text) noexcept;
/// First thing in main: streams that are closed get /dev/null, so that no file of ours takes their numbers,
/// and writing where nobody reads is an error, not a signal.
void prepare_streams();
/// Last thing in main: 1 and a sentence where stdout did not take what was printed, else `status`.
[[nodiscard]] int finish_stdout(int status);

/// Prints `rigor: message` (or `{"error": …}` on stdout with --json) and returns the exit status that belongs
/// to it.
int report_error(const Error& error, bool json);
/// JSON for stdout, indented. What devices and recordings say of themselves need not be UTF-8: such bytes
/// become U+FFFD.
std::string json_text(const nlohmann::json& json);

/// "12.3 ms", "450 µs", "1.20 s": three digits, the unit that fits.
[[nodiscard]] std::string text_of(Duration d);

}  // namespace rigor

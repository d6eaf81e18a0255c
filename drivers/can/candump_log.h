// Logs in the format of can-utils: what `candump -l` writes and `canplayer` reads.
//
//   (1436509052.249713) vcan0 044#2A366C2BBA        classic, 11-bit identifier: 3 digits
//   (1436509052.449847) vcan0 1F334455#R8           remote request for 8 bytes, 29-bit identifier: 8 digits
//   (1436509052.650004) vcan0 213##311223344        CAN FD: `##`, flags (1 BRS, 2 ESI, 4 FDF), data
//   (1436509053.850870) vcan0 20000004#0004000000000000   error frame: the class, with bit 29 set
//
// Source: can-utils, lib.c (parse_canframe, sprint_canframe) and candump.c. Read beyond that: `_` and a raw
// length code of 9 to 15 behind 8 data bytes or a remote length, nanoseconds (9 digits), a direction (` R`,
// ` T`) at the end, dots between data bytes. What was read is written again byte for byte, except for dots,
// lower case digits, spaces in excess and line ends of Windows.
//
// Parsing: any thread, no allocation but for the interface's name beyond 15 characters, which is refused.
#pragma once

#include <array>
#include <cstdio>
#include <filesystem>
#include <istream>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

struct LogEntry {
  RealtimeTime t;
  std::array<char, 16> interface {};  ///< NUL-terminated
  CanFrame frame;
  std::uint8_t fd_flags = 0;         ///< as in the log; BRS is in the frame, too
  std::uint8_t raw_length_code = 0;  ///< 9 to 15 of a classic frame of 8 bytes; 0: none
  char direction = 0;                ///< R or T; 0: not said
  bool nanoseconds = false;          ///< 9 digits instead of 6

  [[nodiscard]] std::string_view interface_name() const noexcept { return interface.data(); }
  void set_interface(std::string_view name) noexcept;
};

/// bad_input with `name:line:column`.
[[nodiscard]] Result<LogEntry> parse_log_line(std::string_view line, std::string_view name = "log",
                                              std::size_t line_number = 1);
/// Without the line end. The time is cut to microseconds unless the entry says nanoseconds.
[[nodiscard]] std::string format_log_line(const LogEntry& entry);
/// Into a buffer of at least kLogLineBytes; returns the length. No allocation.
inline constexpr std::size_t kLogLineBytes = 208;
std::size_t format_log_line(const LogEntry& entry, char* out) noexcept;

/// The frames of a log, one after the other, in memory that does not grow with it; empty lines and those that
/// begin with
/// `#` are passed over. One thread.
class LogReader {
 public:
  static constexpr std::size_t kMostLineBytes = 4096;
  /// `name` for messages.
  LogReader(std::unique_ptr<std::istream> in, std::string name)
      : in_(std::move(in)), name_(std::move(name)) {}
  /// not_found.
  [[nodiscard]] static Result<LogReader> open(const std::filesystem::path& file);
  /// The next frame, or none at the end. bad_input with `name:line:column`, also for a line beyond
  /// kMostLineBytes; io. Allocates for errors alone.
  [[nodiscard]] Result<std::optional<LogEntry>> next();
  /// From the first line again.
  void rewind();

 private:
  std::unique_ptr<std::istream> in_;
  std::string name_;
  std::array<char, kMostLineBytes> line_{};
  std::size_t number_ = 0;
};

/// Appends to a file, buffered. One thread.
class LogWriter {
 public:
  LogWriter() = default;
  LogWriter(LogWriter&&) noexcept = default;
  LogWriter& operator=(LogWriter&&) noexcept = default;
  /// Empties the file. not_writable.
  [[nodiscard]] Status open(const std::filesystem::path& file);
  void write(const LogEntry& entry) noexcept;
  void flush() noexcept;
  /// Everything is in the file, or disk_full or io.
  [[nodiscard]] Status close();
  [[nodiscard]] bool is_open() const noexcept { return file_ != nullptr; }

 private:
  struct Closer {
    void operator()(std::FILE* f) const noexcept { std::fclose(f); }
  };
  std::unique_ptr<std::FILE, Closer> file_;
  std::string path_;
  bool failed_ = false;
};

}  // namespace rigor::can

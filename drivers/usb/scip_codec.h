// SCIP 2.0, the language of Hokuyo's scanners, as bytes: both sides, no I/O.
//
//   host     MD0044072501000;a LF                       command, parameters, optional label after a semicolon
//   device   MD0044072501000;a LF 00P LF LF             echo, status, sum; then for each scan
//            MD0044072501000;a LF 99b LF tttts LF       echo (scans that remain), status, 24-bit ms, sum
//            64 characters, sum LF … the rest, sum LF LF
//
// Numbers are written 6 bits a character, each plus 0x30, most significant first. A sum is (the sum of the
// line's bytes & 0x3f) + 0x30; in lines of text it leaves the semicolon before it out. A reply ends with an
// empty line, and that is how a reader that lost its place finds it again.
//
// Sources: Hokuyo, "Communication Protocol Specification For SCIP2.0 Standard", C-42-03320B (sections 6–9),
// for ME and GE and the tolerance in sums of text Hokuyo's urg_library (urg_sensor.c), for the sums of text
// lines the examples in its wiki (VV, PP, II).
//
// Angles count in steps, anticlockwise seen from above; ranges are millimetres.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace rigor::usb {

inline constexpr std::uint32_t kScipClockModulus = 1u << 24;  ///< ms
inline constexpr std::size_t kScipBlock = 64;                 ///< characters of data in a line
inline constexpr std::size_t kScipLongestCommand = 64;
inline constexpr std::size_t kScipLongestLabel = 16;

[[nodiscard]] char scip_sum(std::string_view bytes) noexcept;
/// Appends `characters` (1 … 4) for the low 6 · `characters` bits of the value.
void scip_encode(std::uint32_t value, unsigned characters, std::string& out);
/// Empty where a character is outside 0x30 … 0x6f, or there are none or more than 4.
[[nodiscard]] std::optional<std::uint32_t> scip_decode(std::string_view characters) noexcept;

/// What a scanner says of itself by PP.
struct ScannerParameters {
  std::string model;                            ///< MODL
  std::uint32_t min_range_mm = 0;               ///< DMIN: smaller values are error codes
  std::uint32_t max_range_mm = 0;               ///< DMAX
  std::uint32_t steps_per_turn = 0;             ///< ARES
  std::uint32_t first_step = 0, last_step = 0;  ///< AMIN, AMAX
  std::uint32_t front_step = 0;                 ///< AFRT: the x axis of the sensor
  std::uint32_t rpm = 0;                        ///< SCAN
  [[nodiscard]] double turn_s() const { return 60.0 / rpm; }
  [[nodiscard]] double step_s() const { return turn_s() / steps_per_turn; }
  [[nodiscard]] double angle_rad(double step) const {
    return (step - front_step) * 6.283185307179586 / steps_per_turn;
  }
};
/// What it says of itself by VV.
struct ScannerIdentity {
  std::string vendor, product, firmware, protocol, serial;
};

/// MD, MS, ME (continuous) and GD, GS, GE (the latest scan).
struct ScanRequest {
  bool continuous = true;
  char values = 'D';  ///< D: 3 characters, S: 2 characters, E: 3 characters of range and 3 of intensity
  std::uint32_t first_step = 0, last_step = 0;
  std::uint32_t cluster = 1;   ///< steps that are merged into their smallest range; 0 means 1
  std::uint32_t interval = 0;  ///< continuous: scans left out between two (0 … 9)
  std::uint32_t scans = 0;     ///< continuous: how many (0: until QT); in a reply: that remain

  [[nodiscard]] std::uint32_t width() const { return cluster == 0 ? 1 : cluster; }
  [[nodiscard]] std::uint32_t count() const { return (last_step - first_step) / width() + 1; }
  [[nodiscard]] unsigned range_characters() const { return values == 'S' ? 2 : 3; }
  [[nodiscard]] unsigned value_characters() const { return values == 'E' ? 6 : range_characters(); }
  [[nodiscard]] std::string line() const;  ///< without label and line feed
  bool operator==(const ScanRequest&) const = default;
};

/// A command line taken apart. `status` is "00", or what the scanner answers to a line that it cannot use;
/// steps are checked against the scanner by whoever knows it.
struct ScipCommand {
  enum class Kind : std::uint8_t {
    version,
    parameters,
    state,
    laser_on,
    quit,
    reset,
    time_on,
    time_read,
    time_off,
    scan,
    motor_speed,
    bit_rate,
    sensitivity,
    switch_to_scip2,
    unknown
  };
  Kind kind = Kind::unknown;
  const char* status = "00";
  ScanRequest scan;
  std::uint32_t value = 0;  ///< of CR, SS, HS
};
/// `line` without its line feed.
[[nodiscard]] ScipCommand parse_scip_command(std::string_view line) noexcept;

/// Command lines out of a byte stream: LF, CR or both end one; empty ones and those that are too long are
/// skipped.
class ScipCommandReader {
 public:
  void push(std::string_view bytes);
  /// The next line, or false. The view lives until the next call.
  [[nodiscard]] bool next(std::string_view& line);
  [[nodiscard]] std::uint64_t oversize() const noexcept { return oversize_; }
  void clear() noexcept { pending_.clear(), at_ = 0, skipping_ = false; }

 private:
  std::string pending_;
  std::size_t at_ = 0;
  bool skipping_ = false;
  std::uint64_t oversize_ = 0;
};

/// One reply: echo, status and the lines after it, each with its sum.
struct ScipReply {
  std::string text;                                            ///< all lines, joined
  std::vector<std::pair<std::uint32_t, std::uint32_t>> lines;  ///< offset and length in `text`
  std::int64_t first_ns = 0, last_ns = 0;                      ///< when its first and its last byte came
  [[nodiscard]] std::string_view line(std::size_t i) const {
    return std::string_view(text).substr(lines[i].first, lines[i].second);
  }
  [[nodiscard]] std::string_view echo() const { return lines.empty() ? std::string_view() : line(0); }
  /// Two characters; empty where the reply has none or its sum is wrong. "0" of the SCIP2.0 command counts.
  [[nodiscard]] std::string_view status() const;
};

/// Replies out of a byte stream. Bounded: a line over 128 characters or a reply over 64 KiB or 1200 lines is
/// dropped to its end and counted.
class ScipReplyReader {
 public:
  /// `arrival_ns`: when these bytes came.
  void push(std::string_view bytes, std::int64_t arrival_ns);
  /// Swaps the next reply into `reply`.
  [[nodiscard]] bool next(ScipReply& reply);
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_; }
  void clear();

 private:
  void end_line();
  ScipReply current_;
  std::uint32_t line_start_ = 0;
  bool broken_ = false;
  bool in_line_ = false;
  std::vector<ScipReply> done_, spare_;
  std::size_t taken_ = 0;
  std::uint64_t dropped_ = 0;
};

/// A scan as it came. `range_mm[i]` is the smallest of the steps from first_step + i · width on.
struct ScipScan {
  ScanRequest request;         ///< as echoed; `scans` is what remains
  std::uint32_t stamp_ms = 0;  ///< 24 bits, at step 0
  std::vector<std::uint32_t> range_mm, intensity;
};
enum class ScanDecode : std::uint8_t { scan, not_a_scan, broken };
/// `broken`: a scan by its echo and status, with a wrong sum, a character that is none, or too few or too
/// many values.
[[nodiscard]] ScanDecode decode_scan(const ScipReply& reply, ScipScan& scan);
/// The whole reply to a request. `range_mm` and `intensity` have request.count() values; values that do not
/// fit are written as the largest that does.
void encode_scan(const ScanRequest& request, std::string_view label, const char* status,
                 std::uint32_t stamp_ms, std::span<const std::uint32_t> range_mm,
                 std::span<const std::uint32_t> intensity, std::string& out);

/// Echo, status with sum, empty line.
void encode_status(std::string_view echo, std::string_view status, std::string& out);
/// Appends "NAME:value;s\n".
void encode_field(std::string_view name, std::string_view value, std::string& out);
/// Fields of a text reply (VV, PP, II); empty where a sum is wrong.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> decode_fields(const ScipReply& reply);
[[nodiscard]] std::optional<ScannerParameters> decode_parameters(const ScipReply& reply);
[[nodiscard]] std::optional<ScannerIdentity> decode_identity(const ScipReply& reply);
/// The time in the reply to TM1 (4 characters) or to II (TIME, hexadecimal).
[[nodiscard]] std::optional<std::uint32_t> decode_time(const ScipReply& reply);

/// The scanner's 24-bit millisecond clock without its wraps (every 4.66 h). Readings less than half of that
/// apart; they may be out of order.
class ScipClock {
 public:
  [[nodiscard]] std::int64_t unwrap(std::uint32_t ms) noexcept;
  void reset() noexcept { known_ = false; }

 private:
  std::int64_t last_ = 0;
  bool known_ = false;
};

}  // namespace rigor::usb

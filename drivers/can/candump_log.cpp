#include "drivers/can/candump_log.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "drivers/can/can_bits.h"

namespace rigor::can {
namespace {

constexpr std::uint32_t kErrorFlag = 0x20000000;

int digit(char c) noexcept {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return -1;
}

class LineParser {
 public:
  LineParser(std::string_view line, std::string_view name, std::size_t number)
      : line_(line), name_(name), number_(number) {}

  Result<LogEntry> run() {
    if (read()) return entry_;
    return fail(ErrorCode::bad_input,
                std::string(name_) + ":" + std::to_string(number_) + ":" + std::to_string(at_ + 1),
                "expected " + std::string(expected_) + ", got " + got());
  }

 private:
  bool want(std::string_view what) {
    expected_ = what;
    return false;
  }
  [[nodiscard]] bool ended() const noexcept { return at_ >= line_.size(); }
  [[nodiscard]] char now() const noexcept { return ended() ? '\0' : line_[at_]; }
  std::string got() const {
    if (ended()) return "the end of the line";
    std::string out = "`";
    for (std::size_t i = at_; i < line_.size() && i < at_ + 24; ++i)
      out += line_[i] >= 0x20 && line_[i] < 0x7f ? line_[i] : '?';
    return out + "`";
  }
  bool take(char c) {
    if (now() != c) return false;
    ++at_;
    return true;
  }

  bool read() {
    if (!take('(')) return want("a time in parentheses, such as (1436509052.249713)");
    if (!time()) return false;
    if (!take(' ')) return want("a space");
    while (take(' ')) {
    }
    const std::size_t from = at_;
    while (!ended() && static_cast<unsigned char>(now()) > 0x20 && now() != 0x7f) ++at_;
    if (at_ == from || at_ - from > 15 || now() != ' ') {
      at_ = std::min(from, line_.size());
      return want("the name of an interface of up to 15 characters, and a frame");
    }
    entry_.set_interface(line_.substr(from, at_ - from));
    while (take(' ')) {
    }
    return identifier() && content() && end();
  }

  bool time() {
    std::int64_t whole = 0;
    std::size_t digits = 0;
    for (; now() >= '0' && now() <= '9'; ++at_, ++digits) {
      if (digits >= 12 || whole > 9'000'000'000) return want("seconds since 1970 of at most 10 digits");
      whole = whole * 10 + (now() - '0');
    }
    if (digits == 0) return want("seconds since 1970");
    if (whole > 9'000'000'000) return want("seconds since 1970 of at most 10 digits");
    if (!take('.')) return want("`.` and a fraction of a second");
    std::int64_t fraction = 0;
    std::size_t places = 0;
    for (; now() >= '0' && now() <= '9' && places < 10; ++at_, ++places)
      fraction = fraction * 10 + (now() - '0');
    if (places != 6 && places != 9) return want("6 digits (microseconds) or 9 (nanoseconds)");
    if (!take(')')) return want("`)`");
    entry_.nanoseconds = places == 9;
    entry_.t = RealtimeTime(whole * 1'000'000'000 + (places == 6 ? fraction * 1000 : fraction));
    return true;
  }

  bool identifier() {
    const std::size_t from = at_;
    std::uint32_t id = 0;
    std::size_t digits = 0;
    for (int d; digits < 9 && (d = digit(now())) >= 0; ++at_, ++digits)
      id = id << 4 | static_cast<std::uint32_t>(d);
    CanFrame& f = entry_.frame;
    f.extended = digits == 8;
    if (digits == 8 && (id & kErrorFlag) != 0 && (id & 0xc0000000u) == 0) {
      f.error = true;
      f.extended = false;
      id &= kExtendedMask;
    }
    const std::uint32_t most = digits == 8 ? kExtendedMask : kStandardMask;
    if ((digits != 3 && digits != 8) || id > most) {
      at_ = from;
      return want(
          "an identifier of 3 digits (up to 7FF) or of 8 (up to 1FFFFFFF, an error's up to 3FFFFFFF)");
    }
    f.id = id;
    return take('#') || want("`#`");
  }

  bool content() {
    CanFrame& f = entry_.frame;
    if (take('#')) {
      const int flags = digit(now());
      if (flags < 0) return want("the flags of a CAN FD frame, one digit");
      if (f.error) return want("an error frame that is not CAN FD");
      ++at_;
      f.fd = true;
      entry_.fd_flags = static_cast<std::uint8_t>(flags);
      f.bit_rate_switch = (flags & 1) != 0;
      return data(64);
    }
    if (now() == 'R' || now() == 'r') {
      if (f.error) return want("data: an error frame is no remote request");
      ++at_;
      f.remote = true;
      if (now() >= '0' && now() <= '8') f.length = static_cast<std::uint8_t>(line_[at_++] - '0');
      return f.length != 8 || length_code();
    }
    return data(8) && (f.length != 8 || length_code());
  }

  bool data(std::size_t most) {
    CanFrame& f = entry_.frame;
    while (true) {
      if (f.length > 0) (void)take('.');
      const int high = digit(now());
      if (high < 0) break;
      const std::size_t from = at_++;
      const int low = digit(now());
      if (low < 0 || f.length >= most) {
        at_ = from;
        return want(most == 8 ? "pairs of digits, at most 8 bytes" : "pairs of digits, at most 64 bytes");
      }
      ++at_;
      f.data[f.length++] = static_cast<std::uint8_t>(high << 4 | low);
    }
    return true;
  }

  bool length_code() {
    if (!take('_')) return true;
    const int code = digit(now());
    if (code < 9) return want("a length code from 9 to F");
    ++at_;
    entry_.raw_length_code = static_cast<std::uint8_t>(code);
    return true;
  }

  bool end() {
    if (take(' ')) {
      while (take(' ')) {
      }
      if (now() == 'R' || now() == 'T') entry_.direction = line_[at_++];
    }
    while (now() == ' ' || now() == '\r') ++at_;
    return ended() || want("the end of the frame");
  }

  std::string_view line_, name_, expected_;
  std::size_t number_, at_ = 0;
  LogEntry entry_;
};

}  // namespace

void LogEntry::set_interface(std::string_view name) noexcept {
  interface.fill(0);
  std::copy_n(name.begin(), std::min(name.size(), interface.size() - 1), interface.begin());
}

Result<LogEntry> parse_log_line(std::string_view line, std::string_view name, std::size_t line_number) {
  return LineParser(line, name, line_number).run();
}

std::size_t format_log_line(const LogEntry& e, char* out) noexcept {
  const CanFrame& f = e.frame;
  const auto seconds = static_cast<long long>(e.t.ns() / 1'000'000'000);
  const auto rest = static_cast<long long>(e.t.ns() % 1'000'000'000);
  int n = e.nanoseconds ? std::snprintf(out, kLogLineBytes, "(%010lld.%09lld) ", seconds, rest)
                        : std::snprintf(out, kLogLineBytes, "(%010lld.%06lld) ", seconds, rest / 1000);
  std::size_t at = static_cast<std::size_t>(n);
  n = std::snprintf(out + at, kLogLineBytes - at, "%.15s ", e.interface.data());
  at += static_cast<std::size_t>(n);
  const std::uint32_t id = f.error ? (f.id & kExtendedMask) | kErrorFlag : f.id;
  n = std::snprintf(out + at, kLogLineBytes - at, f.error || f.extended ? "%08X#" : "%03X#", id);
  at += static_cast<std::size_t>(n);
  constexpr char kDigits[] = "0123456789ABCDEF";
  if (f.remote && !f.fd) {
    out[at++] = 'R';
    if (f.length > 0 && f.length <= 8) out[at++] = static_cast<char>('0' + f.length);
  } else {
    if (f.fd) {
      out[at++] = '#';
      out[at++] = kDigits[(e.fd_flags & 0xe) | (f.bit_rate_switch ? 1 : 0)];
    }
    const std::size_t length = std::min<std::size_t>(f.length, f.fd ? 64 : 8);
    for (std::size_t i = 0; i < length; ++i) {
      out[at++] = kDigits[f.data[i] >> 4];
      out[at++] = kDigits[f.data[i] & 0xf];
    }
  }
  if (!f.fd && f.length == 8 && e.raw_length_code > 8 && e.raw_length_code < 16) {
    out[at++] = '_';
    out[at++] = kDigits[e.raw_length_code];
  }
  if (e.direction != 0) {
    out[at++] = ' ';
    out[at++] = e.direction;
  }
  return at;
}

std::string format_log_line(const LogEntry& entry) {
  char line[kLogLineBytes];
  return std::string(line, format_log_line(entry, line));
}

Result<LogReader> LogReader::open(const std::filesystem::path& file) {
  errno = 0;
  auto in = std::make_unique<std::ifstream>(file, std::ios::binary);
  std::error_code error;
  if (!*in || std::filesystem::is_directory(file, error))
    return fail(
        ErrorCode::not_found, file.string(),
        std::string("expected a candump log, got none: ") + std::strerror(errno != 0 ? errno : EISDIR));
  return LogReader(std::move(in), file.filename().string());
}

Result<std::optional<LogEntry>> LogReader::next() {
  while (true) {
    in_->getline(line_.data(), static_cast<std::streamsize>(line_.size()));
    auto n = static_cast<std::size_t>(in_->gcount());
    if (in_->bad()) return fail(ErrorCode::io, name_, "the log cannot be read to its end");
    if (n == 0) return std::optional<LogEntry>();
    ++number_;
    if (in_->fail() && !in_->eof())
      return fail(
          ErrorCode::bad_input, name_ + ":" + std::to_string(number_) + ":1",
          "expected a line of less than " + std::to_string(kMostLineBytes) + " characters, got a longer one");
    if (!in_->eof()) --n;  // its end was taken, too
    std::string_view line(line_.data(), n);
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.remove_suffix(1);
    if (line.empty() || line.front() == '#') continue;
    auto entry = parse_log_line(line, name_, number_);
    if (!entry) return tl::unexpected<Error>(entry.error());
    return std::optional<LogEntry>(*entry);
  }
}

void LogReader::rewind() {
  in_->clear();
  in_->seekg(0);
  number_ = 0;
}

Status LogWriter::open(const std::filesystem::path& file) {
  path_ = file.string();
  failed_ = false;
  file_.reset(std::fopen(path_.c_str(), "we"));
  if (!file_)
    return fail(ErrorCode::not_writable, path_, std::string("cannot be written: ") + std::strerror(errno));
  std::setvbuf(file_.get(), nullptr, _IOFBF, 1u << 16);
  return {};
}

void LogWriter::write(const LogEntry& entry) noexcept {
  if (!file_) return;
  char line[kLogLineBytes + 1];
  const std::size_t n = format_log_line(entry, line);
  line[n] = '\n';
  failed_ |= std::fwrite(line, 1, n + 1, file_.get()) != n + 1;
}

void LogWriter::flush() noexcept {
  if (file_) failed_ |= std::fflush(file_.get()) != 0;
}

Status LogWriter::close() {
  if (!file_) return {};
  failed_ |= std::fclose(file_.release()) != 0;
  if (!failed_) return {};
  return fail(errno == ENOSPC ? ErrorCode::disk_full : ErrorCode::io, path_,
              "the log could not be written in full");
}

}  // namespace rigor::can

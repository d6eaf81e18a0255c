#include "drivers/usb/scip_codec.h"

#include <algorithm>
#include <charconv>
#include <cstdio>

#include "rt-core/device_text.h"

namespace rigor::usb {
namespace {

constexpr std::size_t kLongestLine = 128, kLongestReply = 64 * 1024, kMostLines = 1200, kMostReplies = 256;

bool is_label_character(char c) {
  return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == ' ' || c == '.' ||
         c == '_' || c == '+' || c == '@';
}

/// Exactly `digits` decimal digits at `at`.
bool digits(std::string_view line, std::size_t at, std::size_t count, std::uint32_t& value) {
  value = 0;
  for (std::size_t i = at; i < at + count; ++i) {
    if (i >= line.size() || line[i] < '0' || line[i] > '9') return false;
    value = value * 10 + static_cast<std::uint32_t>(line[i] - '0');
  }
  return true;
}

std::optional<std::uint32_t> number(std::string_view text, int base) {
  std::uint32_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

bool is_scan_command(std::string_view line) {
  return line.size() >= 2 && (line[0] == 'M' || line[0] == 'G') &&
         (line[1] == 'D' || line[1] == 'S' || line[1] == 'E');
}

/// Command, parameters and label of a scan command; "00" or the status that says what is wrong.
const char* parse_scan(std::string_view parameters, ScanRequest& scan) {
  const std::size_t wanted = scan.continuous ? 15 : 12;
  if (parameters.size() < wanted) return "0C";
  if (parameters.size() > wanted) return "0F";
  if (!digits(parameters, 2, 4, scan.first_step)) return "01";
  if (!digits(parameters, 6, 4, scan.last_step)) return "02";
  if (!digits(parameters, 10, 2, scan.cluster)) return "03";
  if (scan.last_step < scan.first_step) return "05";
  if (!scan.continuous) return "00";
  if (!digits(parameters, 12, 1, scan.interval)) return "06";
  if (!digits(parameters, 13, 2, scan.scans)) return "07";
  return "00";
}

bool sum_fits(std::string_view line) {
  return line.size() >= 2 && scip_sum(line.substr(0, line.size() - 1)) == line.back();
}

}  // namespace

char scip_sum(std::string_view bytes) noexcept {
  unsigned sum = 0;
  for (const char c : bytes) sum += static_cast<unsigned char>(c);
  return static_cast<char>((sum & 0x3f) + 0x30);
}

void scip_encode(std::uint32_t value, unsigned characters, std::string& out) {
  for (unsigned i = characters; i-- > 0;) out += static_cast<char>(((value >> (6 * i)) & 0x3f) + 0x30);
}

std::optional<std::uint32_t> scip_decode(std::string_view characters) noexcept {
  if (characters.empty() || characters.size() > 4) return std::nullopt;
  std::uint32_t value = 0;
  for (const char c : characters) {
    if (c < 0x30 || c > 0x6f) return std::nullopt;
    value = value << 6 | static_cast<std::uint32_t>(c - 0x30);
  }
  return value;
}

std::string ScanRequest::line() const {
  char text[32];
  if (continuous)
    std::snprintf(text, sizeof text, "M%c%04u%04u%02u%01u%02u", values, first_step % 10000, last_step % 10000,
                  cluster % 100, interval % 10, scans % 100);
  else
    std::snprintf(text, sizeof text, "G%c%04u%04u%02u", values, first_step % 10000, last_step % 10000,
                  cluster % 100);
  return text;
}

ScipCommand parse_scip_command(std::string_view line) noexcept {
  using Kind = ScipCommand::Kind;
  ScipCommand c;
  const std::size_t semicolon = line.find(';');
  const std::string_view command = line.substr(0, semicolon);
  if (semicolon != std::string_view::npos) {
    const std::string_view label = line.substr(semicolon + 1);
    if (label.size() > kScipLongestLabel) c.status = "0G";
    if (!std::all_of(label.begin(), label.end(), is_label_character)) c.status = "0H";
  }
  const auto simple = [&](std::string_view name, Kind kind) {
    if (command.substr(0, 2) != name) return false;
    c.kind = kind;
    if (command.size() != 2) c.status = "0F";
    return true;
  };
  if (is_scan_command(command)) {
    c.kind = Kind::scan;
    c.scan.continuous = command[0] == 'M';
    c.scan.values = command[1];
    if (const char* status = parse_scan(command, c.scan); std::string_view(status) != "00") c.status = status;
    return c;
  }
  if (command == "SCIP2.0") {
    c.kind = Kind::switch_to_scip2;
    return c;
  }
  const std::string_view two = command.substr(0, 2);
  if (two == "TM") {
    c.kind = Kind::time_read;
    if (command.size() < 3)
      c.status = "0C";
    else if (command.size() > 3)
      c.status = "0F";
    else if (command[2] < '0' || command[2] > '2')
      c.status = "01";
    else
      c.kind = command[2] == '0' ? Kind::time_on : command[2] == '1' ? Kind::time_read : Kind::time_off;
    return c;
  }
  struct Numbered {
    std::string_view name;
    Kind kind;
    std::size_t count;
  };
  for (const Numbered& n : {Numbered{"CR", Kind::motor_speed, 2}, Numbered{"SS", Kind::bit_rate, 6},
                            Numbered{"HS", Kind::sensitivity, 1}}) {
    if (two != n.name) continue;
    c.kind = n.kind;
    if (command.size() < 2 + n.count)
      c.status = "0C";
    else if (command.size() > 2 + n.count)
      c.status = "0F";
    else if (!digits(command, 2, n.count, c.value))
      c.status = "01";
    return c;
  }
  if (simple("VV", Kind::version) || simple("PP", Kind::parameters) || simple("II", Kind::state) ||
      simple("BM", Kind::laser_on) || simple("QT", Kind::quit) || simple("RS", Kind::reset))
    return c;
  c.kind = Kind::unknown;
  c.status = command.size() < 2 ? "0D" : "0E";
  return c;
}

// ------------------------------------------------------------------ readers

void ScipCommandReader::push(std::string_view bytes) {
  pending_.erase(0, at_);
  at_ = 0;
  while (!bytes.empty()) {
    const std::size_t n = std::min(bytes.find_first_of("\n\r"), bytes.size());
    const bool ended = n < bytes.size();
    if (!skipping_) {
      const std::size_t start = pending_.rfind('\n') + 1;  // npos + 1 is 0
      if (n <= kScipLongestCommand - (pending_.size() - start)) {
        pending_ += bytes.substr(0, n);
      } else {
        pending_.resize(start);
        skipping_ = true;
        ++oversize_;
      }
    }
    if (ended && !skipping_) pending_ += '\n';
    if (ended) skipping_ = false;
    bytes.remove_prefix(n + (ended ? 1 : 0));
  }
}

bool ScipCommandReader::next(std::string_view& line) {
  while (at_ < pending_.size()) {
    const std::size_t end = pending_.find('\n', at_);
    if (end == std::string::npos) return false;
    line = std::string_view(pending_).substr(at_, end - at_);
    at_ = end + 1;
    if (!line.empty()) return true;
  }
  return false;
}

std::string_view ScipReply::status() const {
  if (lines.size() < 2) return {};
  const std::string_view s = line(1);
  if (s.size() == 1) return s;
  return s.size() == 3 && sum_fits(s) ? s.substr(0, 2) : std::string_view();
}

void ScipReplyReader::clear() {
  current_ = {};
  line_start_ = 0;
  broken_ = in_line_ = false;
  done_.clear();
  taken_ = 0;
}

void ScipReplyReader::push(std::string_view bytes, std::int64_t arrival_ns) {
  while (!bytes.empty()) {
    const std::size_t n = std::min(bytes.find('\n'), bytes.size());
    if (n != 0) {
      if (!in_line_ && current_.lines.empty() && current_.text.empty()) current_.first_ns = arrival_ns;
      in_line_ = true;
      const std::size_t line = current_.text.size() - line_start_ + n;
      broken_ = broken_ || line > kLongestLine || current_.text.size() + n > kLongestReply ||
                current_.lines.size() >= kMostLines;
      if (!broken_) current_.text += bytes.substr(0, n);
    }
    if (n < bytes.size()) {
      current_.last_ns = arrival_ns;
      end_line();
    }
    bytes.remove_prefix(std::min(n + 1, bytes.size()));
  }
}

void ScipReplyReader::end_line() {
  if (in_line_) {
    in_line_ = false;
    if (broken_) return;
    const auto end = static_cast<std::uint32_t>(current_.text.size());
    current_.lines.emplace_back(line_start_, end - line_start_);
    line_start_ = end;
    return;
  }
  // An empty line: the end of a reply, or one more of them.
  const bool something = !current_.lines.empty();
  if (broken_) {
    ++dropped_;
  } else if (something) {
    if (done_.size() - taken_ >= kMostReplies) {
      ++dropped_;
    } else {
      done_.push_back(std::move(current_));
      if (!spare_.empty()) {
        current_ = std::move(spare_.back());
        spare_.pop_back();
      }
    }
  }
  current_.text.clear();
  current_.lines.clear();
  line_start_ = 0;
  broken_ = false;
}

bool ScipReplyReader::next(ScipReply& reply) {
  if (taken_ == done_.size()) {
    done_.clear();
    taken_ = 0;
    return false;
  }
  std::swap(reply, done_[taken_]);
  if (spare_.size() < 4) spare_.push_back(std::move(done_[taken_]));
  ++taken_;
  return true;
}

// ------------------------------------------------------------------ scans

ScanDecode decode_scan(const ScipReply& reply, ScipScan& scan) {
  const std::string_view echo = reply.echo();
  if (!is_scan_command(echo)) return ScanDecode::not_a_scan;
  const ScipCommand command = parse_scip_command(echo);
  const std::string_view status = reply.status();
  const std::string_view good = echo[0] == 'M' ? "99" : "00";
  if (status.empty()) return ScanDecode::broken;
  if (status != good) return ScanDecode::not_a_scan;
  if (std::string_view(command.status) != "00" || command.kind != ScipCommand::Kind::scan)
    return ScanDecode::broken;
  if (reply.lines.size() < 4) return ScanDecode::broken;
  scan.request = command.scan;
  const std::string_view time = reply.line(2);
  if (time.size() != 5 || !sum_fits(time)) return ScanDecode::broken;
  const auto stamp = scip_decode(time.substr(0, 4));
  if (!stamp) return ScanDecode::broken;
  scan.stamp_ms = *stamp;

  const ScanRequest& r = scan.request;
  const unsigned size = r.value_characters();
  scan.range_mm.clear();
  scan.intensity.clear();
  scan.range_mm.reserve(r.count());
  if (r.values == 'E') scan.intensity.reserve(r.count());
  // A value may begin in one line and end in the next.
  std::uint32_t value = 0, range = 0;
  unsigned filled = 0;
  for (std::size_t i = 3; i < reply.lines.size(); ++i) {
    const std::string_view line = reply.line(i);
    if (line.size() > kScipBlock + 1 || !sum_fits(line)) return ScanDecode::broken;
    for (const char c : line.substr(0, line.size() - 1)) {
      if (c < 0x30 || c > 0x6f) return ScanDecode::broken;
      value = value << 6 | static_cast<std::uint32_t>(c - 0x30);
      if (++filled == r.range_characters()) range = value, value = 0;
      if (filled < size) continue;
      if (scan.range_mm.size() == r.count()) return ScanDecode::broken;
      scan.range_mm.push_back(range);
      if (r.values == 'E') scan.intensity.push_back(value);
      value = 0;
      filled = 0;
    }
  }
  return filled == 0 && scan.range_mm.size() == r.count() ? ScanDecode::scan : ScanDecode::broken;
}

void encode_scan(const ScanRequest& request, std::string_view label, const char* status,
                 std::uint32_t stamp_ms, std::span<const std::uint32_t> range_mm,
                 std::span<const std::uint32_t> intensity, std::string& out) {
  out += request.line();
  out += label;
  out += '\n';
  out += status;
  out += scip_sum(status);
  out += '\n';
  std::string data;
  scip_encode(stamp_ms % kScipClockModulus, 4, data);
  out += data;
  out += scip_sum(data);
  out += '\n';
  data.clear();
  const unsigned characters = request.range_characters();
  const std::uint32_t most = (1u << (6 * characters)) - 1;
  for (std::size_t i = 0; i < range_mm.size(); ++i) {
    scip_encode(std::min(range_mm[i], most), characters, data);
    if (request.values == 'E')
      scip_encode(std::min(i < intensity.size() ? intensity[i] : 0, (1u << 18) - 1), 3, data);
  }
  for (std::size_t at = 0; at < data.size(); at += kScipBlock) {
    const auto block = std::string_view(data).substr(at, kScipBlock);
    out += block;
    out += scip_sum(block);
    out += '\n';
  }
  out += '\n';
}

// ------------------------------------------------------------------ everything else

void encode_status(std::string_view echo, std::string_view status, std::string& out) {
  out += echo;
  out += '\n';
  out += status;
  out += scip_sum(status);
  out += "\n\n";
}

void encode_field(std::string_view name, std::string_view value, std::string& out) {
  const std::size_t start = out.size();
  out += name;
  out += ':';
  out += value;
  const char sum = scip_sum(std::string_view(out).substr(start));
  out += ';';
  out += sum;
  out += '\n';
}

std::vector<std::pair<std::string, std::string>> decode_fields(const ScipReply& reply) {
  std::vector<std::pair<std::string, std::string>> fields;
  for (std::size_t i = 2; i < reply.lines.size(); ++i) {
    const std::string_view line = reply.line(i);
    if (line.size() < 3) return {};
    const std::string_view with = line.substr(0, line.size() - 1);  // with the semicolon
    const std::string_view without = line.substr(0, line.size() - 2);
    if (scip_sum(without) != line.back() && scip_sum(with) != line.back()) return {};
    const std::string_view text = with.back() == ';' ? without : with;
    const std::size_t colon = text.find(':');
    if (colon == std::string_view::npos) return {};
    std::string_view value = text.substr(colon + 1);
    while (!value.empty() && value.front() == ' ') value.remove_prefix(1);
    fields.emplace_back(text.substr(0, colon), value);
  }
  return fields;
}

std::optional<ScannerParameters> decode_parameters(const ScipReply& reply) {
  if (reply.status() != "00") return std::nullopt;
  ScannerParameters p;
  unsigned seen = 0;
  for (const auto& [name, value] : decode_fields(reply)) {
    if (name == "MODL") {
      p.model = device_text(value);
      continue;
    }
    struct Field {
      std::string_view name;
      std::uint32_t& target;
      unsigned bit;
    };
    for (const Field& f :
         {Field{"DMIN", p.min_range_mm, 1}, Field{"DMAX", p.max_range_mm, 2},
          Field{"ARES", p.steps_per_turn, 4}, Field{"AMIN", p.first_step, 8}, Field{"AMAX", p.last_step, 16},
          Field{"AFRT", p.front_step, 32}, Field{"SCAN", p.rpm, 64}}) {
      if (name != f.name) continue;
      const auto n = number(value, 10);
      if (!n) return std::nullopt;
      f.target = *n;
      seen |= f.bit;
    }
  }
  const bool plausible = p.steps_per_turn > 0 && p.steps_per_turn <= 100000 && p.rpm > 0 && p.rpm <= 100000 &&
                         p.first_step <= p.last_step && p.last_step <= 9999 && p.front_step <= 9999;
  if (seen != 127 || !plausible) return std::nullopt;
  return p;
}

std::optional<ScannerIdentity> decode_identity(const ScipReply& reply) {
  if (reply.status() != "00") return std::nullopt;
  ScannerIdentity id;
  for (const auto& [name, value] : decode_fields(reply)) {
    if (name == "VEND") id.vendor = device_text(value);
    if (name == "PROD") id.product = device_text(value);
    if (name == "FIRM") id.firmware = device_text(value);
    if (name == "PROT") id.protocol = device_text(value);
    if (name == "SERI") id.serial = device_text(value);
  }
  if (id.serial.empty() && id.product.empty()) return std::nullopt;
  return id;
}

std::optional<std::uint32_t> decode_time(const ScipReply& reply) {
  if (reply.status() != "00") return std::nullopt;
  if (reply.echo().substr(0, 3) == "TM1") {
    if (reply.lines.size() != 3) return std::nullopt;
    const std::string_view time = reply.line(2);
    if (time.size() != 5 || !sum_fits(time)) return std::nullopt;
    return scip_decode(time.substr(0, 4));
  }
  for (const auto& [name, value] : decode_fields(reply))
    if (name == "TIME") {
      const auto t = number(value, 16);
      return t && *t < kScipClockModulus ? t : std::nullopt;
    }
  return std::nullopt;
}

std::int64_t ScipClock::unwrap(std::uint32_t ms) noexcept {
  constexpr std::int64_t kModulus = kScipClockModulus;
  if (!known_) {
    known_ = true;
    return last_ = ms;
  }
  std::int64_t step = (static_cast<std::int64_t>(ms) - last_) % kModulus;
  if (step < 0) step += kModulus;
  if (step >= kModulus / 2) step -= kModulus;
  const std::int64_t t = last_ + step;
  last_ = std::max(last_, t);
  return t;
}

}  // namespace rigor::usb

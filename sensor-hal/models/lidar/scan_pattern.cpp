#include "sensor-hal/models/lidar/scan_pattern.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <numbers>
#include <optional>
#include <string>

namespace rigor::models {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::uintmax_t kMaxFileBytes = std::uintmax_t{256} << 20;
constexpr double kLongest_s = 86'400;

struct Column {
  std::string_view name;
  double min, max;
};
constexpr Column kColumns[] = {{"time_s", 0, kLongest_s},
                               {"azimuth_deg", -360, 360},
                               {"elevation_deg", -90, 90},
                               {"divergence_mrad", 0, 500}};
constexpr std::size_t kNeeded = 3, kAll = std::size(kColumns);

std::string_view trimmed(std::string_view s) {
  const auto first = s.find_first_not_of(" \t\r");
  return first == s.npos ? std::string_view{} : s.substr(first, s.find_last_not_of(" \t\r") - first + 1);
}

std::optional<double> number_of(std::string_view s) {
  if (!s.empty() && s.front() == '+') s.remove_prefix(1);
  double v = 0;
  const auto [end, error] = std::from_chars(s.data(), s.data() + s.size(), v);
  return error == std::errc() && end == s.data() + s.size() ? std::optional(v) : std::nullopt;
}

std::string plain(double v) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, v).ptr};
}
std::string quoted(std::string_view s) { return '"' + std::string(s.substr(0, 40)) + '"'; }

class Parser {
 public:
  Parser(std::string_view text, const std::string& name) : text_(text), name_(name) {}

  Result<PatternTable> parse() {
    for (std::size_t at = 0; at < text_.size();) {
      const std::size_t end = std::min(text_.find('\n', at), text_.size());
      ++line_;
      if (auto s = take(trimmed(text_.substr(at, end - at))); !s) return tl::unexpected<Error>(s.error());
      at = end + 1;
    }
    if (table_.firings.empty())
      return fail(ErrorCode::bad_input, name_,
                  "expected rows of time_s,azimuth_deg,elevation_deg, got a file without any");
    return std::move(table_);
  }

 private:
  [[nodiscard]] Status wrong(const std::string& what) const {
    return fail(ErrorCode::bad_input, name_ + ":" + std::to_string(line_), what);
  }

  Status take(std::string_view line) {
    if (line.empty() || line.front() == '#') return {};
    std::vector<std::string_view>& fields = fields_;
    fields.clear();
    for (std::size_t at = 0; at <= line.size() && fields.size() <= 16;) {
      const std::size_t end = std::min(line.find(',', at), line.size());
      fields.push_back(trimmed(line.substr(at, end - at)));
      at = end + 1;
    }
    if (!any_) {
      any_ = true;
      // A header has words; an empty field is no word.
      if (!fields[0].empty() && !number_of(fields[0])) return header(fields);
      // Without a header, in this order.
      for (std::size_t i = 0; i < std::clamp(fields.size(), kNeeded, kAll); ++i) order_.push_back(i);
    }
    return row(fields);
  }

  Status header(const std::vector<std::string_view>& fields) {
    for (const std::string_view f : fields) {
      const auto* known = std::find_if(std::begin(kColumns), std::end(kColumns),
                                       [&](const Column& c) { return c.name == f; });
      const auto index = static_cast<std::size_t>(known - std::begin(kColumns));
      if (known == std::end(kColumns))
        return wrong(
            "expected the columns time_s, azimuth_deg, elevation_deg and, where they differ, "
            "divergence_mrad, got " +
            quoted(f));
      if (std::find(order_.begin(), order_.end(), index) != order_.end())
        return wrong("expected each column once, got " + quoted(f) + " again");
      order_.push_back(index);
    }
    for (std::size_t i = 0; i < kNeeded; ++i)
      if (std::find(order_.begin(), order_.end(), i) == order_.end())
        return wrong("expected a column " + std::string(kColumns[i].name) + ", got none");
    return {};
  }

  Status row(const std::vector<std::string_view>& fields) {
    if (fields.size() != order_.size())
      return wrong("expected " + std::to_string(order_.size()) + " numbers, got " +
                   std::to_string(fields.size()) + " fields");
    if (table_.firings.size() == kMaxPatternRows)
      return wrong("expected at most " + std::to_string(kMaxPatternRows) + " rows, got more");
    double value[kAll] = {};
    for (std::size_t i = 0; i < fields.size(); ++i) {
      const Column& c = kColumns[order_[i]];
      const auto v = number_of(fields[i]);
      // Not a number fails the comparison.
      if (!v || !(*v >= c.min && *v <= c.max))
        return wrong(std::string(c.name) + ": expected a number from " + plain(c.min) + " to " +
                     plain(c.max) + ", got " + quoted(fields[i]));
      value[order_[i]] = *v;
    }
    const auto t_ns = static_cast<std::int64_t>(std::llround(value[0] * 1e9));
    if (table_.firings.empty()) first_ns_ = t_ns;
    PatternFiring f;
    f.time_ns = t_ns - first_ns_;
    if (!table_.firings.empty() && f.time_ns < table_.firings.back().time_ns)
      return wrong("time_s: expected a time that is not before that of the row above, got " +
                   plain(value[0]));
    f.azimuth_rad = static_cast<float>(value[1] * kDegree);
    f.elevation_rad = static_cast<float>(value[2] * kDegree);
    f.divergence_rad = static_cast<float>(value[3] * 1e-3);
    table_.has_divergence = order_.size() == kAll;
    table_.firings.push_back(f);
    return {};
  }

  std::string_view text_;
  const std::string& name_;
  std::size_t line_ = 0;
  bool any_ = false;
  std::vector<std::size_t> order_;  ///< of the file's columns
  std::vector<std::string_view> fields_;
  std::int64_t first_ns_ = 0;
  PatternTable table_;
};

std::int64_t last_ns(const PatternTable& t) { return t.firings.empty() ? 0 : t.firings.back().time_ns; }

}  // namespace

void PatternTable::scan(std::uint64_t index, std::int64_t scan_ns, std::vector<PatternFiring>& out) const {
  if (firings.empty() || scan_ns <= 0) return;
  const auto from = static_cast<unsigned __int128>(index) * static_cast<std::uint64_t>(scan_ns);
  std::int64_t begin_ns = 0;
  if (periodic) {
    begin_ns = static_cast<std::int64_t>(from % static_cast<std::uint64_t>(period_ns));
  } else if (from > static_cast<std::uint64_t>(last_ns(*this))) {
    return;  // it has ended
  } else {
    begin_ns = static_cast<std::int64_t>(from);
  }
  const auto begins = [](const PatternFiring& f, std::int64_t t) { return f.time_ns < t; };
  auto at = std::lower_bound(firings.begin(), firings.end(), begin_ns, begins);
  for (std::int64_t turn_ns = -begin_ns;; turn_ns += period_ns, at = firings.begin()) {
    for (; at != firings.end() && at->time_ns + turn_ns < scan_ns; ++at) {
      out.push_back(*at);
      out.back().time_ns += turn_ns;
    }
    if (!periodic || at != firings.end() || turn_ns + period_ns >= scan_ns) return;
  }
}

std::size_t PatternTable::max_firings(std::int64_t scan_ns) const {
  const std::size_t n = firings.size();
  if (n == 0 || scan_ns <= 0) return 0;
  const std::size_t whole = periodic ? static_cast<std::size_t>(scan_ns / period_ns) * n : 0;
  const std::int64_t rest_ns = periodic ? scan_ns % period_ns : scan_ns;
  // A longest scan begins with a firing.
  std::size_t most = 0, end = 0;
  for (std::size_t first = 0; first < n && rest_ns > 0; ++first) {
    const auto time = [&](std::size_t i) { return firings[i % n].time_ns + (i >= n ? period_ns : 0); };
    while (end < (periodic ? first + n : n) && time(end) - firings[first].time_ns < rest_ns) ++end;
    most = std::max(most, end - first);
  }
  return whole + most;
}

std::int64_t PatternTable::step_ns() const {
  if (firings.size() < 2) return periodic ? period_ns : 0;
  const std::int64_t step = firings[1].time_ns - firings[0].time_ns;
  for (std::size_t i = 1; i < firings.size(); ++i)
    if (firings[i].time_ns - firings[i - 1].time_ns != step) return 0;
  return periodic && period_ns - last_ns(*this) != step ? 0 : step;
}

Result<PatternTable> parse_scan_pattern(std::string_view text, const std::string& name) {
  // What editors of Windows put before the first word.
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  return Parser(text, name).parse();
}

Result<PatternTable> load_scan_pattern(const std::filesystem::path& file) {
  std::error_code none;
  if (!std::filesystem::is_regular_file(file, none))
    return fail(ErrorCode::not_found, file.string(), "expected a scan pattern (CSV), found no such file");
  if (const auto bytes = std::filesystem::file_size(file, none); none || bytes > kMaxFileBytes)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a scan pattern of at most " + std::to_string(kMaxFileBytes >> 20) +
                    " MiB, got one of " + std::to_string(bytes >> 20));
  std::ifstream in(file, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  if (in.bad()) return fail(ErrorCode::io, file.string(), "expected a file that can be read");
  return parse_scan_pattern(text, file.string());
}

Status set_period(PatternTable& table, std::int64_t period_ns) {
  const std::int64_t last = last_ns(table);
  if (period_ns == 0) {
    if (last == 0)
      return fail(ErrorCode::bad_input, "period_ms",
                  "expected a period, as the rows of the file have one time alone; got none");
    const auto steps = static_cast<std::int64_t>(table.firings.size() - 1);
    period_ns = last + std::max<std::int64_t>(1, (last + steps / 2) / steps);
  }
  if (period_ns <= last)
    return fail(ErrorCode::bad_input, "period_ms",
                "expected more than the " + plain(static_cast<double>(last) * 1e-6) +
                    " ms from the first row to the last, got " +
                    plain(static_cast<double>(period_ns) * 1e-6));
  table.periodic = true;
  table.period_ns = period_ns;
  return {};
}

std::array<double, 3> livox_mid360_direction(std::uint32_t line, double t_s) {
  // Two elements turn evenly. The first leads the beam around a cone about an axis at kAxis of elevation, the
  // second turns that axis about z, clockwise. The four lines are an array of kPitch; the mirror turns its
  // image, too, so that it stands upright at azimuth kArray and lies flat a quarter of a turn later. Fitted
  // to 176 rows of the table, from the first quarter of its second: 1.7 degrees (rms; 3.5 at most), where
  // cone and pitch were bound to fill −7 to 52 degrees.
  constexpr double kTurn_hz = 182.4508, kCone_hz = 9.92307;
  constexpr double kTurn = 271.1726 * kDegree, kConePhase = 0.6172 * kDegree;
  constexpr double kAxis = 22.5 * kDegree, kPitch = 2.53574 * kDegree, kArray = 2.29708 * kDegree;
  constexpr double kCone = 29.5 * kDegree - 1.5 * kPitch;
  // Whole turns are taken away before the sine, so that a long run loses nothing.
  const auto turns = [&](double hz) { return 2 * std::numbers::pi * std::fmod(hz * t_s, 1.0); };
  const double turn = kTurn - turns(kTurn_hz), cone = kConePhase + turns(kCone_hz);
  const double x = std::cos(kCone), y = std::sin(kCone) * std::sin(cone),
               z = std::sin(kCone) * std::cos(cone);
  const double forward = std::cos(kAxis) * x - std::sin(kAxis) * z;
  const double elevation = std::asin(std::sin(kAxis) * x + std::cos(kAxis) * z);
  const double beside = (static_cast<double>(line % kLivoxLines) - 1.5) * kPitch;
  const double e = elevation + beside * std::sin(turn - kArray);
  const double a = std::atan2(y, forward) + turn + beside * std::cos(turn - kArray) / std::cos(elevation);
  return {std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
}

}  // namespace rigor::models

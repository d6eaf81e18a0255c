#include "bench/sweep/sweep_row.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

#include "rt-core/numbers.h"
#include "sensor-hal/config/json_text.h"

namespace rigor::sweep {
namespace {

using nlohmann::json;

double number_or_nan(const json& v) {
  if (v.is_boolean()) return v.get<bool>() ? 1 : 0;
  return v.is_number() ? v.get<double>() : kNaN;
}

/// JSON has no NaN: a null is one.
json known(double v) { return std::isfinite(v) ? json(v) : json(); }

/// All numbers below an object, by the way to them. Texts and lists are left out.
void add_numbers(const std::string& name, const json& of, std::map<std::string, double>& out) {
  for (const auto& [key, value] : of.items()) {
    const std::string path = name + " " + key;
    if (value.is_object())
      add_numbers(path, value, out);
    else if (value.is_number() || value.is_null() || value.is_boolean())
      out.emplace(path, number_or_nan(value));
  }
}

void add_keys(const std::string& name, const json& of, std::initializer_list<const char*> keys,
              std::map<std::string, double>& out) {
  for (const char* key : keys)
    if (of.contains(key)) out.emplace(name + " " + key, number_or_nan(of[key]));
}

/// What the report says in numbers that depend on the run alone. How long the machine took is not among it.
std::map<std::string, double> metrics_of(const json& report) {
  std::map<std::string, double> out;
  for (const json& c : report.at("channels")) {
    const std::string name = c.at("name");
    add_keys(name, c,
             {"rate_hz", "delivered", "missing", "late_samples", "lost_samples", "overdue_cycles",
              "disconnected_cycles"},
             out);
    if (c.at("age").at("count") != 0)
      for (const auto& [key, metric] :
           {std::pair{"p50_ns", "age_p50_ms"}, {"p99_ns", "age_p99_ms"}, {"max_ns", "age_max_ms"}})
        out.emplace(name + " " + metric, number_or_nan(c.at("age").at(key)) * 1e-6);
    if (!c.contains("pair")) continue;
    const std::string unit = c["pair"].value("unit", "");
    add_keys(name + " pair", c["pair"], {"count", "real_missing", "simulated_missing"}, out);
    for (const char* key : {"bias", "sigma"})
      out.emplace(fmt::format("{} pair {}{}", name, key, unit.empty() ? "" : " " + unit),
                  number_or_nan(c["pair"].at(key)));
  }
  for (const json& s : report.at("sinks"))
    add_keys(s.at("name"), s, {"accepted", "applied", "late", "failed", "dropped"}, out);
  if (report.contains("analyses"))
    for (const auto& [name, analysis] : report["analyses"].items()) add_numbers(name, analysis, out);
  return out;
}

/// How far values from `min` to `max` reach beyond bounds as expectations write them: "of at most 3", "of at
/// least 4.9", "from -45 to 45". 0 of others.
double beyond_bounds(const std::string& bounds, double min, double max) {
  double low = 0, high = 0;
  if (std::sscanf(bounds.c_str(), "from %lf to %lf", &low, &high) == 2)
    return std::max({0.0, low - min, max - high});
  if (std::sscanf(bounds.c_str(), "of at most %lf", &high) == 1) return std::max(0.0, max - high);
  if (std::sscanf(bounds.c_str(), "of at least %lf", &low) == 1) return std::max(0.0, low - min);
  return 0;
}

void add_expectations(const json& report, Row& row) {
  if (!report.contains("expect")) return;
  std::map<std::string, int> seen;
  for (const json& e : report["expect"]) {
    const std::string of = e.at("of"), quantity = e.at("quantity"), bounds = e.at("bounds");
    RowExpectation x;
    x.name = fmt::format("{} {} {}", of, quantity, bounds);
    // The same bounds in another window of the run.
    if (const int n = ++seen[x.name]; n > 1) x.name += fmt::format(" ({})", n);
    x.state = e.at("state");
    const double looked_at = e.at("looked_at");
    if (looked_at > 0) {
      x.outside = e.at("outside").get<double>() / looked_at;
      const double min = number_or_nan(e.at("minimum")), max = number_or_nan(e.at("maximum"));
      x.beyond = beyond_bounds(bounds, min, max);
      if (looked_at == 1) {
        row.metrics.emplace(x.name + ": got", min);
      } else {
        row.metrics.emplace(x.name + ": least", min);
        row.metrics.emplace(x.name + ": most", max);
      }
    }
    row.expectations.push_back(std::move(x));
  }
}

/// What a process said of its errors, in one line: without warnings, and without repeating a line.
std::string said(const std::string& err) {
  std::vector<std::string> lines;
  for (std::size_t at = 0; at < err.size();) {
    const std::size_t end = std::min(err.find('\n', at), err.size());
    std::string line = err.substr(at, end - at);
    at = end + 1;
    if (line.starts_with("rigor: warning: ") || !line.starts_with("rigor: ")) continue;
    line.erase(0, std::strlen("rigor: "));
    if (std::ranges::find(lines, line) == lines.end()) lines.push_back(std::move(line));
  }
  return fmt::format("{}", fmt::join(lines, "; "));
}

bool of_a_full_disk(const std::string& err) {
  return err.find("No space left on device") != std::string::npos ||
         err.find("Disk quota exceeded") != std::string::npos || err.find("no space ") != std::string::npos;
}

}  // namespace

json to_json(const Row& row) {
  json expectations = json::array(), metrics = json::object();
  for (const RowExpectation& e : row.expectations)
    expectations.push_back(
        {{"name", e.name}, {"state", e.state}, {"outside", e.outside}, {"beyond", known(e.beyond)}});
  for (const auto& [name, value] : row.metrics) metrics[name] = known(value);
  return {{"index", row.index},
          {"status", row.status},
          {"reason", row.reason},
          {"verdict", row.verdict},
          {"input_sha256", row.input_sha256},
          {"expect", expectations},
          {"metrics", metrics},
          {"wall_s", row.wall_s}};
}

std::optional<Row> row_from_json(const json& j) {
  try {
    Row row;
    row.index = j.at("index");
    row.status = j.at("status");
    row.reason = j.at("reason");
    row.verdict = j.at("verdict");
    row.input_sha256 = j.at("input_sha256");
    for (const json& e : j.at("expect"))
      row.expectations.push_back(
          {e.at("name"), e.at("state"), e.at("outside"), number_or_nan(e.at("beyond"))});
    for (const auto& [name, value] : j.at("metrics").items()) row.metrics.emplace(name, number_or_nan(value));
    row.wall_s = j.at("wall_s");
    return row;
  } catch (const json::exception&) {
    return std::nullopt;
  }
}

Result<Row> row_of(std::uint64_t index, const ChildEnd& end) {
  Row row;
  row.index = index;
  row.wall_s = end.wall_s;
  const std::string where = fmt::format("run {}", index);
  if (end.how == ChildEnd::How::stopped) return fail(ErrorCode::unavailable, where, "it was interrupted");
  if (end.how == ChildEnd::How::timed_out) {
    row.status = "timeout";
    row.reason = "it did not end within the time of --timeout";
    return row;
  }
  if (end.how == ChildEnd::How::killed) {
    row.status = "crashed";
    row.reason = fmt::format("signal {}, {}", end.status, ::strsignal(end.status));
    return row;
  }
  if (end.status != 0 && of_a_full_disk(end.err)) return fail(ErrorCode::disk_full, where, said(end.err));
  const json report = parse_json(end.out).value_or(json());
  if (!report.is_object() || !report.contains("verdict")) {
    row.status = "error";
    row.reason = said(end.err);
    if (row.reason.empty()) row.reason = fmt::format("exit status {}, without a report", end.status);
    return row;
  }
  try {
    if (report.at("loop").at("reason") == to_string(StopReason::signal))
      return fail(ErrorCode::unavailable, where, "a signal ended it before its end");
    row.verdict = report.at("verdict").at("state");
    if (const json& digest = report.at("input_sha256"); digest.is_string()) row.input_sha256 = digest;
    row.metrics = metrics_of(report);
    add_expectations(report, row);
  } catch (const json::exception& e) {
    return fail(ErrorCode::internal, where, fmt::format("its report is not as expected: {}", e.what()));
  }
  const bool violated =
      std::ranges::any_of(row.expectations, [](const RowExpectation& e) { return e.state == "violated"; });
  row.status = end.status == 0 ? "passed" : violated ? "failed" : "error";
  if (end.status != 0) row.reason = said(end.err);
  return row;
}

}  // namespace rigor::sweep

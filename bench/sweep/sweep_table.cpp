#include "bench/sweep/sweep_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace rigor::sweep {
namespace {

std::string cell(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string number_cell(double v) { return std::isnan(v) ? "nan" : fmt::format("{}", v); }

}  // namespace

TableColumns table_columns(const std::vector<std::optional<Row>>& rows) {
  TableColumns columns;
  std::set<std::string> expectations, metrics;
  for (const auto& row : rows) {
    if (!row) continue;
    for (const RowExpectation& e : row->expectations)
      if (expectations.insert(e.name).second) columns.expectations.push_back(e.name);
    for (const auto& [name, value] : row->metrics) metrics.insert(name);
  }
  columns.metrics.assign(metrics.begin(), metrics.end());
  return columns;
}

std::string table_text(const SweepPlan& plan, const std::vector<std::optional<Row>>& rows) {
  const TableColumns columns = table_columns(rows);
  std::string out = "run";
  for (const SweepParameter& p : plan.options().vary) out += "," + cell(p.key);
  out += ",seed,status,reason,verdict,input_sha256";
  for (const std::string& name : columns.expectations) out += "," + cell("expect " + name);
  for (const std::string& name : columns.metrics) out += "," + cell(name);
  out += "\r\n";
  for (std::uint64_t i = 0; i < rows.size(); ++i) {
    const SweepRun run = plan.run(i);
    out += fmt::format("{}", i);
    for (const std::string& value : run.values) out += "," + cell(value);
    out += fmt::format(",{}", run.seed);
    if (!rows[i]) {
      out += ",not run" + std::string(3 + columns.expectations.size() + columns.metrics.size(), ',') + "\r\n";
      continue;
    }
    const Row& row = *rows[i];
    for (const std::string* text : {&row.status, &row.reason, &row.verdict, &row.input_sha256})
      out += "," + cell(*text);
    for (const std::string& name : columns.expectations) {
      const auto e = std::ranges::find(row.expectations, name, &RowExpectation::name);
      out += "," + (e == row.expectations.end() ? "" : e->state);
    }
    for (const std::string& name : columns.metrics) {
      const auto m = row.metrics.find(name);
      out += "," + (m == row.metrics.end() ? "" : number_cell(m->second));
    }
    out += "\r\n";
  }
  return out;
}

}  // namespace rigor::sweep

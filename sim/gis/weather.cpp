#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "sim/gis/csv.h"
#include "sim/gis/tree_list.h"

namespace rigor::gis {

Result<double> parse_utc(std::string_view text, const std::string& where) {
  const auto refuse = [&](const char* what) {
    return fail(ErrorCode::bad_input, where,
                fmt::format("expected {} such as 2024-06-21T10:00:00Z, got '{}'", what, text));
  };
  const auto digits = [&](std::size_t at, std::size_t n) -> int {
    if (at + n > text.size()) return -1;
    int v = 0;
    for (std::size_t i = at; i < at + n; ++i) {
      if (text[i] < '0' || text[i] > '9') return -1;
      v = v * 10 + (text[i] - '0');
    }
    return v;
  };
  const int year = digits(0, 4), month = digits(5, 2), day = digits(8, 2), hour = digits(11, 2),
            minute = digits(14, 2);
  if (year < 0 || month < 0 || day < 0 || hour < 0 || minute < 0 || text[4] != '-' || text[7] != '-' ||
      (text[10] != 'T' && text[10] != ' ') || text[13] != ':')
    return refuse("a time");
  std::size_t at = 16;
  double second = 0;
  if (at < text.size() && text[at] == ':') {
    std::size_t end = at + 1;
    while (end < text.size() && ((text[end] >= '0' && text[end] <= '9') || text[end] == '.')) ++end;
    const auto s = number_of(text.substr(at + 1, end - at - 1));
    if (!s || !(*s >= 0 && *s < 61)) return refuse("a time");
    second = *s;
    at = end;
  }
  int offset_min = 0;
  const std::string_view zone = text.substr(at);
  if (zone == "Z" || zone == "z") {
    offset_min = 0;
  } else if ((zone.size() == 5 || zone.size() == 6) && (zone[0] == '+' || zone[0] == '-')) {
    const int h = digits(at + 1, 2), m = digits(at + (zone.size() == 6 ? 4 : 3), 2);
    if (h < 0 || h > 14 || m < 0 || m > 59 || (zone.size() == 6 && zone[3] != ':')) return refuse("a time");
    offset_min = (h * 60 + m) * (zone[0] == '-' ? -1 : 1);
  } else {
    return refuse("a time with Z or an offset from UTC");
  }
  using namespace std::chrono;
  const year_month_day date{std::chrono::year(year), std::chrono::month(static_cast<unsigned>(month)),
                            std::chrono::day(static_cast<unsigned>(day))};
  // 24:00 is the end of a day, and nothing comes after it.
  if (!date.ok() || hour > 24 || minute > 59 || (hour == 24 && (minute > 0 || second > 0)))
    return refuse("a time");
  return static_cast<double>(sys_days(date).time_since_epoch().count()) * 86400 + hour * 3600 +
         (minute - offset_min) * 60 + second;
}

Result<Weather> read_weather(const world::Schema& schema, const ImportSource& source) {
  auto table = read_csv(source.location);
  if (!table) return tl::unexpected(table.error());
  Weather weather;
  auto time = table->find("utc_s");
  const bool unix_time = time.has_value();
  if (!time) time = table->find("time");
  if (!time)
    return fail(ErrorCode::bad_input, table->file,
                "expected a column utc_s (Unix time) or time (ISO 8601), got neither");
  auto columns = source.columns;
  for (const auto a : schema.attributes(schema.require_type("Atmosphere"))) {
    const auto& spec = schema.attribute(a).spec;
    const auto mapped = [&](const auto& c) { return c.first == spec.name; };
    if (schema.attribute(a).kind() == world::ValueKind::number && spec.name != "utc_s" &&
        table->find(spec.name) && std::none_of(columns.begin(), columns.end(), mapped))
      columns.emplace_back(spec.name, spec.name);
  }
  auto mapping = ColumnMapping::make(schema, "Atmosphere", columns, table->columns, {}, table->file);
  if (!mapping) return tl::unexpected(mapping.error());
  for (auto& e : mapping->entries()) {
    if (!e.spec || world::kind_of(e.spec->default_value) != world::ValueKind::number ||
        e.attribute == "utc_s")
      return fail(
          ErrorCode::bad_input, table->file,
          fmt::format("columns: expected numbers of the Atmosphere that change with the weather, got {}",
                      e.attribute));
    weather.columns.push_back(e.attribute);
  }
  if (mapping->entries().empty())
    return fail(ErrorCode::bad_input, table->file,
                "expected columns named as attributes of the Atmosphere (temperature_c, cloud_cover …), got "
                "none: map them "
                "with columns");
  Complaints complaints;
  std::vector<double> before;
  for (auto& e : mapping->entries()) before.push_back(std::get<double>(e.spec->default_value));
  for (const CsvRow& row : table->rows) {
    const std::string place = table->place(row);
    double utc = 0;
    if (unix_time) {
      const auto v = number_of(row.cells[*time]);
      if (!v || std::isnan(*v))
        return fail(ErrorCode::bad_input, place,
                    fmt::format("utc_s: expected a number, got '{}'", row.cells[*time]));
      utc = *v;
    } else {
      auto v = parse_utc(row.cells[*time], place + ": time");
      if (!v) return tl::unexpected(v.error());
      utc = *v;
    }
    const std::size_t width = mapping->entries().size() + 1;
    if (!weather.table.empty() && utc <= weather.table[weather.table.size() - width])
      return fail(ErrorCode::bad_input, place,
                  "expected times that rise from row to row, got one that does not");
    weather.table.push_back(utc);
    for (std::size_t i = 0; i < mapping->entries().size(); ++i) {
      auto v = mapping->value(mapping->entries()[i], table->cells_of(row), place, complaints);
      if (!v) return tl::unexpected(v.error());
      if (*v)
        before[i] = std::get<double>(**v);
      else
        complaints.add(fmt::format("{} is missing; taken from the row before", weather.columns[i]), place);
      weather.table.push_back(before[i]);
    }
  }
  if (auto s = mapping->finish(table->file); !s) return tl::unexpected(s.error());
  if (weather.table.empty())
    return fail(ErrorCode::bad_input, table->file, "expected rows of weather, got none");
  complaints.move_into(weather.warnings, table->file);
  return weather;
}

}  // namespace rigor::gis

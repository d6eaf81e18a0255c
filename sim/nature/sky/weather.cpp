#include "sim/nature/sky/weather.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "sim/world/semantic_types.h"

namespace rigor::nature {
namespace {

using world::NodeId;

bool is_column(const world::Schema& schema, world::TypeId atmosphere, const std::string& name) {
  if (name == "utc_s") return false;
  const auto a = schema.find_attribute(atmosphere, name);
  return a && schema.attribute(*a).kind() == world::ValueKind::number;
}

/// Writes what all series say of the Atmosphere's present time.
Status write_weather(world::Transaction& tx) {
  const auto world = tx.view();
  const world::types::Atmosphere a(world.schema());
  const world::types::WeatherSeries w(world.schema());
  const auto atmospheres = nodes_by_id(world, a.type);
  for (const NodeId series : nodes_by_id(world, w.type)) {
    const auto table = WeatherTable::of(world, series);
    if (!table) return tl::unexpected(table.error());
    if (atmospheres.empty() || table->row_count() == 0) continue;
    const NodeId air = atmospheres.front();
    const double utc_s = world.get_or_default(air, a.utc_s);
    for (std::size_t c = 0; c < table->columns.size(); ++c)
      if (auto s = tx.set(air, table->columns[c], table->at(c, utc_s)); !s) return s;
  }
  return {};
}

}  // namespace

std::vector<NodeId> nodes_by_id(const world::Snapshot& world, world::TypeId type) {
  auto nodes = world.nodes(type);
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

Result<WeatherTable> WeatherTable::of(const world::Snapshot& world, NodeId series) {
  const world::types::WeatherSeries w(world.schema());
  const auto atmosphere = world.schema().require_type("Atmosphere");
  const std::string where = "weather series " + std::to_string(series.value);
  WeatherTable t;
  t.rows = world.get_or_default(series, w.table);
  std::istringstream words(world.get_or_default(series, w.columns));
  for (std::string word; words >> word; t.columns.push_back(word)) {
    if (!is_column(world.schema(), atmosphere, word))
      return fail(ErrorCode::bad_input, where,
                  "expected columns that are numbers of an Atmosphere other than utc_s, got `" + word + "`");
    if (std::find(t.columns.begin(), t.columns.end(), word) != t.columns.end())
      return fail(ErrorCode::bad_input, where, "column `" + word + "` is there twice");
  }
  const std::size_t width = t.columns.size() + 1;
  if (t.columns.empty() ? !t.rows.empty() : t.rows.size() % width != 0)
    return fail(ErrorCode::bad_input, where,
                "expected rows of utc_s and " + std::to_string(t.columns.size()) + " values, got " +
                    std::to_string(t.rows.size()) + " numbers in all");
  for (std::size_t row = 0; row < t.row_count(); ++row) {
    if (!std::isfinite(t.utc_s(row)) || (row > 0 && !(t.utc_s(row) > t.utc_s(row - 1))))
      return fail(ErrorCode::bad_input, where,
                  "expected utc_s that rises from row to row; row " + std::to_string(row) + " does not");
    for (std::size_t c = 1; c < width; ++c)
      if (std::isnan(t.rows[row * width + c]))
        return fail(ErrorCode::bad_input, where,
                    "expected numbers, got NaN for `" + t.columns[c - 1] + "` in row " + std::to_string(row));
  }
  return t;
}

double WeatherTable::at(std::size_t column, double utc_s) const {
  const std::size_t width = columns.size() + 1, count = row_count();
  const auto value = [&](std::size_t row) { return rows[row * width + 1 + column]; };
  if (!(utc_s > this->utc_s(0))) return value(0);
  if (utc_s >= this->utc_s(count - 1)) return value(count - 1);
  std::size_t low = 0, high = count - 1;  // utc_s(low) <= utc_s < utc_s(high)
  while (high - low > 1) {
    const std::size_t middle = (low + high) / 2;
    (this->utc_s(middle) <= utc_s ? low : high) = middle;
  }
  const double f = (utc_s - this->utc_s(low)) / (this->utc_s(high) - this->utc_s(low));
  const double a = value(low), b = value(high);
  const std::string& name = columns[column];
  if (name == "wind_from_deg" || name == "sun_azimuth_deg") {
    const double turned = std::fmod(a + f * std::remainder(b - a, 360), 360);
    return turned < 0 ? turned + 360 : turned;
  }
  if ((name == "visibility_m" || name == "fog_visibility_m") && a > 0 && b > 0) {
    const double inverse = (1 - f) / a + f / b;
    return inverse > 0 ? 1 / inverse : std::numeric_limits<double>::infinity();
  }
  if (!std::isfinite(a) || !std::isfinite(b)) return a;
  return a + f * (b - a);
}

bool WeatherTable::covers(double utc_s) const noexcept {
  const std::size_t count = row_count();
  return count > 0 && utc_s >= this->utc_s(0) && utc_s <= this->utc_s(count - 1);
}

Status add_weather_rule(world::Database& db) {
  const auto& schema = db.schema();
  if (!schema.find_type("Atmosphere") || !schema.find_type("WeatherSeries"))
    return fail(ErrorCode::bad_input, "weather", "define the semantic types before the weather's rules");
  const world::types::Atmosphere a(schema);
  const world::types::WeatherSeries w(schema);
  std::vector<world::AttributeId> writes;
  for (const auto id : schema.attributes(a.type))
    if (is_column(schema, a.type, schema.attribute(id).spec.name)) writes.push_back(id);
  const auto run = [](world::Transaction& tx, std::span<const world::Change>) { return write_weather(tx); };
  if (auto s = db.add_rule({.name = "weather at the hour",
                            .when = {.type = a.type, .attribute = a.utc_s.id},
                            .writes = writes,
                            .run = run});
      !s)
    return s;
  return db.add_rule(
      {.name = "weather as it is tabled", .when = {.type = w.type}, .writes = writes, .run = run});
}

}  // namespace rigor::nature

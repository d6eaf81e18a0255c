// Weather over time: a rule that writes the Atmosphere from a WeatherSeries.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/world/graph/database.h"

namespace rigor::nature {

/// The nodes of a type, in the order of their identifiers.
[[nodiscard]] std::vector<world::NodeId> nodes_by_id(const world::Snapshot& world, world::TypeId type);

/// A series as it is read: names and rows of one time and one value per name, times rising.
struct WeatherTable {
  std::vector<std::string> columns;
  world::Numbers rows;
  [[nodiscard]] std::size_t row_count() const noexcept {
    return columns.empty() ? 0 : rows.size() / (columns.size() + 1);
  }
  [[nodiscard]] double utc_s(std::size_t row) const noexcept { return rows[row * (columns.size() + 1)]; }

  /// Of a WeatherSeries node. bad_input: a column that is no number of the Atmosphere, or is utc_s; a name
  /// twice; numbers that do not fill rows; times that do not rise or are not finite; a value that is NaN.
  [[nodiscard]] static Result<WeatherTable> of(const world::Snapshot& world, world::NodeId series);
  /// Value of a column, linear between rows, held before the first and after the last. Wind directions turn
  /// the short way; ranges of sight are linear in their inverse, which is the extinction, so that infinity
  /// has its place among them; other values that are infinite hold until the next row. Precondition: a row.
  [[nodiscard]] double at(std::size_t column, double utc_s) const;
  [[nodiscard]] bool covers(double utc_s) const noexcept;
};

/// The built-in plugin `weather`: whenever utc_s of the Atmosphere (of the lowest id), or a WeatherSeries,
/// changes, every series is written into the Atmosphere, in the order of their ids. Series that cannot be
/// read are refused with their transaction. Before and after its rows a series holds its first and last
/// values; the atmosphere's provider warns of that. An Atmosphere that is made after its series takes them
/// over with the next of these changes. Errors: bad_input (the rules are there already, the semantic types
/// are not).
[[nodiscard]] Status add_weather_rule(world::Database& db);

}  // namespace rigor::nature

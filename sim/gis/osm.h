// What the tags of OpenStreetMap mean: https://wiki.openstreetmap.org/wiki/Map_features.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/world/graph/value.h"

namespace rigor::gis {

using Tags = std::vector<std::pair<std::string, std::string>>;

/// `"key"=>"value","key"=>"value"`, as GDAL gives the tags that have no column of their own.
[[nodiscard]] Tags parse_hstore(std::string_view text);

/// "12", "12.5 m", "3 km", "40 ft", "7'6\"" in metres; empty where it is none of these.
[[nodiscard]] std::optional<double> osm_length_m(std::string_view text);

enum class Shape : std::uint8_t { point, line, area };

/// What a feature becomes.
struct OsmMeaning {
  std::string
      becomes;  ///< building | road | fence | pole | water | tree; empty: nothing but the cover, if that
  std::string cover;  ///< a cover word for an area; empty: none
  std::vector<std::pair<std::string, world::Value>> attributes = {};
};
[[nodiscard]] OsmMeaning meaning_of(const Tags& tags, Shape shape);

}  // namespace rigor::gis

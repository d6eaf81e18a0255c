#include "sim/gis/osm.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/gis/csv.h"

namespace rigor::gis {
namespace {

struct Word {
  std::string_view value, meaning;
};
struct RoadClass {
  std::string_view highway;
  double width_m;
  std::string_view surface;
};

constexpr RoadClass kRoads[] = {
    {"motorway", 12, "asphalt"},     {"motorway_link", 6, "asphalt"},  {"trunk", 10, "asphalt"},
    {"trunk_link", 6, "asphalt"},    {"primary", 8, "asphalt"},        {"primary_link", 5, "asphalt"},
    {"secondary", 7, "asphalt"},     {"secondary_link", 5, "asphalt"}, {"tertiary", 6, "asphalt"},
    {"tertiary_link", 5, "asphalt"}, {"unclassified", 5, "asphalt"},   {"residential", 5.5, "asphalt"},
    {"living_street", 5, "asphalt"}, {"service", 3.5, "asphalt"},      {"pedestrian", 4, "concrete"},
    {"road", 5, "asphalt"},          {"track", 3, "gravel"},           {"cycleway", 2.5, "asphalt"},
    {"footway", 1.8, "gravel"},      {"bridleway", 2, "soil"},         {"path", 1.2, "soil"},
    {"steps", 1.8, "concrete"}};

constexpr Word kSurfaces[] = {{"asphalt", "asphalt"},
                              {"paved", "asphalt"},
                              {"chipseal", "asphalt"},
                              {"concrete", "concrete"},
                              {"paving_stones", "concrete"},
                              {"sett", "concrete"},
                              {"cobblestone", "concrete"},
                              {"concrete:plates", "concrete"},
                              {"concrete:lanes", "concrete"},
                              {"gravel", "gravel"},
                              {"fine_gravel", "gravel"},
                              {"compacted", "gravel"},
                              {"pebblestone", "gravel"},
                              {"unpaved", "gravel"},
                              {"ground", "soil"},
                              {"dirt", "soil"},
                              {"earth", "soil"},
                              {"mud", "soil"},
                              {"grass", "soil"},
                              {"sand", "soil"}};

constexpr Word kRoofs[] = {{"flat", "flat"},      {"gabled", "gabled"},       {"half-hipped", "hipped"},
                           {"hipped", "hipped"},  {"pyramidal", "pyramidal"}, {"skillion", "shed"},
                           {"gambrel", "gabled"}, {"mansard", "hipped"},      {"saltbox", "gabled"},
                           {"shed", "shed"},      {"lean_to", "shed"},        {"dome", "pyramidal"}};

constexpr std::string_view kGabled[] = {
    "house", "detached", "residential", "terrace", "semidetached_house", "farm",
    "barn",  "church",   "cabin",       "chapel",  "bungalow",           "farm_auxiliary"};

constexpr Word kNatural[] = {{"wood", "forest_floor"}, {"grassland", "meadow"}, {"scrub", "shrub"},
                             {"heath", "shrub"},       {"wetland", "wetland"},  {"sand", "sand"},
                             {"beach", "sand"},        {"bare_rock", "rock"},   {"scree", "gravel"},
                             {"shingle", "gravel"},    {"glacier", "snow"},     {"mud", "soil"},
                             {"fell", "meadow"},       {"moor", "shrub"},       {"water", "water"}};
constexpr Word kLanduse[] = {{"forest", "forest_floor"},
                             {"meadow", "meadow"},
                             {"grass", "grass"},
                             {"village_green", "grass"},
                             {"recreation_ground", "grass"},
                             {"cemetery", "grass"},
                             {"farmland", "crop"},
                             {"orchard", "crop"},
                             {"vineyard", "crop"},
                             {"allotments", "crop"},
                             {"residential", "built_up"},
                             {"commercial", "built_up"},
                             {"retail", "built_up"},
                             {"industrial", "built_up"},
                             {"farmyard", "built_up"},
                             {"quarry", "gravel"},
                             {"construction", "soil"},
                             {"brownfield", "soil"},
                             {"reservoir", "water"},
                             {"basin", "water"},
                             {"railway", "gravel"}};

template <std::size_t N>
std::string_view find(const Word (&table)[N], std::string_view value) {
  for (const Word& w : table)
    if (w.value == value) return w.meaning;
  return {};
}

class TagReader {
 public:
  explicit TagReader(const Tags& tags) : tags_(tags) {}
  [[nodiscard]] std::string_view get(std::string_view key) const {
    for (const auto& [k, v] : tags_)
      if (k == key) return v;
    return {};
  }
  [[nodiscard]] std::optional<double> length_m(std::string_view key) const { return osm_length_m(get(key)); }

 private:
  const Tags& tags_;
};

void read_building(const TagReader& tags, OsmMeaning& m) {
  const auto number = [&](std::string_view key) -> std::optional<double> {
    const auto v = number_of(tags.get(key));
    return v && !std::isnan(*v) ? v : std::nullopt;
  };
  constexpr double kLevel_m = 3;
  std::string_view shape = find(kRoofs, tags.get("roof:shape"));
  if (shape.empty())
    shape = std::find(std::begin(kGabled), std::end(kGabled), tags.get("building")) != std::end(kGabled)
                ? "gabled"
                : "flat";
  m.attributes.emplace_back("roof_shape", std::string(shape));
  double roof_m = shape == "flat" ? 0 : 3;
  if (const auto h = tags.length_m("roof:height"))
    roof_m = *h;
  else if (const auto levels = number("roof:levels"); levels && shape != "flat")
    roof_m = *levels * kLevel_m;
  // `height` counts to the ridge, `building:levels` to the eaves.
  if (const auto h = tags.length_m("height")) {
    roof_m = std::min(roof_m, *h / 2);
    m.attributes.emplace_back("height_m", *h - (shape == "flat" ? 0 : roof_m));
  } else if (const auto levels = number("building:levels")) {
    m.attributes.emplace_back("height_m", *levels * kLevel_m);
  }
  m.attributes.emplace_back("roof_height_m", roof_m);
}

void read_road(const TagReader& tags, OsmMeaning& m) {
  const std::string_view highway = tags.get("highway");
  const auto* road = std::find_if(std::begin(kRoads), std::end(kRoads),
                                  [&](const RoadClass& r) { return r.highway == highway; });
  const std::string_view tunnel = tags.get("tunnel");
  if (road == std::end(kRoads) || (!tunnel.empty() && tunnel != "no") || tags.get("area") == "yes") return;
  m.becomes = "road";
  double width = road->width_m;
  if (const auto w = tags.length_m("width"))
    width = *w;
  else if (const auto lanes = number_of(tags.get("lanes")); lanes && *lanes >= 1)
    width = *lanes * 3.25;
  const std::string_view surface = find(kSurfaces, tags.get("surface"));
  m.attributes.emplace_back("width_m", width);
  m.attributes.emplace_back("surface", std::string(surface.empty() ? road->surface : surface));
}

void read_tree(const TagReader& tags, OsmMeaning& m) {
  m.becomes = "tree";
  for (const char* key : {"species", "genus"})
    if (const auto v = tags.get(key); !v.empty()) {
      m.attributes.emplace_back("species", std::string(v));
      break;
    }
  const auto circumference = tags.length_m("circumference");
  m.attributes.emplace_back("dbh_m", circumference ? *circumference / std::numbers::pi : 0.0);
  if (const auto h = tags.length_m("height")) m.attributes.emplace_back("height_m", *h);
  if (const auto d = tags.length_m("diameter_crown")) m.attributes.emplace_back("crown_radius_m", *d / 2);
}

void read_pole(const TagReader& tags, double height_m, double diameter_m, OsmMeaning& m) {
  m.becomes = "pole";
  m.attributes.emplace_back("height_m", tags.length_m("height").value_or(height_m));
  m.attributes.emplace_back("diameter_m", diameter_m);
}

}  // namespace

Tags parse_hstore(std::string_view text) {
  Tags tags;
  std::size_t at = 0;
  const auto quoted = [&](std::string& out) {
    while (at < text.size() && text[at] != '"') ++at;
    if (at >= text.size()) return false;
    for (++at; at < text.size() && text[at] != '"'; ++at) {
      if (text[at] == '\\' && at + 1 < text.size()) ++at;
      out += text[at];
    }
    return at++ < text.size();
  };
  while (true) {
    std::pair<std::string, std::string> tag;
    if (!quoted(tag.first) || !quoted(tag.second)) return tags;
    tags.push_back(std::move(tag));
  }
}

std::optional<double> osm_length_m(std::string_view text) {
  std::string s(text);
  while (!s.empty() && s.back() == ' ') s.pop_back();
  if (const auto feet = s.find('\''); feet != std::string::npos) {
    std::string inches = s.substr(feet + 1);
    if (inches.ends_with('"')) inches.pop_back();
    const auto f = number_of(s.substr(0, feet)), i = number_of(inches.empty() ? "0" : inches);
    if (!f || !i || std::isnan(*f) || std::isnan(*i)) return std::nullopt;
    return *f * 0.3048 + *i * 0.0254;
  }
  double factor = 1;
  for (const auto& [suffix, metres] :
       {std::pair<std::string_view, double>{"km", 1000}, {"cm", 0.01}, {"ft", 0.3048}, {"m", 1}})
    if (s.ends_with(suffix)) {
      s.resize(s.size() - suffix.size());
      factor = metres;
      break;
    }
  const auto v = number_of(s);
  if (!v || std::isnan(*v) || *v < 0) return std::nullopt;
  return *v * factor;
}

OsmMeaning meaning_of(const Tags& all, Shape shape) {
  const TagReader tags(all);
  OsmMeaning m;
  if (const auto building = tags.get("building");
      !building.empty() && building != "no" && shape == Shape::area) {
    m.becomes = "building";
    read_building(tags, m);
    return m;
  }
  if (shape == Shape::point) {
    if (tags.get("natural") == "tree")
      read_tree(tags, m);
    else if (tags.get("power") == "pole")
      read_pole(tags, 10, 0.25, m);
    else if (tags.get("highway") == "street_lamp")
      read_pole(tags, 6, 0.15, m);
    else if (tags.get("man_made") == "flagpole")
      read_pole(tags, 8, 0.1, m);
    else if (tags.get("man_made") == "utility_pole")
      read_pole(tags, 9, 0.25, m);
    return m;
  }
  if (const auto barrier = tags.get("barrier");
      barrier == "fence" || barrier == "guard_rail" || barrier == "cable_barrier") {
    m.becomes = "fence";
    const auto type = tags.get("fence_type");
    const bool rails = barrier == "guard_rail" || type == "split_rail" || type == "railing" ||
                       type == "metal_bars" || type == "pole";
    m.attributes.emplace_back("style", std::string(type == "wood" || type == "panel" ? "boards"
                                                   : rails                           ? "rails"
                                                                                     : "wire"));
    if (const auto h = tags.length_m("height")) m.attributes.emplace_back("height_m", *h);
    return m;
  }
  if (shape == Shape::line) {
    if (!tags.get("highway").empty()) read_road(tags, m);
    return m;
  }
  m.cover = find(kNatural, tags.get("natural"));
  if (m.cover.empty()) m.cover = find(kLanduse, tags.get("landuse"));
  if (m.cover.empty() && tags.get("waterway") == "riverbank") m.cover = "water";
  if (m.cover.empty() && tags.get("amenity") == "parking") m.cover = "asphalt";
  if (const auto leisure = tags.get("leisure");
      m.cover.empty() && (leisure == "park" || leisure == "pitch" || leisure == "garden"))
    m.cover = "grass";
  if (m.cover == "water") m.becomes = "water";
  return m;
}

}  // namespace rigor::gis

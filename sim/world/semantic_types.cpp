#include "sim/world/semantic_types.h"

#include <array>

#include "rt-core/numbers.h"

namespace rigor::world {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

AttributeSpec text(std::string name, std::string value, std::string meaning,
                   std::vector<std::string> choices = {}) {
  return {.name = std::move(name),
          .default_value = std::move(value),
          .meaning = std::move(meaning),
          .choices = std::move(choices)};
}
AttributeSpec number(std::string name, double value, std::string unit, std::string meaning,
                     double min = -kInf, double max = kInf, bool nan_is_unknown = false) {
  return {.name = std::move(name),
          .default_value = value,
          .unit = std::move(unit),
          .meaning = std::move(meaning),
          .min = min,
          .max = max,
          .nan_is_unknown = nan_is_unknown};
}
AttributeSpec integer(std::string name, std::int64_t value, std::string meaning, double min = -kInf,
                      double max = kInf) {
  return {
      .name = std::move(name), .default_value = value, .meaning = std::move(meaning), .min = min, .max = max};
}
AttributeSpec numbers(std::string name, Numbers value, std::string unit, std::string meaning,
                      double min = -kInf, double max = kInf) {
  return {.name = std::move(name),
          .default_value = std::move(value),
          .unit = std::move(unit),
          .meaning = std::move(meaning),
          .min = min,
          .max = max};
}
AttributeSpec other(std::string name, Value value, std::string unit, std::string meaning,
                    bool transient = false, bool nan_is_unknown = false) {
  return {.name = std::move(name),
          .default_value = std::move(value),
          .unit = std::move(unit),
          .meaning = std::move(meaning),
          .transient = transient,
          .nan_is_unknown = nan_is_unknown};
}

std::vector<AttributeSpec> grid(std::vector<AttributeSpec> rest) {
  std::vector<AttributeSpec> all = {
      integer("columns", 0, "Cells from west to east.", 0, 100'000),
      integer("rows", 0, "Cells from north to south.", 0, 100'000),
      number("x_m", 0, "m", "Centre of the north-western cell, east."),
      number("y_m", 0, "m", "Centre of the north-western cell, north."),
      number("spacing_m", 1, "m", "Between neighbouring centres.", 1e-6, 1e6),
  };
  all.insert(all.end(), rest.begin(), rest.end());
  return all;
}

std::vector<TypeSpec> type_table() {
  const Numbers half(std::vector<double>(kBandCount, 0.5)), none(std::vector<double>(kBandCount, 0.0));
  std::vector<std::string> covers(std::begin(types::kCoverWords), std::end(types::kCoverWords));
  return {
      {.name = "Place",
       .meaning = "Where the world frame stands on the WGS84 ellipsoid.",
       .attributes = {number("latitude_deg", 0, "deg", "Geodetic latitude of the origin.", -90, 90),
                      number("longitude_deg", 0, "deg", "Longitude of the origin.", -180, 180),
                      number("height_m", 0, "m", "Height of the origin above the ellipsoid.", -1e5, 1e6)}},
      {.name = "Frame",
       .meaning = "A node with a frame of its own.",
       .attributes = {other("pose", Pose(Pose::Identity()), "m", "T_parent_node."),
                      other("motion", Motion{}, "m", "Pose as a function of time, where `moves`.", true),
                      other("moves", false, "", "Whether `motion` is in force.", true)},
       .place_attribute = "pose"},
      {.name = "Hinge",
       .base = "Frame",
       .meaning = "Turns about an axis of its own frame through its origin.",
       .attributes = {other("axis", Vector3(0, 0, 1), "", "Unit length, own frame.")}},
      {.name = "Body",
       .base = "Frame",
       .meaning = "A box or a cylinder about the origin of its frame.",
       .attributes = {text("shape", "box", "A cylinder stands along z.", {"box", "cylinder"}),
                      {.name = "size_m",
                       .default_value = Vector3(1, 1, 1),
                       .unit = "m",
                       .meaning = "Full lengths; a cylinder: diameter, diameter, height.",
                       .min = 1e-6,
                       .max = 1e6},
                      integer("chessboard_columns", 0, "Inner corners along x on the +z face; 0: no board.",
                              0, 1000),
                      integer("chessboard_rows", 0, "Inner corners along y.", 0, 1000),
                      number("chessboard_square_m", 0.1, "m", "Side of a square.", 1e-6, 1e3)}},
      {.name = "GroundPlane",
       .base = "Frame",
       .meaning = "A square z = 0 of its frame, in cells of two materials.",
       .attributes = {number("half_extent_m", 100, "m", "From the origin to each side.", 1e-3, 1e6),
                      number("cell_m", 1, "m", "Side of a cell.", 1e-3, 1e6),
                      number("noise_contrast", 0, "", "How much smooth noise darkens it.", 0, 1)}},
      {.name = "Model",
       .base = "Frame",
       .meaning = "Geometry from a file, to the renderer as it is.",
       .attributes = {text("file", "", "glTF, OBJ or what else assimp reads; relative to the world's file."),
                      number("scale", 1, "", "Metres per unit of the file.", 1e-9, 1e9),
                      other("y_up", true, "", "The file's frame is x right, y up, z back, as glTF has it.")}},
      {.name = "Material",
       .meaning = "How a surface reflects light, band by band: 620, 550, 460, 850, 905, 1550 nm.",
       .attributes = {numbers("reflectance", half, "", "Diffuse, per band.", 0, 1),
                      numbers("transmittance", none, "", "Diffuse, through a leaf or pane, per band.", 0, 1),
                      number("roughness", 1, "", "1 matt, towards 0.05 gloss.", 0.01, 1),
                      number("retro_reflection", 0, "", "Share of light returned towards its source.", 0, 1),
                      number("metallic", 0, "", "0 dielectric, 1 metal.", 0, 1),
                      text("colour_map", "", "Picture file; multiplies the visible bands."),
                      text("normal_map", "", "Picture file; tangent space, y up."),
                      text("gloss_map", "", "Picture file; multiplies 1 - roughness."),
                      text("source", "", "Where the numbers come from.")}},
      {.name = "Terrain",
       .meaning = "Heights of the ground.",
       .attributes = grid({other("heights_m", Blob{}, "m", "float32, row by row; NaN: a hole.")})},
      {.name = "LandCover",
       .meaning = "What covers the ground.",
       .attributes = grid({other("cells", Blob{}, "", "One byte a cell, index into classes; 255: unknown."),
                           text("classes", "", "Cover words, separated by one space.")})},
      {.name = "Imagery",
       .meaning = "A picture of the ground from above.",
       .attributes = grid({other("rgb", Blob{}, "", "8-bit sRGB, three bytes a cell.")})},
      {.name = "Tree",
       .meaning = "A tree of an inventory; what is 0 comes from the allometry of its species.",
       .attributes = {other("position", Vector3(0, 0, 0), "m", "Foot of the trunk; z NaN: on the terrain.",
                            false, true),
                      text("species", "", "A code such as TSHE, or a genus; empty: unknown."),
                      number("dbh_m", 0.3, "m", "Diameter at 1.3 m above the ground.", 0, 12),
                      number("height_m", 0, "m", "Of the top above the foot.", 0, 150),
                      number("crown_radius_m", 0, "m", "Widest.", 0, 50),
                      number("crown_base_m", 0, "m", "Lowest green branches above the foot.", 0, 150),
                      number("heading_rad", 0, "rad", "About z."),
                      other("dead", false, "", "A snag: no leaves."),
                      other("marked", false, "", "The forester wants it felled.")},
       .place_attribute = "position"},
      {.name = "Building",
       .meaning = "A footprint that becomes a building.",
       .attributes = {numbers("footprint", {}, "m", "Outer ring x0 y0 x1 y1 ..., not closed, anticlockwise."),
                      numbers("holes", {}, "m", "For each hole: count of numbers, then its ring."),
                      number("base_m", kNaN, "m", "z of the floor; NaN: lowest terrain under it.", -kInf,
                             kInf, true),
                      number("height_m", 6, "m", "Eaves above the base.", 0.1, 1000),
                      text("roof_shape", "flat", "", {"flat", "gabled", "hipped", "pyramidal", "shed"}),
                      number("roof_height_m", 3, "m", "Ridge above eaves.", 0, 100)}},
      {.name = "Road",
       .meaning = "A centre line that becomes a ribbon on the terrain.",
       .attributes = {numbers("line", {}, "m", "x0 y0 x1 y1 ..."), number("width_m", 5, "m", "", 0.1, 100),
                      text("surface", "asphalt", "", {"asphalt", "concrete", "gravel", "soil"})}},
      {.name = "Fence",
       .meaning = "A fence along a line on the terrain.",
       .attributes = {numbers("line", {}, "m", "x0 y0 x1 y1 ..."), number("height_m", 1.2, "m", "", 0.05, 20),
                      number("post_spacing_m", 2.5, "m", "", 0.1, 100),
                      text("style", "wire", "", {"wire", "rails", "boards"})}},
      {.name = "Pole",
       .meaning = "A round pole.",
       .attributes = {other("position", Vector3(0, 0, 0), "m", "Foot; z NaN: on the terrain.", false, true),
                      number("height_m", 8, "m", "", 0.05, 300),
                      number("diameter_m", 0.2, "m", "", 0.005, 10)},
       .place_attribute = "position"},
      {.name = "Water",
       .meaning = "A water surface.",
       .attributes = {numbers("outline", {}, "m", "x0 y0 x1 y1 ..., not closed."),
                      number("level_m", kNaN, "m", "z; NaN: lowest terrain on the outline.", -kInf, kInf,
                             true)}},
      {.name = "GroundVegetation",
       .meaning = "How densely a land cover carries a plant.",
       .attributes = {text("cover", "grass", "The cover that carries it.", covers),
                      text("plant", "grass", "", {"grass", "fern", "shrub", "flower", "litter"}),
                      number("per_m2", 50, "1/m2", "Plants per square metre.", 0, 10'000),
                      number("height_m", 0.15, "m", "Mean.", 0.001, 10),
                      number("height_spread", 0.3, "", "Relative standard deviation.", 0, 1),
                      integer("seed", 1, "Of their places.")}},
      {.name = "Atmosphere",
       .meaning = "Date, time and air.",
       .attributes = {number("utc_s", 1'718'971'200, "s", "Unix time."),
                      number("utc_rate", 0, "", "Seconds of world time per second of bench time."),
                      number("turbidity", 3, "", "2 clear ... 10 hazy.", 1.7, 10),
                      number("cloud_cover", 0, "", "0 ... 1.", 0, 1),
                      number("visibility_m", kInf, "m", "Meteorological range at 550 nm, 2 % contrast.", 1,
                             kInf),
                      number("fog_visibility_m", kInf, "m", "Of a ground fog.", 1, kInf),
                      number("fog_top_m", kInf, "m", "z up to which the fog reaches."),
                      number("rain_mm_per_h", 0, "mm/h", "", 0, 500),
                      number("snow_mm_per_h", 0, "mm/h", "Water equivalent.", 0, 100),
                      number("snow_depth_m", 0, "m", "Lying.", 0, 20),
                      number("wetness", 0, "", "Of surfaces, 0 dry ... 1 wet.", 0, 1),
                      number("wind_speed_m_per_s", 0, "m/s", "", 0, 100),
                      number("wind_from_deg", 270, "deg", "0 north, 90 east."),
                      number("temperature_c", 15, "degC", "", -90, 70),
                      other("fixed_sun", false, "",
                            "The sun stands at the next two, whatever date and place say."),
                      number("sun_azimuth_deg", 180, "deg", "From north over east."),
                      number("sun_elevation_deg", 45, "deg", "", -90, 90)}},
      {.name = "WeatherSeries",
       .meaning = "Weather over time.",
       .attributes = {text("columns", "", "Attribute names of Atmosphere, separated by one space."),
                      numbers("table", {}, "", "Row by row: utc_s, then one value per column.")}},
      {.name = "StudioLight",
       .meaning = "Sun and sky as they are set, whatever date, place and weather say.",
       .attributes = {other("direction_to_sun", Vector3(0, 0, 1), "", "World frame, unit length."),
                      numbers("sun_irradiance_w_per_m2", none, "W/m2", "Square to it, per band.", 0, 1e6),
                      numbers("zenith_radiance_w_per_m2_sr", none, "W/(m2 sr)", "Per band.", 0, 1e6),
                      numbers("horizon_radiance_w_per_m2_sr", none, "W/(m2 sr)", "Per band.", 0, 1e6)}},
      {.name = "Lamp",
       .base = "Frame",
       .meaning = "Shines evenly in all directions from its origin.",
       .attributes = {numbers("radiant_intensity_w_per_sr", none, "W/sr", "Per band.", 0, 1e9)}},
  };
}

std::vector<EdgeSpec> edge_table() {
  using enum Cardinality;
  return {
      {.name = "part_of",
       .targets_per_source = one,
       .acyclic = true,
       .removes_sources = true,
       .meaning = "From a node to the one whose frame it lives in."},
      {.name = "made_of",
       .to = "Material",
       .targets_per_source = one,
       .meaning = "What a body's surface is."},
      {.name = "dark_squares_of",
       .from = "Body",
       .to = "Material",
       .targets_per_source = one,
       .meaning = "The dark squares of its chessboard."},
      {.name = "other_cells_of",
       .from = "GroundPlane",
       .to = "Material",
       .targets_per_source = one,
       .meaning = "Every second cell."},
      {.name = "roof_of",
       .from = "Building",
       .to = "Material",
       .targets_per_source = one,
       .meaning = "What its roof is covered with."},
  };
}

}  // namespace

Status define_semantic_types(Database& db) {
  const auto object = db.schema().require_type("Object");
  if (auto a = db.add_attribute(object, text("name", "", "For people; need not be unique.")); !a)
    return tl::unexpected(a.error());
  for (const auto& spec : type_table())
    if (auto t = db.define(spec); !t) return tl::unexpected(t.error());
  for (const auto& spec : edge_table())
    if (auto e = db.define(spec); !e) return tl::unexpected(e.error());
  return {};
}

namespace types {

Object::Object(const Schema& s, std::string_view type_name)
    : type(s.require_type(type_name)),
      name(s.require<std::string>("Object", "name")),
      part_of(s.require_edge("part_of")),
      made_of(s.require_edge("made_of")) {}

Place::Place(const Schema& s)
    : Object(s, "Place"),
      latitude_deg(s.require<double>("Place", "latitude_deg")),
      longitude_deg(s.require<double>("Place", "longitude_deg")),
      height_m(s.require<double>("Place", "height_m")) {}

Frame::Frame(const Schema& s, std::string_view type_name)
    : Object(s, type_name),
      pose(s.require<Pose>("Frame", "pose")),
      motion(s.require<Motion>("Frame", "motion")),
      moves(s.require<bool>("Frame", "moves")) {}

Hinge::Hinge(const Schema& s) : Frame(s, "Hinge"), axis(s.require<Vector3>("Hinge", "axis")) {}

Body::Body(const Schema& s)
    : Frame(s, "Body"),
      shape(s.require<std::string>("Body", "shape")),
      size_m(s.require<Vector3>("Body", "size_m")),
      chessboard_columns(s.require<std::int64_t>("Body", "chessboard_columns")),
      chessboard_rows(s.require<std::int64_t>("Body", "chessboard_rows")),
      chessboard_square_m(s.require<double>("Body", "chessboard_square_m")),
      dark_squares_of(s.require_edge("dark_squares_of")) {}

GroundPlane::GroundPlane(const Schema& s)
    : Frame(s, "GroundPlane"),
      half_extent_m(s.require<double>("GroundPlane", "half_extent_m")),
      cell_m(s.require<double>("GroundPlane", "cell_m")),
      noise_contrast(s.require<double>("GroundPlane", "noise_contrast")),
      other_cells_of(s.require_edge("other_cells_of")) {}

Model::Model(const Schema& s)
    : Frame(s, "Model"),
      file(s.require<std::string>("Model", "file")),
      scale(s.require<double>("Model", "scale")),
      y_up(s.require<bool>("Model", "y_up")) {}

Material::Material(const Schema& s)
    : Object(s, "Material"),
      reflectance(s.require<Numbers>("Material", "reflectance")),
      transmittance(s.require<Numbers>("Material", "transmittance")),
      roughness(s.require<double>("Material", "roughness")),
      retro_reflection(s.require<double>("Material", "retro_reflection")),
      metallic(s.require<double>("Material", "metallic")),
      colour_map(s.require<std::string>("Material", "colour_map")),
      normal_map(s.require<std::string>("Material", "normal_map")),
      gloss_map(s.require<std::string>("Material", "gloss_map")),
      source(s.require<std::string>("Material", "source")) {}

Terrain::Terrain(const Schema& s)
    : Object(s, "Terrain"),
      columns(s.require<std::int64_t>("Terrain", "columns")),
      rows(s.require<std::int64_t>("Terrain", "rows")),
      x_m(s.require<double>("Terrain", "x_m")),
      y_m(s.require<double>("Terrain", "y_m")),
      spacing_m(s.require<double>("Terrain", "spacing_m")),
      heights_m(s.require<Blob>("Terrain", "heights_m")) {}

LandCover::LandCover(const Schema& s)
    : Object(s, "LandCover"),
      columns(s.require<std::int64_t>("LandCover", "columns")),
      rows(s.require<std::int64_t>("LandCover", "rows")),
      x_m(s.require<double>("LandCover", "x_m")),
      y_m(s.require<double>("LandCover", "y_m")),
      spacing_m(s.require<double>("LandCover", "spacing_m")),
      cells(s.require<Blob>("LandCover", "cells")),
      classes(s.require<std::string>("LandCover", "classes")) {}

Imagery::Imagery(const Schema& s)
    : Object(s, "Imagery"),
      columns(s.require<std::int64_t>("Imagery", "columns")),
      rows(s.require<std::int64_t>("Imagery", "rows")),
      x_m(s.require<double>("Imagery", "x_m")),
      y_m(s.require<double>("Imagery", "y_m")),
      spacing_m(s.require<double>("Imagery", "spacing_m")),
      rgb(s.require<Blob>("Imagery", "rgb")) {}

Tree::Tree(const Schema& s)
    : Object(s, "Tree"),
      position(s.require<Vector3>("Tree", "position")),
      species(s.require<std::string>("Tree", "species")),
      dbh_m(s.require<double>("Tree", "dbh_m")),
      height_m(s.require<double>("Tree", "height_m")),
      crown_radius_m(s.require<double>("Tree", "crown_radius_m")),
      crown_base_m(s.require<double>("Tree", "crown_base_m")),
      heading_rad(s.require<double>("Tree", "heading_rad")),
      dead(s.require<bool>("Tree", "dead")),
      marked(s.require<bool>("Tree", "marked")) {}

Building::Building(const Schema& s)
    : Object(s, "Building"),
      footprint(s.require<Numbers>("Building", "footprint")),
      holes(s.require<Numbers>("Building", "holes")),
      base_m(s.require<double>("Building", "base_m")),
      height_m(s.require<double>("Building", "height_m")),
      roof_shape(s.require<std::string>("Building", "roof_shape")),
      roof_height_m(s.require<double>("Building", "roof_height_m")),
      roof_of(s.require_edge("roof_of")) {}

Road::Road(const Schema& s)
    : Object(s, "Road"),
      line(s.require<Numbers>("Road", "line")),
      width_m(s.require<double>("Road", "width_m")),
      surface(s.require<std::string>("Road", "surface")) {}

Fence::Fence(const Schema& s)
    : Object(s, "Fence"),
      line(s.require<Numbers>("Fence", "line")),
      height_m(s.require<double>("Fence", "height_m")),
      post_spacing_m(s.require<double>("Fence", "post_spacing_m")),
      style(s.require<std::string>("Fence", "style")) {}

Pole::Pole(const Schema& s)
    : Object(s, "Pole"),
      position(s.require<Vector3>("Pole", "position")),
      height_m(s.require<double>("Pole", "height_m")),
      diameter_m(s.require<double>("Pole", "diameter_m")) {}

Water::Water(const Schema& s)
    : Object(s, "Water"),
      outline(s.require<Numbers>("Water", "outline")),
      level_m(s.require<double>("Water", "level_m")) {}

GroundVegetation::GroundVegetation(const Schema& s)
    : Object(s, "GroundVegetation"),
      cover(s.require<std::string>("GroundVegetation", "cover")),
      plant(s.require<std::string>("GroundVegetation", "plant")),
      per_m2(s.require<double>("GroundVegetation", "per_m2")),
      height_m(s.require<double>("GroundVegetation", "height_m")),
      height_spread(s.require<double>("GroundVegetation", "height_spread")),
      seed(s.require<std::int64_t>("GroundVegetation", "seed")) {}

Atmosphere::Atmosphere(const Schema& s)
    : Object(s, "Atmosphere"),
      utc_s(s.require<double>("Atmosphere", "utc_s")),
      utc_rate(s.require<double>("Atmosphere", "utc_rate")),
      turbidity(s.require<double>("Atmosphere", "turbidity")),
      cloud_cover(s.require<double>("Atmosphere", "cloud_cover")),
      visibility_m(s.require<double>("Atmosphere", "visibility_m")),
      fog_visibility_m(s.require<double>("Atmosphere", "fog_visibility_m")),
      fog_top_m(s.require<double>("Atmosphere", "fog_top_m")),
      rain_mm_per_h(s.require<double>("Atmosphere", "rain_mm_per_h")),
      snow_mm_per_h(s.require<double>("Atmosphere", "snow_mm_per_h")),
      snow_depth_m(s.require<double>("Atmosphere", "snow_depth_m")),
      wetness(s.require<double>("Atmosphere", "wetness")),
      wind_speed_m_per_s(s.require<double>("Atmosphere", "wind_speed_m_per_s")),
      wind_from_deg(s.require<double>("Atmosphere", "wind_from_deg")),
      temperature_c(s.require<double>("Atmosphere", "temperature_c")),
      fixed_sun(s.require<bool>("Atmosphere", "fixed_sun")),
      sun_azimuth_deg(s.require<double>("Atmosphere", "sun_azimuth_deg")),
      sun_elevation_deg(s.require<double>("Atmosphere", "sun_elevation_deg")) {}

WeatherSeries::WeatherSeries(const Schema& s)
    : Object(s, "WeatherSeries"),
      columns(s.require<std::string>("WeatherSeries", "columns")),
      table(s.require<Numbers>("WeatherSeries", "table")) {}

StudioLight::StudioLight(const Schema& s)
    : Object(s, "StudioLight"),
      direction_to_sun(s.require<Vector3>("StudioLight", "direction_to_sun")),
      sun_irradiance_w_per_m2(s.require<Numbers>("StudioLight", "sun_irradiance_w_per_m2")),
      zenith_radiance_w_per_m2_sr(s.require<Numbers>("StudioLight", "zenith_radiance_w_per_m2_sr")),
      horizon_radiance_w_per_m2_sr(s.require<Numbers>("StudioLight", "horizon_radiance_w_per_m2_sr")) {}

Lamp::Lamp(const Schema& s)
    : Frame(s, "Lamp"),
      radiant_intensity_w_per_sr(s.require<Numbers>("Lamp", "radiant_intensity_w_per_sr")) {}

}  // namespace types
}  // namespace rigor::world

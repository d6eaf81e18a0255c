// The node and edge types that importers write and that renderers and simulators read: the built-in plugin
// `semantic`. A world frame is local Cartesian: x east, y north, z up, metres, anchored at the world's Place.
//
//   define_semantic_types(db);
//   const types::Tree tree(db.schema());       // resolved handles; cheap to copy
//   snapshot.get(node, tree.dbh_m);
//
// Grids lie row by row from the north-west: cell (column, row) has its centre at
// (x_m + column·spacing_m, y_m − row·spacing_m); `columns`·`rows` cells.
#pragma once

#include "sim/world/graph/database.h"
#include "sim/world/graph/schema.h"

namespace rigor::world {

/// Bands of every reflectance, in this order, with the wavelengths [nm] that stand for them.
inline constexpr int kBandCount = 6;
inline constexpr std::array<double, kBandCount> kBandWavelength_nm = {620, 550, 460, 850, 905, 1550};

/// Precondition: not defined yet. Errors are defects.
[[nodiscard]] Status define_semantic_types(Database& db);

namespace types {

/// Object: the root. `name`: text, need not be unique.
struct Object {
  explicit Object(const Schema& s, std::string_view type_name = "Object");
  TypeId type;
  Attribute<std::string> name;
  EdgeTypeId part_of;  ///< from a node to the one whose frame it lives in; one parent; goes when it goes
  EdgeTypeId made_of;  ///< from a body, model, … to its Material; at most one
};

/// Where the world frame stands on the WGS84 ellipsoid. At most one in a world.
struct Place : Object {
  explicit Place(const Schema& s);
  Attribute<double> latitude_deg, longitude_deg;
  Attribute<double> height_m;  ///< above the ellipsoid
};

/// A node with a frame of its own: `pose` (T_parent_node) and, in a simulation, `motion` (transient).
struct Frame : Object {
  explicit Frame(const Schema& s, std::string_view type_name = "Frame");
  Attribute<Pose> pose;
  Attribute<Motion> motion;  ///< transient; in force where `moves`
  Attribute<bool> moves;     ///< transient
};

/// A Frame that turns about `axis` (own frame, unit length) through its origin by `angle_rad` + `rate`·(t −
/// t_ref).
struct Hinge : Frame {
  explicit Hinge(const Schema& s);
  Attribute<Vector3> axis;
};

/// A box or a cylinder about its frame's origin. Cylinder: along z, size is diameter, diameter, height.
struct Body : Frame {
  explicit Body(const Schema& s);
  Attribute<std::string> shape;  ///< box | cylinder
  Attribute<Vector3> size_m;
  /// Inner corners along x and y, square size, of a chessboard on the +z face; columns 0: none.
  Attribute<std::int64_t> chessboard_columns, chessboard_rows;
  Attribute<double> chessboard_square_m;
  EdgeTypeId dark_squares_of;  ///< to a Material
};

/// A plane square z = 0 of its frame, in cells of two materials, darkened by smooth noise (0 flat … 1).
struct GroundPlane : Frame {
  explicit GroundPlane(const Schema& s);
  Attribute<double> half_extent_m, cell_m, noise_contrast;
  EdgeTypeId other_cells_of;  ///< to a Material
};

/// Way A: geometry that goes to the renderer as it is, from a file that assimp reads (glTF, OBJ).
struct Model : Frame {
  explicit Model(const Schema& s);
  Attribute<std::string> file;  ///< absolute, or relative to the world's file
  Attribute<double> scale;
  Attribute<bool> y_up;  ///< the file's frame is x right, y up, z back, as glTF has it
};

struct Material : Object {
  explicit Material(const Schema& s);
  Attribute<Numbers> reflectance;    ///< kBandCount, diffuse, 0 to 1
  Attribute<Numbers> transmittance;  ///< kBandCount, diffuse, through a leaf or pane; reflectance + this ≤ 1
  Attribute<double> roughness;       ///< 1 matt … 0.05 gloss (GGX, F0 0.04)
  Attribute<double> retro_reflection;  ///< share of light returned towards its source, 0 to 1
  Attribute<double> metallic;          ///< 0 dielectric … 1 metal
  Attribute<std::string> colour_map, normal_map, gloss_map;  ///< picture files; empty: none
  Attribute<std::string> source;                             ///< where the numbers come from
};

/// Heights of the ground.
struct Terrain : Object {
  explicit Terrain(const Schema& s);
  Attribute<std::int64_t> columns, rows;
  Attribute<double> x_m, y_m, spacing_m;
  Attribute<Blob> heights_m;  ///< float32, z in the world frame; NaN: a hole
};
/// What covers the ground: one byte a cell, an index into `classes`; 255: unknown.
struct LandCover : Object {
  explicit LandCover(const Schema& s);
  Attribute<std::int64_t> columns, rows;
  Attribute<double> x_m, y_m, spacing_m;
  Attribute<Blob> cells;
  /// Words of kCoverWords, separated by one space; cell value k is the k-th (from 0).
  Attribute<std::string> classes;
};
inline constexpr std::string_view kCoverWords[] = {
    "water",  "grass", "meadow", "shrub",   "forest_floor", "fern", "soil",    "rock",
    "gravel", "sand",  "snow",   "asphalt", "concrete",     "crop", "wetland", "built_up"};
/// A picture from above, 8-bit sRGB, 3 bytes a cell.
struct Imagery : Object {
  explicit Imagery(const Schema& s);
  Attribute<std::int64_t> columns, rows;
  Attribute<double> x_m, y_m, spacing_m;
  Attribute<Blob> rgb;
};

/// A tree of an inventory. What is 0 comes from the allometry of its species.
struct Tree : Object {
  explicit Tree(const Schema& s);
  Attribute<Vector3> position;     ///< foot of the trunk; z NaN: on the terrain
  Attribute<std::string> species;  ///< a code such as TSHE, or a genus; empty: unknown
  Attribute<double> dbh_m;         ///< diameter at breast height (1.3 m)
  Attribute<double> height_m, crown_radius_m, crown_base_m;
  Attribute<double> heading_rad;  ///< about z
  Attribute<bool> dead;           ///< a snag: no leaves
  Attribute<bool> marked;         ///< the forester wants it felled
};

/// A footprint that becomes a building. Rings: x0 y0 x1 y1 …, not closed, outer ring anticlockwise.
struct Building : Object {
  explicit Building(const Schema& s);
  Attribute<Numbers> footprint;       ///< outer ring, world x y
  Attribute<Numbers> holes;           ///< count of numbers, ring, count, ring …
  Attribute<double> base_m;           ///< z of the floor; NaN: lowest terrain under the footprint
  Attribute<double> height_m;         ///< eaves above the base
  Attribute<std::string> roof_shape;  ///< flat | gabled | hipped | pyramidal | shed
  Attribute<double> roof_height_m;    ///< ridge above eaves
  EdgeTypeId roof_of;                 ///< to a Material; walls are `made_of`
};
/// A centre line that becomes a ribbon on the terrain.
struct Road : Object {
  explicit Road(const Schema& s);
  Attribute<Numbers> line;  ///< x0 y0 x1 y1 …
  Attribute<double> width_m;
  Attribute<std::string> surface;  ///< asphalt | concrete | gravel | soil
};
struct Fence : Object {
  explicit Fence(const Schema& s);
  Attribute<Numbers> line;
  Attribute<double> height_m, post_spacing_m;
  Attribute<std::string> style;  ///< wire | rails | boards
};
struct Pole : Object {
  explicit Pole(const Schema& s);
  Attribute<Vector3> position;  ///< z NaN: on the terrain
  Attribute<double> height_m, diameter_m;
};
/// A water surface.
struct Water : Object {
  explicit Water(const Schema& s);
  Attribute<Numbers> outline;  ///< x0 y0 …
  Attribute<double> level_m;   ///< z; NaN: lowest terrain on the outline
};
/// Plants too many to be nodes: how densely each cover carries them. One node for each cover word that has
/// any.
struct GroundVegetation : Object {
  explicit GroundVegetation(const Schema& s);
  Attribute<std::string> cover;                       ///< one of kCoverWords
  Attribute<std::string> plant;                       ///< grass | fern | shrub | flower | litter
  Attribute<double> per_m2, height_m, height_spread;  ///< spread: relative standard deviation
  Attribute<std::int64_t> seed;
};

/// Date, time and air. At most one in a world.
struct Atmosphere : Object {
  explicit Atmosphere(const Schema& s);
  Attribute<double> utc_s;         ///< Unix time; the sun stands where it then stands over the Place
  Attribute<double> utc_rate;      ///< seconds of world time per second of bench time; 0: time stands still
  Attribute<double> turbidity;     ///< 2 clear … 10 hazy
  Attribute<double> cloud_cover;   ///< 0 … 1
  Attribute<double> visibility_m;  ///< meteorological range (2 % contrast at 550 nm); infinity: no haze
  Attribute<double> fog_visibility_m;              ///< of a ground fog; infinity: none
  Attribute<double> fog_top_m;                     ///< z up to which the fog reaches; infinity: everywhere
  Attribute<double> rain_mm_per_h, snow_mm_per_h;  ///< water equivalent
  Attribute<double> snow_depth_m;                  ///< lying
  Attribute<double> wetness;                       ///< of surfaces, 0 dry … 1 wet
  Attribute<double> wind_speed_m_per_s, wind_from_deg;  ///< from: 0 north, 90 east
  Attribute<double> temperature_c;
  Attribute<bool> fixed_sun;  ///< use the next two in place of date and place (indoor, tests)
  Attribute<double> sun_azimuth_deg, sun_elevation_deg;  ///< azimuth from north over east
};
/// Weather over time; a rule of the weather plugin writes the Atmosphere from it. Rows of utc_s and the
/// columns' values.
struct WeatherSeries : Object {
  explicit WeatherSeries(const Schema& s);
  Attribute<std::string> columns;  ///< attribute names of Atmosphere, separated by one space
  Attribute<Numbers> table;        ///< row by row: utc_s, value, value …
};
/// Sun and sky as they are set, whatever date, place and weather say; goes before an Atmosphere. At most one.
/// The sky's radiance is linear in the sine of the elevation.
struct StudioLight : Object {
  explicit StudioLight(const Schema& s);
  Attribute<Vector3> direction_to_sun;         ///< world frame, unit length
  Attribute<Numbers> sun_irradiance_w_per_m2;  ///< kBandCount, on a plane square to it
  Attribute<Numbers> zenith_radiance_w_per_m2_sr, horizon_radiance_w_per_m2_sr;  ///< kBandCount
};
/// A lamp that shines evenly in all directions, for places indoors.
struct Lamp : Frame {
  explicit Lamp(const Schema& s);
  Attribute<Numbers> radiant_intensity_w_per_sr;  ///< kBandCount
};

}  // namespace types
}  // namespace rigor::world

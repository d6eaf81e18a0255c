#include "sim/gis/import.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "rt-core/numbers.h"
#include "sim/gis/cover.h"
#include "sim/gis/draft.h"
#include "sim/gis/frame.h"
#include "sim/gis/grid.h"
#include "sim/gis/server.h"
#include "sim/gis/shapes.h"
#include "sim/gis/tree_list.h"
#include "sim/gis/vector.h"
#include "sim/gis/write_draft.h"
#include "sim/world/semantic_types.h"

namespace rigor::gis {
namespace {

using Kind = ImportSource::Kind;
using world::Numbers;
using world::Value;

Raster::Use use_of(Kind kind) {
  return kind == Kind::elevation ? Raster::Use::elevation
         : kind == Kind::imagery ? Raster::Use::imagery
                                 : Raster::Use::land_cover;
}
bool is_raster(Kind kind) {
  return kind == Kind::elevation || kind == Kind::imagery || kind == Kind::land_cover;
}

// The middle of a source, if it has a place by itself.
Result<std::optional<GeoPoint>> middle_of_source(const world::Schema& schema, const ImportSource& s) {
  using Maybe = std::optional<GeoPoint>;
  if (s.kind == Kind::weather || s.crs == "local" || is_server(s.location)) return Maybe();
  if (is_raster(s.kind)) {
    auto r = Raster::open(s.location, s, use_of(s.kind));
    if (!r) return tl::unexpected(r.error());
    return Maybe((*r)->centre());
  }
  std::vector<GeoPoint> places;
  if (s.kind == Kind::vector) {
    auto data = read_vector(s.location, s, std::nullopt);
    if (!data) return tl::unexpected(data.error());
    places = places_of(*data);
  } else {
    auto list = read_trees(schema, s);
    if (!list) return tl::unexpected(list.error());
    for (const auto& t : list->trees) places.push_back(t.place);
  }
  if (places.empty()) return Maybe();
  return Maybe(middle_of(places));
}

class Import {
 public:
  Import(const world::Database& db, const ImportPlan& plan)
      : world_(db.snapshot()), schema_(world_.schema()), plan_(plan) {}

  Status read() {
    if (plan_.half_extent_m && !(*plan_.half_extent_m > 0))
      return fail(ErrorCode::bad_input, "half_extent_m", "expected a length above 0");
    if (plan_.sources.empty())
      return fail(ErrorCode::bad_input, "sources", "expected at least one source, got none");
    for (const auto& step :
         {&Import::find_anchor, &Import::open_rasters, &Import::make_ground, &Import::read_vectors,
          &Import::read_tree_lists, &Import::read_weathers, &Import::make_cover, &Import::make_imagery})
      if (auto s = (this->*step)(); !s) return s;
    assemble();
    return {};
  }
  [[nodiscard]] const std::vector<DraftNode>& nodes() const { return nodes_; }
  ImportReport report;

 private:
  Status find_anchor();
  Status open_rasters();
  Status make_ground();
  [[nodiscard]] Status no_extent(const Grid& grid) const;
  Status read_vectors();
  Status read_tree_lists();
  Status read_weathers();
  Status make_cover();
  Status make_imagery();
  void assemble();
  Result<std::string> local_file(const ImportSource& s);
  std::optional<Domain> domain() const {
    if (!plan_.half_extent_m) return std::nullopt;
    return Domain{frame_.get(), *plan_.half_extent_m};
  }
  void tell(std::string_view what, double share) const {
    if (plan_.progress) plan_.progress(what, std::min(1.0, share));
  }
  Progress part(std::string what, double from, double to) const {
    return [this, what = std::move(what), from, to](double d) { tell(what, from + d * (to - from)); };
  }
  static DraftNode grid_node(const char* type, const Grid& g) {
    return {type,
            {{"columns", g.columns},
             {"rows", g.rows},
             {"x_m", g.x_m},
             {"y_m", g.y_m},
             {"spacing_m", g.spacing_m}}};
  }

  const world::Snapshot world_;
  const world::Schema& schema_;
  const ImportPlan& plan_;
  bool new_place_ = true;
  Anchor anchor_;
  std::unique_ptr<LocalFrame> frame_;
  std::unique_ptr<Ground> ground_;
  Rasters elevation_, imagery_, cover_;
  std::vector<CoverClasses> cover_classes_;
  std::vector<int> cover_source_;
  bool has_terrain_ = false;
  Draft draft_;
  std::vector<DraftNode> grids_, series_, nodes_;
  std::vector<std::uint8_t> covers_seen_;
  std::optional<DraftNode> first_weather_;
};

Status Import::find_anchor() {
  const world::types::Place place(schema_);
  if (const auto there = world_.nodes(place.type); !there.empty()) {
    new_place_ = false;
    anchor_ = {world_.get_or_default(there[0], place.latitude_deg),
               world_.get_or_default(there[0], place.longitude_deg),
               world_.get_or_default(there[0], place.height_m)};
    if (plan_.anchor) {
      const Anchor& a = *plan_.anchor;
      if (a.latitude_deg != anchor_.latitude_deg || a.longitude_deg != anchor_.longitude_deg ||
          (!std::isnan(a.height_m) && a.height_m != anchor_.height_m))
        return fail(
            ErrorCode::bad_input, "anchor",
            fmt::format(
                "expected the anchor that the world has ({}, {}, {} m), got {}, {}, {} m: leave it out",
                anchor_.latitude_deg, anchor_.longitude_deg, anchor_.height_m, a.latitude_deg,
                a.longitude_deg, a.height_m));
    }
  } else if (plan_.anchor) {
    auto a = checked(*plan_.anchor, "anchor");
    if (!a) return tl::unexpected(a.error());
    anchor_ = *a;
  } else {
    bool found = false;
    for (const ImportSource& s : plan_.sources) {
      auto middle = middle_of_source(schema_, s);
      if (!middle) return tl::unexpected(middle.error());
      if (!*middle) continue;
      auto a = checked({(*middle)->latitude_deg, (*middle)->longitude_deg, kNaN}, s.location);
      if (!a) return tl::unexpected(a.error());
      anchor_ = *a;
      found = true;
      break;
    }
    if (!found)
      return fail(ErrorCode::bad_input, "anchor",
                  "expected an anchor, or a source that has a place by itself; got neither");
  }
  Anchor flat = anchor_;
  if (std::isnan(flat.height_m)) flat.height_m = 0;
  frame_ = std::make_unique<LocalFrame>(flat);
  return {};
}

Result<std::string> Import::local_file(const ImportSource& s) {
  if (!is_server(s.location)) return s.location;
  tell("asking " + s.location, 0);
  auto fetched = fetch(
      s, domain(),
      {.cache_dir = plan_.cache_dir, .timeout_s = plan_.server_timeout_s, .spacing_m = plan_.spacing_m});
  if (!fetched) return tl::unexpected(fetched.error());
  report.lines.push_back(s.location + (fetched->from_cache ? ": from the cache" : ": from the server"));
  return fetched->file;
}

Status Import::open_rasters() {
  int rank = 0;
  for (const ImportSource& s : plan_.sources) {
    ++rank;
    if (!is_raster(s.kind)) continue;
    auto file = local_file(s);
    if (!file) return tl::unexpected(file.error());
    ImportSource local = s;
    if (is_server(s.location)) local.crs.clear();  // the answer says its own
    auto r = Raster::open(*file, local, use_of(s.kind));
    if (!r) return tl::unexpected(r.error());
    report.warnings.insert(report.warnings.end(), (*r)->warnings().begin(), (*r)->warnings().end());
    if (s.kind == Kind::land_cover) {
      auto classes = CoverClasses::make(s, (*r)->categories(), s.location);
      if (!classes) return tl::unexpected(classes.error());
      cover_classes_.push_back(std::move(*classes));
      cover_source_.push_back(rank);
    }
    (s.kind == Kind::elevation ? elevation_
     : s.kind == Kind::imagery ? imagery_
                               : cover_)
        .push_back(std::move(*r));
  }
  return {};
}

// A surface needs points on two sides: one row or column of them spans nothing.
Status Import::no_extent(const Grid& grid) const {
  const Raster& first = *elevation_.front();
  const std::string extent =
      plan_.half_extent_m
          ? fmt::format("the wanted extent is {:g} m on each side of the anchor", *plan_.half_extent_m)
          : "the sources themselves reach no further";
  return fail(
      ErrorCode::bad_input, first.file(),
      fmt::format(
          "expected elevation that makes a terrain of at least 2 x 2 points, got {} x {} points {:g} m "
          "apart: the raster's cells are {:g} m, and {}; give {}",
          grid.columns, grid.rows, grid.spacing_m, first.pixel_m(), extent,
          plan_.half_extent_m ? "a larger half_extent_m, or a smaller spacing_m"
                              : "a raster of more cells, or half_extent_m and spacing_m"));
}

Status Import::make_ground() {
  if (std::isnan(anchor_.height_m)) {
    anchor_.height_m = 0;
    if (!elevation_.empty()) {
      Ground g(*frame_);
      g.use(&elevation_);
      const GeoPoint here{anchor_.latitude_deg, anchor_.longitude_deg, 0};
      double h = 0;
      if (auto s = g.heights_at({&here, 1}, {&h, 1}); !s) return s;
      // A centimetre is as much as anyone wants to read in a world's file.
      anchor_.height_m = std::round(h * 100) / 100;
    }
    frame_ = std::make_unique<LocalFrame>(anchor_);
  }
  report.anchor = anchor_;
  ground_ = std::make_unique<Ground>(*frame_);
  if (!elevation_.empty()) {
    auto grid = plan_grid(*frame_, elevation_, plan_.half_extent_m, plan_.spacing_m);
    if (!grid) return tl::unexpected(grid.error());
    if (grid->columns < 2 || grid->rows < 2) return no_extent(*grid);
    ground_->use(&elevation_);
    auto z = ground_->z_grid(*grid, part("elevation", 0, 0.3));
    if (!z) return tl::unexpected(z.error());
    const auto holes =
        static_cast<std::size_t>(std::count_if(z->begin(), z->end(), [](float v) { return std::isnan(v); }));
    if (holes == z->size())
      return fail(
          ErrorCode::bad_input, elevation_.front()->file(),
          "expected elevation within the extent, got none there: does the source lie around the anchor?");
    if (holes > 0)
      report.warnings.push_back(
          fmt::format("elevation: {} of {} cells have no data and are holes", holes, z->size()));
    report.lines.push_back(fmt::format("terrain: {} x {} cells of {} m from {} source{}", grid->columns,
                                       grid->rows, grid->spacing_m, elevation_.size(),
                                       elevation_.size() == 1 ? "" : "s"));
    DraftNode node = grid_node("Terrain", *grid);
    node.attributes.emplace_back("heights_m", world::Blob::of<float>(*z));
    grids_.push_back(std::move(node));
    ground_->keep(*grid, std::move(*z));
    has_terrain_ = true;
    return {};
  }
  const world::types::Terrain terrain(schema_);
  if (const auto there = world_.nodes(terrain.type); !there.empty()) {
    const auto n = there.back();
    const Grid grid{*world_.get(n, terrain.columns), *world_.get(n, terrain.rows),
                    *world_.get(n, terrain.x_m), *world_.get(n, terrain.y_m),
                    *world_.get(n, terrain.spacing_m)};
    const auto z = world_.get(n, terrain.heights_m)->as<float>();
    if (z.size() == grid.cells() && !z.empty()) {
      ground_->keep(grid, {z.begin(), z.end()});
      has_terrain_ = true;
    }
  }
  return {};
}

Status Import::read_vectors() {
  int rank = 0;
  for (const ImportSource& s : plan_.sources) {
    ++rank;
    if (s.kind != Kind::vector) continue;
    tell(s.location, 0.3);
    auto file = local_file(s);
    if (!file) return tl::unexpected(file.error());
    ImportSource local = s;
    if (is_server(s.location)) local.layer.clear(), local.crs.clear();
    auto data = read_vector(*file, local, domain());
    if (!data) return tl::unexpected(data.error());
    if (is_server(s.location)) data->where = s.location + ": layer " + s.layer;
    if (auto done =
            add_features(schema_, std::move(*data), s, *ground_,
                         {.half_extent_m = plan_.half_extent_m, .has_terrain = has_terrain_, .source = rank},
                         draft_, report.lines, report.warnings);
        !done)
      return done;
  }
  return {};
}

Status Import::read_tree_lists() {
  for (const ImportSource& s : plan_.sources) {
    if (s.kind != Kind::trees) continue;
    tell(s.location, 0.5);
    auto list = read_trees(schema_, s);
    if (!list) return tl::unexpected(list.error());
    report.warnings.insert(report.warnings.end(), list->warnings.begin(), list->warnings.end());
    if (auto done = add_trees(*list, *ground_, plan_.half_extent_m, has_terrain_, draft_, report.lines);
        !done)
      return done;
  }
  return {};
}

Status Import::read_weathers() {
  for (const ImportSource& s : plan_.sources) {
    if (s.kind != Kind::weather) continue;
    auto weather = read_weather(schema_, s);
    if (!weather) return tl::unexpected(weather.error());
    report.warnings.insert(report.warnings.end(), weather->warnings.begin(), weather->warnings.end());
    report.lines.push_back(fmt::format("{}: {} rows of weather", s.location, weather->rows()));
    std::string columns;
    for (const auto& c : weather->columns) columns += (columns.empty() ? "" : " ") + c;
    if (!first_weather_) {
      first_weather_ = DraftNode{"Atmosphere", {{"utc_s", weather->table[0]}}};
      for (std::size_t i = 0; i < weather->columns.size(); ++i)
        first_weather_->attributes.emplace_back(weather->columns[i], weather->table[i + 1]);
    }
    series_.push_back(
        {"WeatherSeries", {{"columns", columns}, {"table", Numbers(std::move(weather->table))}}});
  }
  return {};
}

Status Import::make_cover() {
  if (cover_.empty() && draft_.areas.empty()) return {};
  Grid grid;
  if (cover_.empty() && !plan_.half_extent_m) {
    // Areas alone: a grid that holds them.
    double west = 1e300, east = -1e300, south = 1e300, north = -1e300;
    for (const auto& area : draft_.areas)
      for (std::size_t i = 0; i + 1 < area.rings[0].size(); i += 2) {
        west = std::min(west, area.rings[0][i]), east = std::max(east, area.rings[0][i]);
        south = std::min(south, area.rings[0][i + 1]), north = std::max(north, area.rings[0][i + 1]);
      }
    const double s = plan_.spacing_m > 0 ? plan_.spacing_m : 1;
    grid.spacing_m = s;
    grid.x_m = std::floor(west / s) * s;
    grid.y_m = std::ceil(north / s) * s;
    const double columns = std::ceil((east - grid.x_m) / s) + 1, rows = std::ceil((grid.y_m - south) / s) + 1;
    if (columns * rows > 64e6 || columns > 100'000 || rows > 100'000)
      return fail(ErrorCode::bad_input, "land cover",
                  fmt::format("expected a grid of at most 64 million cells, the areas need {:.0f} x {:.0f}: "
                              "give half_extent_m "
                              "or a coarser spacing_m",
                              columns, rows));
    grid.columns = static_cast<std::int64_t>(columns);
    grid.rows = static_cast<std::int64_t>(rows);
  } else {
    auto g = plan_grid(*frame_, cover_, plan_.half_extent_m, plan_.spacing_m);
    if (!g) return tl::unexpected(g.error());
    grid = *g;
  }
  std::vector<std::uint8_t> cells(grid.cells(), kUnknownCover);
  std::vector<int> source(grid.cells(), std::numeric_limits<int>::max());
  if (!cover_.empty()) {
    auto values = cover_grid(grid, *ground_, cover_, part("land cover", 0.5, 0.7));
    if (!values) return tl::unexpected(values.error());
    std::map<std::pair<int, float>, std::size_t> strangers;
    for (std::size_t i = 0; i < cells.size(); ++i) {
      const CoverCell& v = (*values)[i];
      if (v.raster < 0) continue;
      const auto& classes = cover_classes_[static_cast<std::size_t>(v.raster)];
      if (!classes.knows(v.value)) ++strangers[{v.raster, v.value}];
      cells[i] = classes.word(v.value);
      if (cells[i] != kUnknownCover) source[i] = cover_source_[static_cast<std::size_t>(v.raster)];
    }
    for (const auto& [key, n] : strangers)
      report.warnings.push_back(fmt::format("{}: value {} has no class; {} cells are unknown",
                                            cover_[static_cast<std::size_t>(key.first)]->file(), key.second,
                                            n));
  }
  burn(draft_.areas, grid, cells, source);
  // Words that occur, in the order of kCoverWords.
  std::array<bool, 256> seen{};
  for (const auto c : cells) seen[c] = true;
  std::array<std::uint8_t, 256> index;
  index.fill(kUnknownCover);
  std::string classes;
  for (std::size_t w = 0; w < std::size(world::types::kCoverWords); ++w) {
    if (!seen[w]) continue;
    index[w] = static_cast<std::uint8_t>(covers_seen_.size());
    covers_seen_.push_back(static_cast<std::uint8_t>(w));
    classes += (classes.empty() ? "" : " ") + std::string(world::types::kCoverWords[w]);
  }
  std::size_t unknown = 0;
  for (auto& c : cells) {
    c = index[c];
    unknown += c == kUnknownCover;
  }
  report.lines.push_back(fmt::format("land cover: {} x {} cells of {} m: {}{}", grid.columns, grid.rows,
                                     grid.spacing_m, classes.empty() ? "nothing known" : classes,
                                     unknown > 0 ? fmt::format("; {} cells unknown", unknown) : ""));
  DraftNode node = grid_node("LandCover", grid);
  node.attributes.emplace_back("cells", world::Blob::of<std::uint8_t>(cells));
  node.attributes.emplace_back("classes", classes);
  grids_.push_back(std::move(node));
  return {};
}

Status Import::make_imagery() {
  if (imagery_.empty()) return {};
  auto grid = plan_grid(*frame_, imagery_, plan_.half_extent_m, plan_.spacing_m);
  if (!grid) return tl::unexpected(grid.error());
  auto rgb = picture_grid(*grid, *ground_, imagery_, part("imagery", 0.7, 0.95));
  if (!rgb) return tl::unexpected(rgb.error());
  std::size_t empty = 0;
  for (std::size_t i = 0; i < rgb->size(); i += 3)
    empty += (*rgb)[i] == std::byte{0} && (*rgb)[i + 1] == std::byte{0} && (*rgb)[i + 2] == std::byte{0};
  if (empty == grid->cells())
    return fail(
        ErrorCode::bad_input, imagery_.front()->file(),
        "expected a picture within the extent, got none there: does the source lie around the anchor?");
  if (empty > 0)
    report.warnings.push_back(
        fmt::format("imagery: {} of {} cells have no picture and are black", empty, grid->cells()));
  report.lines.push_back(fmt::format("imagery: {} x {} cells of {} m from {} source{}", grid->columns,
                                     grid->rows, grid->spacing_m, imagery_.size(),
                                     imagery_.size() == 1 ? "" : "s"));
  DraftNode node = grid_node("Imagery", *grid);
  node.attributes.emplace_back("rgb", world::Blob(std::move(*rgb)));
  grids_.push_back(std::move(node));
  return {};
}

void Import::assemble() {
  if (new_place_)
    nodes_.push_back({"Place",
                      {{"latitude_deg", anchor_.latitude_deg},
                       {"longitude_deg", anchor_.longitude_deg},
                       {"height_m", anchor_.height_m}}});
  if (world_.count(schema_.require_type("Atmosphere")) == 0) {
    DraftNode air = first_weather_.value_or(DraftNode{"Atmosphere", {}});
    if (plan_.utc_s || !first_weather_) {
      // 10 o'clock by the sun on the longest day of 2024: 20 June in the north, 21 December in the south.
      const double day = anchor_.latitude_deg >= 0 ? 1'718'841'600 : 1'734'739'200;
      air.attributes.emplace_back(
          "utc_s", plan_.utc_s.value_or(std::round(day + (10 - anchor_.longitude_deg / 15) * 3600)));
    }
    nodes_.push_back(std::move(air));
  }
  std::move(grids_.begin(), grids_.end(), std::back_inserter(nodes_));
  const world::types::GroundVegetation vegetation(schema_);
  for (const std::uint8_t w : covers_seen_) {
    const std::string word(world::types::kCoverWords[w]);
    if (!world_.find_equal(vegetation.type, vegetation.cover.id, Value(word)).empty()) continue;
    if (auto node = vegetation_of(w)) nodes_.push_back(std::move(*node));
  }
  std::move(draft_.nodes.begin(), draft_.nodes.end(), std::back_inserter(nodes_));
  std::move(series_.begin(), series_.end(), std::back_inserter(nodes_));
}

}  // namespace

Result<ImportReport> import_into(world::Database& db, const ImportPlan& plan) {
  Import import(db, plan);
  if (auto s = import.read(); !s) return tl::unexpected(s.error());
  if (plan.progress) plan.progress("writing", 0.95);
  if (auto s = write_draft(db, import.nodes(), "import"); !s) return tl::unexpected(s.error());
  import.report.nodes = import.nodes().size();
  if (plan.progress) plan.progress("done", 1);
  return std::move(import.report);
}

}  // namespace rigor::gis

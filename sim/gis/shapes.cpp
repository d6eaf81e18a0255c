#include "sim/gis/shapes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "sim/gis/osm.h"
#include "sim/world/semantic_types.h"

namespace rigor::gis {
namespace {

using world::Value;
using world::Vector3;
constexpr double kFar_m = 1e8;         // a vertex on the other side of the earth is put here
constexpr double kSmallest_m2 = 0.01;  // of an area that means anything

// Longitude and latitude to x, y of the world frame, at the height of the ground.
class ToWorld : public OGRCoordinateTransformation {
 public:
  explicit ToWorld(const Ground& ground) : ground_(ground) {}
  OGRSpatialReference* GetSourceCS() override { return nullptr; }
  OGRSpatialReference* GetTargetCS() override { return nullptr; }
  OGRCoordinateTransformation* Clone() const override { return new ToWorld(ground_); }
  OGRCoordinateTransformation* GetInverse() const override { return nullptr; }
  int Transform(int count, double* x, double* y, double*, double*, int* success) override {
    const auto n = static_cast<std::size_t>(count);
    places_.resize(n), heights_.resize(n);
    for (std::size_t i = 0; i < n; ++i) places_[i] = {y[i], x[i], 0};
    if (auto s = ground_.heights_at(places_, heights_); !s) status = s;
    for (std::size_t i = 0; i < n; ++i) {
      places_[i].height_m = heights_[i];
      const Vector3 v = ground_.frame().to_world(places_[i]);
      const bool below = v.z() < -3e6;
      x[i] = below ? std::copysign(kFar_m, v.x()) : v.x();
      y[i] = below ? std::copysign(kFar_m, v.y()) : v.y();
      if (success) success[i] = TRUE;
    }
    return TRUE;
  }
  using OGRCoordinateTransformation::Transform;
  Status status;

 private:
  const Ground& ground_;
  std::vector<GeoPoint> places_;
  std::vector<double> heights_;
};

using Geometry = std::unique_ptr<OGRGeometry>;

std::unique_ptr<OGRPolygon> box_of(double half_extent_m) {
  auto ring = std::make_unique<OGRLinearRing>();
  const double h = half_extent_m;
  for (const auto& [x, y] : {std::pair{-h, -h}, {h, -h}, {h, h}, {-h, h}, {-h, -h}}) ring->addPoint(x, y);
  auto box = std::make_unique<OGRPolygon>();
  box->addRingDirectly(ring.release());
  return box;
}

// Single points, lines or polygons of a geometry, in order.
template <class T, class Visit>
void each(const OGRGeometry& g, Visit&& visit) {
  if (const auto* one = dynamic_cast<const T*>(&g))
    visit(*one);
  else if (const auto* many = dynamic_cast<const OGRGeometryCollection*>(&g))
    for (const OGRGeometry* part : *many) each<T>(*part, visit);
}

std::optional<Shape> shape_of(const OGRGeometry& g) {
  switch (g.getDimension()) {
    case 0:
      return Shape::point;
    case 1:
      return Shape::line;
    case 2:
      return Shape::area;
    default:
      return std::nullopt;
  }
}

// x0 y0 x1 y1 … without neighbours that coincide; `closed`: the last point repeats the first and goes.
std::vector<double> points_of(const OGRSimpleCurve& curve, bool closed) {
  std::vector<double> out;
  out.reserve(static_cast<std::size_t>(curve.getNumPoints()) * 2);
  for (int i = 0; i < curve.getNumPoints(); ++i) {
    const double x = curve.getX(i), y = curve.getY(i);
    if (const auto n = out.size(); n >= 2 && std::hypot(out[n - 2] - x, out[n - 1] - y) < 1e-6) continue;
    out.push_back(x), out.push_back(y);
  }
  while (closed && out.size() > 2 && std::hypot(out[0] - out[out.size() - 2], out[1] - out.back()) < 1e-6)
    out.resize(out.size() - 2);
  return out;
}

double signed_area_m2(const std::vector<double>& ring) {
  double twice = 0;
  for (std::size_t i = 0; i < ring.size(); i += 2) {
    const std::size_t j = (i + 2) % ring.size();
    twice += (ring[i] - ring[0]) * (ring[j + 1] - ring[1]) - (ring[j] - ring[0]) * (ring[i + 1] - ring[1]);
  }
  return twice / 2;
}

void turn(std::vector<double>& ring, bool anticlockwise) {
  if ((signed_area_m2(ring) > 0) == anticlockwise) return;
  std::vector<double> out;
  for (std::size_t i = ring.size(); i > 0; i -= 2) out.push_back(ring[i - 2]), out.push_back(ring[i - 1]);
  ring = std::move(out);
}

class Builder {
 public:
  Builder(const world::Schema& schema, const Ground& ground, const ImportSource& source,
          const ShapeOptions& options, Draft& draft)
      : schema_(schema), ground_(ground), source_(source), options_(options), draft_(draft) {
    if (options.half_extent_m) box_ = box_of(*options.half_extent_m);
  }

  Status add(const VectorData& data, Feature& feature);
  Status finish(const VectorData& data);
  Complaints complaints;
  std::map<std::string, std::size_t> made;
  std::size_t outside = 0;

 private:
  using Attributes = std::vector<std::pair<std::string, Value>>;
  Result<ColumnMapping*> mapping(const VectorData& data, const std::string& type);
  Result<Attributes> attributes(const VectorData& data, const Feature& f, const std::string& type,
                                Attributes base, double* foot_height_m);
  Geometry cut(const OGRGeometry& g) const;
  Geometry mended(const OGRGeometry& g, const std::string& place);
  bool inside(double x, double y) const {
    return !options_.half_extent_m ||
           (std::abs(x) <= *options_.half_extent_m && std::abs(y) <= *options_.half_extent_m);
  }
  void count(const std::string& what) { ++made[what]; }
  void add_buildings(const OGRGeometry& g, const Feature& f, const Attributes& a);
  void add_lines(const OGRGeometry& g, const std::string& type, const Feature& f, const Attributes& a);
  void add_points(const OGRGeometry& g, const std::string& type, const GeoPoint* exact, const Attributes& a);
  void add_water(const OGRGeometry& g, const Feature& f, const Attributes& a);
  void add_cover(const OGRGeometry& g, std::uint8_t word);

  const world::Schema& schema_;
  const Ground& ground_;
  const ImportSource& source_;
  const ShapeOptions& options_;
  Draft& draft_;
  std::unique_ptr<OGRPolygon> box_;
  std::map<std::string, ColumnMapping> mappings_;
};

std::string type_of(const std::string& becomes) {
  std::string type = becomes;
  type[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(type[0])));
  return type;
}

Result<ColumnMapping*> Builder::mapping(const VectorData& data, const std::string& type) {
  if (const auto it = mappings_.find(type); it != mappings_.end()) return &it->second;
  std::vector<std::string> extra;
  if (type == "Tree" || type == "Pole") extra.emplace_back("foot_height_m");
  auto m = ColumnMapping::make(schema_, type, source_.columns, data.columns, extra, data.where);
  if (!m) return tl::unexpected(m.error());
  return &mappings_.emplace(type, std::move(*m)).first->second;
}

Result<Builder::Attributes> Builder::attributes(const VectorData& data, const Feature& f,
                                                const std::string& type, Attributes base,
                                                double* foot_height_m) {
  const auto id = schema_.require_type(type);
  std::erase_if(base, [&](const auto& entry) {
    const auto a = schema_.find_attribute(id, entry.first);
    const auto* v = std::get_if<double>(&entry.second);
    if (!a || !v) return !a;
    const auto& spec = schema_.attribute(*a).spec;
    if (*v >= spec.min && *v <= spec.max) return false;
    complaints.add(fmt::format("{} lies outside of {} … {}; left unknown", entry.first, spec.min, spec.max),
                   f.place);
    return true;
  });
  auto m = mapping(data, type);
  if (!m) return tl::unexpected(m.error());
  for (auto& entry : (*m)->entries()) {
    auto v = (*m)->value(
        entry, [&](const std::string& column) { return f.field(column); }, f.place, complaints);
    if (!v) return tl::unexpected(v.error());
    if (!*v) continue;
    if (entry.attribute == "foot_height_m")
      *foot_height_m = std::get<double>(**v);
    else
      base.emplace_back(entry.attribute, std::move(**v));
  }
  return base;
}

Geometry Builder::cut(const OGRGeometry& g) const {
  OGREnvelope e;
  g.getEnvelope(&e);
  if (!box_ || (inside(e.MinX, e.MinY) && inside(e.MaxX, e.MaxY))) return Geometry(g.clone());
  GdalMessages messages;
  return Geometry(g.Intersection(box_.get()));
}

Geometry Builder::mended(const OGRGeometry& g, const std::string& place) {
  GdalMessages messages;
  if (g.IsValid()) return Geometry(g.clone());
  Geometry valid(g.MakeValid());
  if (!valid || valid->IsEmpty()) {
    complaints.add("an outline that cannot be mended left out: " + messages.text(), place);
    return nullptr;
  }
  complaints.add("an outline that crosses or touches itself was mended", place);
  return valid;
}

void Builder::add_buildings(const OGRGeometry& g, const Feature& f, const Attributes& a) {
  const Geometry valid = mended(g, f.place);
  if (!valid) return;
  bool any = false;
  each<OGRPolygon>(*valid, [&](const OGRPolygon& p) {
    if (!p.getExteriorRing()) return;
    std::vector<double> outer = points_of(*p.getExteriorRing(), true);
    if (outer.size() < 6 || std::abs(signed_area_m2(outer)) < kSmallest_m2) return;
    any = true;
    OGRPoint centre;
    GdalMessages messages;
    if (p.Centroid(&centre) != OGRERR_NONE || !inside(centre.getX(), centre.getY())) {
      ++outside;
      return;
    }
    turn(outer, true);
    std::vector<double> holes;
    for (int i = 0; i < p.getNumInteriorRings(); ++i) {
      std::vector<double> hole = points_of(*p.getInteriorRing(i), true);
      if (hole.size() < 6 || std::abs(signed_area_m2(hole)) < kSmallest_m2) continue;
      turn(hole, false);
      holes.push_back(static_cast<double>(hole.size()));
      holes.insert(holes.end(), hole.begin(), hole.end());
    }
    DraftNode node{"Building", a};
    node.attributes.emplace_back("footprint", world::Numbers(std::move(outer)));
    if (!holes.empty()) node.attributes.emplace_back("holes", world::Numbers(std::move(holes)));
    draft_.nodes.push_back(std::move(node));
    count("building");
  });
  if (!any) complaints.add("a footprint without an area left out", f.place);
}

void Builder::add_lines(const OGRGeometry& g, const std::string& type, const Feature& f,
                        const Attributes& a) {
  Geometry lines;
  if (g.getDimension() == 2) {  // a fence around something
    GdalMessages messages;
    lines.reset(g.Boundary());
  } else {
    lines.reset(g.clone());
  }
  if (!lines) return;
  const Geometry kept = cut(*lines);
  bool any = false;
  if (kept)
    each<OGRLineString>(*kept, [&](const OGRLineString& line) {
      std::vector<double> points = points_of(line, false);
      if (points.size() < 4) return;
      any = true;
      DraftNode node{type_of(type), a};
      node.attributes.emplace_back("line", world::Numbers(std::move(points)));
      draft_.nodes.push_back(std::move(node));
      count(type);
    });
  if (any) return;
  if (kept && !kept->IsEmpty())
    complaints.add("a line without a length left out", f.place);
  else
    ++outside;
}

void Builder::add_points(const OGRGeometry& g, const std::string& type, const GeoPoint* exact,
                         const Attributes& a) {
  each<OGRPoint>(g, [&](const OGRPoint& p) {
    Vector3 v(p.getX(), p.getY(), 0);
    if (exact)
      v = ground_.frame().to_world(*exact);
    else
      v.z() = options_.has_terrain ? std::numeric_limits<double>::quiet_NaN() : ground_.z_at(v.x(), v.y());
    if (!inside(v.x(), v.y()) || std::abs(v.x()) >= kFar_m / 2) {
      ++outside;
      return;
    }
    DraftNode node{type_of(type), a};
    node.attributes.emplace_back("position", v);
    draft_.nodes.push_back(std::move(node));
    count(type);
  });
}

void Builder::add_water(const OGRGeometry& g, const Feature& f, const Attributes& a) {
  const Geometry valid = mended(g, f.place);
  const Geometry kept = valid ? cut(*valid) : nullptr;
  if (!kept) return;
  bool any = false;
  each<OGRPolygon>(*kept, [&](const OGRPolygon& p) {
    if (!p.getExteriorRing()) return;
    std::vector<double> outer = points_of(*p.getExteriorRing(), true);
    if (outer.size() < 6 || std::abs(signed_area_m2(outer)) < kSmallest_m2) return;
    any = true;
    turn(outer, true);
    if (p.getNumInteriorRings() > 0)
      complaints.add("islands of a water are covered by its surface where the terrain is not above it",
                     f.place);
    DraftNode node{"Water", a};
    node.attributes.emplace_back("outline", world::Numbers(std::move(outer)));
    draft_.nodes.push_back(std::move(node));
    count("water");
  });
  if (any) return;
  if (kept->IsEmpty())
    ++outside;
  else
    complaints.add("a water without an area left out", f.place);
}

void Builder::add_cover(const OGRGeometry& g, std::uint8_t word) {
  bool any = false;
  each<OGRPolygon>(g, [&](const OGRPolygon& p) {
    CoverArea area;
    area.word = word;
    area.source = options_.source;
    const auto add_ring = [&](const OGRLinearRing* r) {
      if (r) area.rings.push_back(points_of(*r, true));
    };
    add_ring(p.getExteriorRing());
    for (int i = 0; i < p.getNumInteriorRings(); ++i) add_ring(p.getInteriorRing(i));
    if (area.rings.empty() || area.rings[0].size() < 6) return;
    area.area_m2 = std::abs(signed_area_m2(area.rings[0]));
    any = true;
    draft_.areas.push_back(std::move(area));
  });
  if (any) count("area of " + std::string(world::types::kCoverWords[word]));
}

Status Builder::add(const VectorData& data, Feature& f) {
  const auto shape = shape_of(*f.geometry);
  if (!shape) return {};
  GeoPoint place;
  if (*shape == Shape::point)
    each<OGRPoint>(*f.geometry, [&](const OGRPoint& p) { place = {p.getY(), p.getX(), 0}; });
  OsmMeaning meaning;
  if (source_.becomes == "osm") {
    Tags tags = f.fields;
    meaning = meaning_of(tags, *shape);
    if (meaning.becomes.empty() && meaning.cover.empty()) return {};
    if (const std::string* name = f.field("name"); name && !meaning.becomes.empty())
      meaning.attributes.emplace_back("name", *name);
  } else if (const auto word = cover_word(source_.becomes)) {
    meaning.cover = source_.becomes;
    if (source_.becomes == "water") meaning.becomes = "water";
  } else {
    meaning.becomes = source_.becomes;
  }
  if (!data.local) {
    ToWorld to_world(ground_);
    GdalMessages messages;
    if (f.geometry->transform(&to_world) != OGRERR_NONE || !to_world.status)
      return to_world.status ? fail(ErrorCode::internal, f.place, messages.text()) : to_world.status;
  }
  OGREnvelope e;
  f.geometry->getEnvelope(&e);
  if (std::max({e.MaxX, -e.MinX, e.MaxY, -e.MinY}) >= kFar_m / 2 ||
      (options_.half_extent_m && (e.MinX > *options_.half_extent_m || e.MaxX < -*options_.half_extent_m ||
                                  e.MinY > *options_.half_extent_m || e.MaxY < -*options_.half_extent_m))) {
    ++outside;
    return {};
  }
  const auto wrong = [&](const char* wanted) {
    complaints.add(fmt::format("expected {} for a {}, got a {}; left out", wanted, meaning.becomes,
                               f.geometry->getGeometryName()),
                   f.place);
    return Status();
  };
  if (!meaning.cover.empty()) {
    if (*shape == Shape::area)
      add_cover(*f.geometry, *cover_word(meaning.cover));
    else if (meaning.becomes.empty())
      complaints.add(fmt::format("expected areas of {}, got a {}; left out", meaning.cover,
                                 f.geometry->getGeometryName()),
                     f.place);
  }
  if (meaning.becomes.empty()) return {};
  double foot_height_m = std::numeric_limits<double>::quiet_NaN();
  if (meaning.becomes == "tree") meaning.attributes.insert(meaning.attributes.begin(), {"dbh_m", Value(0.0)});
  auto a = attributes(data, f, type_of(meaning.becomes), std::move(meaning.attributes), &foot_height_m);
  if (!a) return tl::unexpected(a.error());
  if (meaning.becomes == "building") {
    if (*shape != Shape::area) return wrong("areas");
    add_buildings(*f.geometry, f, *a);
  } else if (meaning.becomes == "water") {
    if (*shape != Shape::area) return wrong("areas");
    add_water(*f.geometry, f, *a);
  } else if (meaning.becomes == "road" || meaning.becomes == "fence") {
    if (*shape == Shape::point || (*shape == Shape::area && meaning.becomes == "road")) return wrong("lines");
    add_lines(*f.geometry, meaning.becomes, f, *a);
  } else {
    if (*shape != Shape::point) return wrong("points");
    place.height_m = foot_height_m;
    add_points(*f.geometry, meaning.becomes, std::isnan(foot_height_m) || data.local ? nullptr : &place, *a);
  }
  return {};
}

Status Builder::finish(const VectorData& data) {
  for (const auto& [type, m] : mappings_)
    if (auto s = m.finish(data.where); !s) return s;
  return {};
}

}  // namespace

std::optional<std::uint8_t> cover_word(std::string_view word) {
  const auto* const it =
      std::find(std::begin(world::types::kCoverWords), std::end(world::types::kCoverWords), word);
  if (it == std::end(world::types::kCoverWords)) return std::nullopt;
  return static_cast<std::uint8_t>(it - std::begin(world::types::kCoverWords));
}

Status add_features(const world::Schema& schema, VectorData data, const ImportSource& source,
                    const Ground& ground, const ShapeOptions& options, Draft& draft,
                    std::vector<std::string>& report, std::vector<std::string>& warnings) {
  ImportSource meant = source;
  if (meant.becomes.empty() && data.osm) meant.becomes = "osm";
  static const std::vector<std::string> kNodes = {"building", "road", "fence", "pole",
                                                  "water",    "tree", "osm"};
  if (std::find(kNodes.begin(), kNodes.end(), meant.becomes) == kNodes.end() && !cover_word(meant.becomes)) {
    std::vector<std::string> words = kNodes;
    words.insert(words.end(), std::begin(world::types::kCoverWords), std::end(world::types::kCoverWords));
    const std::string near = nearest(meant.becomes, words);
    return fail(
        ErrorCode::bad_input, data.where,
        fmt::format(
            "becomes: expected building, road, fence, pole, water, tree, osm or a land cover word, got "
            "'{}'{}",
            meant.becomes, near.empty() ? "" : "; did you mean " + near + "?"));
  }
  Builder builder(schema, ground, meant, options, draft);
  for (Feature& f : data.features)
    if (auto s = builder.add(data, f); !s) return s;
  if (auto s = builder.finish(data); !s) return s;
  std::string line;
  for (const auto& [what, n] : builder.made)
    line += fmt::format("{}{} {}", line.empty() ? "" : ", ", n, what);
  report.push_back(
      fmt::format("{}: {}{}", data.where, line.empty() ? "nothing" : line,
                  builder.outside > 0 ? fmt::format("; {} outside of the extent", builder.outside) : ""));
  warnings.insert(warnings.end(), data.warnings.begin(), data.warnings.end());
  builder.complaints.move_into(warnings, data.where);
  return {};
}

}  // namespace rigor::gis

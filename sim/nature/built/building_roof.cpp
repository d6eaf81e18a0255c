#include "sim/nature/built/building_roof.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "sim/nature/built/roof_sweep.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kFascia_m = 0.15;
constexpr double kVerge_m = 0.02;  // of a gable before the wall below it
constexpr double kWeld_m = 1e-5;
constexpr double kMostParapet_m = 0.4, kParapetWidth_m = 0.25;

class Pieces {
 public:
  void add(const Vector3d& a, const Vector3d& b, const Vector3d& c, int tag) {
    triangles_.push_back({a, b, c});
    tags_.push_back(tag);
  }
  void quad(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d, int tag) {
    add(a, b, c, tag);
    add(a, c, d, tag);
  }
  [[nodiscard]] Shell welded() const { return weld(triangles_, tags_, kWeld_m); }

 private:
  std::vector<std::array<Vector3d, 3>> triangles_;
  std::vector<int> tags_;
};

using Height = std::function<double(const Vector2d&)>;
Vector3d lifted(const Vector2d& p, double z) { return {p.x(), p.y(), z}; }

// Between two surfaces over a polygon, each level or tilted.
Shell slab(const Polygon& polygon, const Height& bottom, const Height& top, int side) {
  Pieces out;
  for (const auto& t : triangulate(polygon)) {
    out.add(lifted(t[0], top(t[0])), lifted(t[1], top(t[1])), lifted(t[2], top(t[2])), kCovered);
    out.add(lifted(t[0], bottom(t[0])), lifted(t[2], bottom(t[2])), lifted(t[1], bottom(t[1])), kUnderside);
  }
  for (const auto& r : polygon.rings())
    for (std::size_t i = 0; i < r.size(); ++i) {
      const Vector2d &a = r[i], &b = r[(i + 1) % r.size()];
      out.quad(lifted(a, bottom(a)), lifted(b, bottom(b)), lifted(b, top(b)), lifted(a, top(a)), side);
    }
  return out.welded();
}

void add_parapet(Roof& roof, const Polygon& footprint, double z_m, double height_m) {
  const auto ring_solid = [&](Ring outer, Ring hole) {
    std::reverse(hole.begin(), hole.end());
    roof.shells.push_back(
        prism(Polygon{.outer = std::move(outer), .holes = {std::move(hole)}}, z_m, z_m + height_m));
  };
  if (const auto in = offset(Polygon{.outer = footprint.outer, .holes = {}}, -kParapetWidth_m))
    ring_solid(footprint.outer, in->outer);
  for (const Ring& h : footprint.holes) {
    Ring court(h.rbegin(), h.rend());
    if (auto out = offset(Polygon{.outer = court, .holes = {}}, kParapetWidth_m))
      ring_solid(out->outer, court);
  }
}

void make_flat(Roof& roof, const Polygon& footprint, const RoofSpec& spec) {
  roof.shape = RoofShape::flat;
  const double parapet = std::min(spec.height_m, kMostParapet_m);
  if (parapet > 0.01) add_parapet(roof, footprint, spec.eaves_m, parapet);
}

// One plane that rises square to the longest edge, away from it.
void make_shed(Roof& roof, const Polygon& footprint, const RoofSpec& spec) {
  roof.shape = RoofShape::shed;
  const Ring& r = footprint.outer;
  Vector2d longest = Vector2d::Zero();
  for (std::size_t i = 0; i < r.size(); ++i) {
    const Vector2d e = r[(i + 1) % r.size()] - r[i];
    if (e.norm() > longest.norm() + 1e-6) longest = e;
  }
  const Vector2d up = Vector2d(-longest.y(), longest.x()).normalized();
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Vector2d& p : r) {
    low = std::min(low, up.dot(p));
    high = std::max(high, up.dot(p));
  }
  const Height plane = [=](const Vector2d& p) {
    return spec.eaves_m + spec.height_m * (up.dot(p) - low) / (high - low);
  };
  roof.shells.push_back(slab(
      footprint, [&](const Vector2d&) { return spec.eaves_m; }, plane, kGable));
  if (spec.overhang_m > 0)
    if (const auto sheet = offset(footprint, spec.overhang_m))
      roof.shells.push_back(slab(
          *sheet, plane, [&](const Vector2d& p) { return plane(p) + kFascia_m; }, kFascia));
}

// Closes what has been swept over an outline from below; `z_of` gives heights to the way swept.
Shell closed_below(const Polygon& outline, const RoofSweep& sweep, std::span<const double> speeds,
                   const std::function<double(double)>& z_of, double fascia_m) {
  Pieces out;
  for (const Facet& f : sweep.shell.facets) {
    Vector3d p[3];
    for (std::size_t k = 0; k < 3; ++k) {
      p[k] = sweep.shell.points[static_cast<std::size_t>(f.corner[k])];
      p[k].z() = z_of(p[k].z());
    }
    out.add(p[0], p[1], p[2], speeds[static_cast<std::size_t>(f.tag)] > 0 ? kCovered : kGable);
  }
  const double eaves = z_of(0), bottom = eaves - fascia_m;
  for (const auto& t : triangulate(outline))
    out.add(lifted(t[0], bottom), lifted(t[2], bottom), lifted(t[1], bottom), kUnderside);
  std::size_t edge = 0;
  for (const auto& r : outline.rings())
    for (std::size_t i = 0; i < r.size(); ++i, ++edge) {
      if (!(fascia_m > 0)) continue;
      const Vector2d &a = r[i], &b = r[(i + 1) % r.size()];
      out.quad(lifted(a, bottom), lifted(b, bottom), lifted(b, eaves), lifted(a, eaves),
               speeds[edge] > 0 ? kFascia : kGable);
    }
  return out.welded();
}

bool make_swept(Roof& roof, const Polygon& footprint, const RoofSpec& spec, bool gables) {
  const std::vector<double> ones(footprint.edge_count(), 1.0);
  const auto hipped = sweep_roof(footprint, ones);
  if (!hipped) return false;
  std::vector<double> speeds = gables ? gable_speeds(footprint, *hipped) : ones;
  if (gables && speeds == ones) {
    roof.warnings.emplace_back("the footprint has no end for a gable; the roof is hipped");
    gables = false;
  }
  const auto with = [&](double overhang) -> bool {
    Polygon outline = footprint;
    if (overhang > 0) {
      std::vector<double> out;
      for (const double w : speeds) out.push_back(w > 0 ? overhang : kVerge_m);
      const auto moved = offset(footprint, out);
      if (!moved) return false;
      outline = *moved;
    }
    const auto sweep = sweep_roof(outline, speeds);
    if (!sweep || !(sweep->height_m > overhang)) return false;
    const double slope = spec.height_m / (sweep->height_m - overhang);
    const auto z_of = [&](double way) { return spec.eaves_m + (way - overhang) * slope; };
    Shell shell = closed_below(outline, *sweep, speeds, z_of, overhang > 0 ? kFascia_m : 0.0);
    if (!open_edges(shell).empty()) return false;
    const auto top =
        std::max_element(shell.points.begin(), shell.points.end(),
                         [](const Vector3d& a, const Vector3d& b) { return a.z() < b.z() - 1e-6; });
    roof.top = *top;
    roof.shells.push_back(std::move(shell));
    roof.shape = gables ? RoofShape::gabled : RoofShape::hipped;
    return true;
  };
  if ((spec.overhang_m > 0 && with(spec.overhang_m)) || with(0)) return true;
  if (!gables) return false;
  roof.warnings.emplace_back("gables do not fit the footprint; the roof is hipped");
  speeds = ones;
  gables = false;
  return (spec.overhang_m > 0 && with(spec.overhang_m)) || with(0);
}

bool make_pyramid(Roof& roof, const Polygon& footprint, const RoofSpec& spec) {
  if (!footprint.holes.empty()) return false;
  Vector2d centre = Vector2d::Zero();
  const double whole = signed_area(footprint.outer);
  const Ring& f = footprint.outer;
  for (std::size_t i = 1; i + 1 < f.size(); ++i) {
    const double part = signed_area(Ring{f[0], f[i], f[i + 1]});
    centre += (f[0] + f[i] + f[i + 1]) / 3 * part / whole;
  }
  const auto inner_distances = [&](const Ring& r, double& mean) {
    mean = 0;
    for (std::size_t i = 0; i < r.size(); ++i) {
      const Vector2d a = r[i], d = (r[(i + 1) % r.size()] - a).normalized(), q = centre - a;
      const double in = d.x() * q.y() - d.y() * q.x();
      if (in < 0.05) return false;
      mean += in / static_cast<double>(r.size());
    }
    return true;
  };
  double mean = 0, wide = 0;
  if (!inner_distances(f, mean)) return false;
  auto moved = spec.overhang_m > 0 ? offset(footprint, spec.overhang_m) : std::nullopt;
  if (moved && !inner_distances(moved->outer, wide)) moved.reset();
  const Polygon& outline = moved ? *moved : footprint;
  const double eaves = spec.eaves_m - (moved ? spec.height_m * spec.overhang_m / mean : 0.0);
  const double bottom = eaves - (moved ? kFascia_m : 0.0);
  const Vector3d apex = lifted(centre, spec.eaves_m + spec.height_m);
  Pieces out;
  const Ring& r = outline.outer;
  for (std::size_t i = 0; i < r.size(); ++i) {
    const Vector2d &a = r[i], &b = r[(i + 1) % r.size()];
    out.add(lifted(a, eaves), lifted(b, eaves), apex, kCovered);
    if (moved) out.quad(lifted(a, bottom), lifted(b, bottom), lifted(b, eaves), lifted(a, eaves), kFascia);
  }
  for (const auto& t : triangulate(outline))
    out.add(lifted(t[0], bottom), lifted(t[2], bottom), lifted(t[1], bottom), kUnderside);
  roof.shells.push_back(out.welded());
  roof.top = apex;
  roof.shape = RoofShape::pyramidal;
  return true;
}

}  // namespace

Shell prism(const Polygon& polygon, double z0_m, double z1_m) {
  return slab(
      polygon, [=](const Vector2d&) { return z0_m; }, [=](const Vector2d&) { return z1_m; }, kGable);
}

Roof make_roof(const Polygon& footprint, const RoofSpec& spec) {
  Roof roof;
  RoofShape shape = spec.height_m > 0.01 ? spec.shape : RoofShape::flat;
  if (shape == RoofShape::pyramidal && !make_pyramid(roof, footprint, spec)) {
    roof.warnings.emplace_back("no point under the footprint's middle sees every wall; the roof is hipped");
    shape = RoofShape::hipped;
  }
  if (shape == RoofShape::hipped || shape == RoofShape::gabled) {
    if (!make_swept(roof, footprint, spec, shape == RoofShape::gabled)) {
      roof.warnings.emplace_back("no pitched roof fits the footprint; the roof is flat");
      make_flat(roof, footprint, spec);
    }
  } else if (shape == RoofShape::shed) {
    make_shed(roof, footprint, spec);
  } else if (shape == RoofShape::flat) {
    make_flat(roof, footprint, spec);
  }
  return roof;
}

}  // namespace rigor::nature::built

#include <cmath>

#include "sim/render/rays/light_chunk.h"

namespace rigor::render::light {
namespace {

/// Second word of the draws' counters: nobody else's effect.
constexpr std::uint32_t kSunDraws = 0x4C490002U;
/// Half the side of a square with the area of a disc of radius 1.
constexpr float kDiscAsSquare = 0.886F;
/// Side of a cell in which sunlight is kept: about so many pixels (docs/light-error.md).
constexpr float kSunCell_px = 3;

}  // namespace

unsigned Chunk::add_sun(std::span<Point> points, std::size_t first, unsigned draw, SunRays sun) {
  std::array<unsigned, 2 * kChunk> who;
  unsigned n = 0;
  for (unsigned i = 0; i < points.size(); ++i) {
    Point& p = points[i];
    if (!may_see_sun(p)) continue;
    if (!in_.query.shadows) {
      p.light += from_sun(p);
      continue;
    }
    Vec3 to = in_.frame.to_sun;
    if (sun == SunRays::to_points) {
      const auto u = draws(first + p.ray, kSunDraws, draw, 0);
      Vec3 a, b;
      frame_about(to, a, b);
      const float r = in_.frame.sun_radius_rad * std::sqrt(u[0]), angle = 2 * kPi * u[1];
      to = unit(to + a * (r * std::cos(angle)) + b * (r * std::sin(angle)), to);
    }
    set_sun_ray(n, p.place, p.geometric_normal, p.time, to);
    who[n++] = i;
  }
  if (n == 0) return 0;
  std::array<std::uint8_t, 2 * kChunk> hidden;
  in_.scene.occluded(rays_, n, true, hidden.data(), in_.followed);
  for (unsigned i = 0; i < n; ++i) {
    Point& p = points[who[i]];
    if (hidden[i] == 0) p.light += from_sun(p);
  }
  return n;
}

void Chunk::set_sun_ray(unsigned i, Vec3 place, Vec3 normal, float time, Vec3 to) {
  const Vec3 o = off_surface(place, normal, to);
  const float origin[3] = {o.x, o.y, o.z}, direction[3] = {to.x, to.y, to.z};
  rays_.set(i, origin, direction, 0, std::numeric_limits<float>::infinity(), time, kShadowMask);
}

unsigned Chunk::take_from_cells(std::span<const Point> points, std::span<SunCell> cells,
                                std::span<float> clear) {
  constexpr std::uint8_t kNone = 255;
  std::array<std::uint8_t, kChunk> asker, answer;  // of a cell that is missing: the first point in it
  std::array<float, kChunk> half_width_m, shares;
  std::array<std::uint8_t, kChunk> leaves;
  unsigned missing = 0;
  const auto take = [&](unsigned i, SunShare share) {
    if (share.leaves)
      clear[i] = share.clear;
    else
      cells[i] = {};
  };
  for (unsigned i = 0; i < points.size(); ++i) {
    answer[i] = kNone;
    if (!cells[i].any()) continue;
    if (const auto kept = in_.kept_sun->find(cells[i])) {
      take(i, *kept);
      continue;
    }
    unsigned k = missing;
    while (k > 0 && !cells[asker[k - 1]].same_as(cells[i])) --k;
    if (k == 0) {
      // Of the cell alone, not of who asks: neither its view nor its time.
      const RayScene::Triangle t = in_.scene.triangle(points[i].met);
      set_sun_ray(missing, middle_of(t, cells[i]), unit(cross(t.e1, t.e2), in_.frame.to_sun), 0,
                  in_.frame.to_sun);
      half_width_m[missing] = 0.5F * cells[i].side_m;
      asker[missing] = static_cast<std::uint8_t>(i);
      k = ++missing;
    }
    answer[i] = static_cast<std::uint8_t>(k - 1);
  }
  if (missing == 0) return 0;
  in_.scene.clear_share_alone(rays_, missing, {half_width_m.data(), kDiscAsSquare * in_.frame.sun_radius_rad},
                              shares.data(), leaves.data());
  std::array<SunShare, kChunk> kept;
  for (unsigned k = 0; k < missing; ++k)
    kept[k] = in_.kept_sun->keep(cells[asker[k]], {shares[k], leaves[k] != 0});
  for (unsigned i = 0; i < points.size(); ++i)
    if (answer[i] != kNone) take(i, kept[answer[i]]);
  return missing;
}

unsigned Chunk::ask_for_points(std::span<const Point> points, std::span<const SunCell> cells, bool in_cells,
                               std::span<float> clear) {
  std::array<std::uint8_t, kChunk> who;
  std::array<float, kChunk> half_width_m, share;
  unsigned n = 0;
  for (unsigned i = 0; i < points.size(); ++i) {
    const Point& p = points[i];
    if (!(clear[i] > 0) || cells[i].any() != in_cells) continue;
    set_sun_ray(n, p.place, p.geometric_normal, p.time, in_.frame.to_sun);
    half_width_m[n] = 0.5F * in_.query.spread_rad * p.range_m;
    who[n++] = static_cast<std::uint8_t>(i);
  }
  if (n == 0) return 0;
  in_.scene.clear_share(rays_, n, true, {half_width_m.data(), kDiscAsSquare * in_.frame.sun_radius_rad},
                        share.data(), in_cells ? RayScene::Part::moving : in_.followed);
  for (unsigned k = 0; k < n; ++k) clear[who[k]] *= share[k];
  return n;
}

unsigned Chunk::add_wide_sun(std::span<Point> points) {
  const bool in_cells = in_.kept_sun != nullptr;
  std::array<SunCell, kChunk> cells;
  std::array<float, kChunk> clear;
  for (unsigned i = 0; i < points.size(); ++i) {
    const Point& p = points[i];
    const bool faces = may_see_sun(p);
    clear[i] = faces ? 1 : 0;
    cells[i] = {};
    if (!faces || !in_cells || in_.scene.moves(p.met.instance)) continue;
    cells[i] = sun_cell(in_.scene.triangle(p.met), p.met, kSunCell_px * in_.query.spread_rad * p.range_m);
    if (cells[i].any()) in_.kept_sun->fetch(cells[i]);
  }
  unsigned traced = 0;
  if (in_cells) {
    traced += take_from_cells(points, cells, clear);
    // Cells know nothing of what moves.
    if (in_.scene.anything_moves()) traced += ask_for_points(points, cells, true, clear);
  }
  if (in_.query.shadows) traced += ask_for_points(points, cells, false, clear);
  for (unsigned i = 0; i < points.size(); ++i) {
    Point& p = points[i];
    if (clear[i] > 0) p.light += from_sun(p) * clear[i];
  }
  return traced;
}

}  // namespace rigor::render::light

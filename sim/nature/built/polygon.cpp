#include "sim/nature/built/polygon.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
constexpr double kSame_m = 1e-3;  // points nearer than this are one
constexpr double kLeastArea_m2 = 0.01;
constexpr double kFarthest_m = 1e8;
constexpr std::size_t kMostPoints = 4096;
constexpr const char* kWhere = "sim/nature/built";

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double distance_to_segment(const Vector2d& p, const Vector2d& a, const Vector2d& b) {
  const Vector2d d = b - a;
  const double f = d.squaredNorm() > 0 ? std::clamp((p - a).dot(d) / d.squaredNorm(), 0.0, 1.0) : 0.0;
  return (p - a - f * d).norm();
}

// Where two segments come within `gap` of each other.
std::optional<Vector2d> intersection(const Vector2d& a, const Vector2d& b, const Vector2d& c,
                                     const Vector2d& d, double gap) {
  const auto apart = [gap](double a0, double a1, double b0, double b1) {
    return std::max(a0, a1) + gap < std::min(b0, b1) || std::max(b0, b1) + gap < std::min(a0, a1);
  };
  if (apart(a.x(), b.x(), c.x(), d.x()) || apart(a.y(), b.y(), c.y(), d.y())) return std::nullopt;
  const Vector2d u = b - a, v = d - c;
  const double det = cross(u, v);
  if (std::abs(det) > 1e-12 * u.norm() * v.norm()) {
    const double s = cross(c - a, v) / det, t = cross(c - a, u) / det;
    if (s >= 0 && s <= 1 && t >= 0 && t <= 1) return Vector2d(a + s * u);
  }
  if (distance_to_segment(c, a, b) < gap) return c;
  if (distance_to_segment(d, a, b) < gap) return d;
  if (distance_to_segment(a, c, d) < gap) return a;
  if (distance_to_segment(b, c, d) < gap) return b;
  return std::nullopt;
}

struct SelfIntersection {
  std::size_t i, j;
  Vector2d at;
};
// Of two edges of a ring that are not neighbours.
std::optional<SelfIntersection> self_intersection(std::span<const Vector2d> r, double gap) {
  const std::size_t n = r.size();
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = i + 2; j < n; ++j) {
      if (i == 0 && j + 1 == n) continue;
      if (const auto at = intersection(r[i], r[i + 1], r[j], r[(j + 1) % n], gap))
        return SelfIntersection{i, j, *at};
    }
  return std::nullopt;
}

bool rings_intersect(std::span<const Vector2d> a, std::span<const Vector2d> b, double gap) {
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < b.size(); ++j)
      if (intersection(a[i], a[(i + 1) % a.size()], b[j], b[(j + 1) % b.size()], gap)) return true;
  return false;
}

// Drops points that lie on their neighbours or on the line between them, spikes among them.
Ring cleaned(Ring r) {
  bool again = true;
  while (again && r.size() >= 3) {
    again = false;
    for (std::size_t i = 0; i < r.size() && r.size() >= 3;) {
      const Vector2d& before = r[(i + r.size() - 1) % r.size()];
      const Vector2d& after = r[(i + 1) % r.size()];
      const Vector2d in = r[i] - before, out = after - r[i];
      const double reach = std::max(in.norm(), out.norm());
      if (in.norm() < kSame_m || out.norm() < kSame_m || std::abs(cross(in, out)) < 0.2 * kSame_m * reach) {
        r.erase(r.begin() + static_cast<std::ptrdiff_t>(i));
        again = true;
      } else {
        ++i;
      }
    }
  }
  return r;
}

// Cuts off loops at the places where a ring meets itself, as long as they are small beside the rest.
Result<Ring> unlooped(Ring r, std::string_view what, std::vector<std::string>& mended) {
  for (int cut = 0; cut < 32; ++cut) {
    const auto m = self_intersection(r, kSame_m);
    if (!m) return r;
    Ring one{m->at}, other{m->at};
    for (std::size_t k = m->i + 1; k <= m->j; ++k) one.push_back(r[k]);
    for (std::size_t k = m->j + 1; k < r.size() + m->i + 1; ++k) other.push_back(r[k % r.size()]);
    one = cleaned(std::move(one));
    other = cleaned(std::move(other));
    const auto size = [](const Ring& x) { return x.size() < 3 ? 0.0 : std::abs(signed_area(x)); };
    if (size(one) > size(other)) std::swap(one, other);
    if (size(one) > 0.1 * size(other))
      return fail(
          ErrorCode::bad_input, kWhere,
          fmt::format("{} crosses itself and falls into parts of {:.2f} m² and {:.2f} m²; expected one "
                      "simple ring: draw it as two",
                      what, size(one), size(other)));
    if (size(one) > kLeastArea_m2)
      mended.push_back(fmt::format("{} crosses itself: a loop of {:.2f} m² was cut off", what, size(one)));
    r = std::move(other);
    if (r.size() < 3) break;
  }
  if (r.size() >= 3 && !self_intersection(r, kSame_m)) return r;
  return fail(ErrorCode::bad_input, kWhere, fmt::format("{} crosses itself; expected a simple ring", what));
}

Result<Ring> ring_from(std::span<const double> xy, const Vector2d& origin, std::string_view what,
                       std::vector<std::string>& mended) {
  if (xy.size() % 2 != 0)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("{}: expected pairs x y, got {} numbers", what, xy.size()));
  if (xy.size() > 2 * kMostPoints)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("{}: {} points, expected at most {}", what, xy.size() / 2, kMostPoints));
  Ring r;
  for (std::size_t i = 0; i + 1 < xy.size(); i += 2) {
    if (!(std::abs(xy[i]) < kFarthest_m) || !(std::abs(xy[i + 1]) < kFarthest_m))
      return fail(ErrorCode::bad_input, kWhere,
                  fmt::format("{}: point {} is ({}, {}), expected metres of at most {:g}", what, i / 2, xy[i],
                              xy[i + 1], kFarthest_m));
    r.emplace_back(xy[i] - origin.x(), xy[i + 1] - origin.y());
  }
  if (r.size() < 3)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("{}: {} points, expected 3 or more", what, r.size()));
  r = cleaned(std::move(r));
  if (r.size() < 3 || std::abs(signed_area(r)) < kLeastArea_m2) {
    // A ring whose loops cancel each other has no area either, but is another fault.
    const bool crosses = r.size() > 3 && self_intersection(r, kSame_m).has_value();
    return fail(ErrorCode::bad_input, kWhere,
                crosses ? fmt::format("{} crosses itself; expected a simple ring: draw it as two", what)
                        : fmt::format("{} encloses no area", what));
  }
  return unlooped(std::move(r), what, mended);
}

}  // namespace

std::size_t Polygon::edge_count() const {
  std::size_t n = outer.size();
  for (const auto& h : holes) n += h.size();
  return n;
}

std::vector<std::span<const Vector2d>> Polygon::rings() const {
  std::vector<std::span<const Vector2d>> all{outer};
  for (const auto& h : holes) all.emplace_back(h);
  return all;
}

double signed_area(std::span<const Vector2d> r) {
  double twice = 0;
  for (std::size_t i = 1; i + 1 < r.size(); ++i) twice += cross(r[i] - r[0], r[i + 1] - r[0]);
  return twice / 2;
}

double area(const Polygon& polygon) {
  double sum = 0;
  for (const auto& r : polygon.rings()) sum += signed_area(r);
  return sum;
}

bool contains(std::span<const Vector2d> r, const Vector2d& p) {
  bool inside = false;
  for (std::size_t i = 0; i < r.size(); ++i) {
    const Vector2d &a = r[i], &b = r[(i + 1) % r.size()];
    if ((a.y() > p.y()) != (b.y() > p.y()) &&
        p.x() < a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x()))
      inside = !inside;
  }
  return inside;
}

bool contains(const Polygon& polygon, const Vector2d& p) {
  if (!contains(polygon.outer, p)) return false;
  return std::none_of(polygon.holes.begin(), polygon.holes.end(),
                      [&](const Ring& h) { return contains(h, p); });
}

bool is_simple(const Polygon& polygon, double gap_m) {
  const auto rings = polygon.rings();
  for (std::size_t a = 0; a < rings.size(); ++a) {
    if (self_intersection(rings[a], gap_m)) return false;
    for (std::size_t b = a + 1; b < rings.size(); ++b)
      if (rings_intersect(rings[a], rings[b], gap_m)) return false;
  }
  return true;
}

Vector2d origin_near(std::span<const double> xy) {
  Eigen::AlignedBox2d box;
  for (std::size_t i = 0; i + 1 < xy.size(); i += 2)
    if (std::abs(xy[i]) < kFarthest_m && std::abs(xy[i + 1]) < kFarthest_m)
      box.extend(Vector2d(xy[i], xy[i + 1]));
  if (box.isEmpty()) return Vector2d::Zero();
  return box.center().array().floor();
}

Result<Polygon> polygon_from(std::span<const double> footprint, std::span<const double> holes,
                             const Vector2d& origin, std::vector<std::string>& mended) {
  auto outer = ring_from(footprint, origin, "footprint", mended);
  if (!outer) return tl::unexpected(outer.error());
  Polygon polygon{.outer = std::move(*outer), .holes = {}};
  if (signed_area(polygon.outer) < 0) std::reverse(polygon.outer.begin(), polygon.outer.end());
  for (std::size_t at = 0, k = 0; at < holes.size(); ++k) {
    const std::string what = fmt::format("hole {}", k);
    const double count = holes[at];
    if (!(count >= 0) || count != std::floor(count) || count > static_cast<double>(holes.size() - at - 1)) {
      mended.push_back(
          fmt::format("{}: its count is {}, {} numbers are left; it and what follows was left out", what,
                      count, holes.size() - at - 1));
      break;
    }
    auto ring = ring_from(holes.subspan(at + 1, static_cast<std::size_t>(count)), origin, what, mended);
    at += 1 + static_cast<std::size_t>(count);
    if (!ring) {
      mended.push_back(ring.error().message + "; left out");
      continue;
    }
    Ring hole = std::move(*ring);
    if (signed_area(hole) > 0) std::reverse(hole.begin(), hole.end());
    // A hole that touches is drawn in by a hand's breadth; one that crosses or lies elsewhere is none.
    const auto fits = [&](const Ring& h, double gap) {
      if (!contains(polygon.outer, h.front()) || rings_intersect(polygon.outer, h, gap)) return false;
      return std::none_of(polygon.holes.begin(), polygon.holes.end(), [&](const Ring& o) {
        return rings_intersect(o, h, gap) || contains(o, h.front()) || contains(h, o.front());
      });
    };
    constexpr double kGap_m = 0.01, kInset_m = 0.1;
    if (!fits(hole, kGap_m)) {
      std::reverse(hole.begin(), hole.end());
      auto smaller = offset(Polygon{.outer = hole, .holes = {}}, -kInset_m);
      if (!smaller ||
          (std::reverse(smaller->outer.begin(), smaller->outer.end()), !fits(smaller->outer, kGap_m))) {
        mended.push_back(what + " does not lie inside the footprint and apart from other holes; left out");
        continue;
      }
      mended.push_back(fmt::format("{} touches another ring and was drawn in by {} m", what, kInset_m));
      hole = std::move(smaller->outer);
    }
    polygon.holes.push_back(std::move(hole));
  }
  return polygon;
}

std::optional<Polygon> offset(const Polygon& polygon, std::span<const double> distance_m) {
  Polygon out;
  std::size_t first = 0;
  for (const auto& r : polygon.rings()) {
    Ring moved(r.size());
    for (std::size_t i = 0; i < r.size(); ++i) {
      const std::size_t before = (i + r.size() - 1) % r.size();
      const Vector2d in = (r[i] - r[before]).normalized(), go = (r[(i + 1) % r.size()] - r[i]).normalized();
      const double d_in = distance_m[first + before], d_go = distance_m[first + i];
      const Vector2d out_in(in.y(), -in.x()), out_go(go.y(), -go.x());
      const double det = cross(out_in, out_go);
      if (std::abs(det) < 1e-9) {
        moved[i] = r[i] + out_go * d_go;
      } else {
        moved[i] =
            r[i] +
            Vector2d(d_in * out_go.y() - d_go * out_in.y(), d_go * out_in.x() - d_in * out_go.x()) / det;
      }
    }
    for (std::size_t i = 0; i < r.size(); ++i) {
      const std::size_t next = (i + 1) % r.size();
      if ((moved[next] - moved[i]).dot(r[next] - r[i]) <= kSame_m * (r[next] - r[i]).norm())
        return std::nullopt;
      // A mitre at a very sharp corner would stand out like a thorn.
      const std::size_t before = (i + r.size() - 1) % r.size();
      const double most = std::max(std::abs(distance_m[first + before]), std::abs(distance_m[first + i]));
      if ((moved[i] - r[i]).norm() > 6 * std::max(most, 0.01)) return std::nullopt;
    }
    first += r.size();
    (out.outer.empty() ? out.outer : out.holes.emplace_back()) = std::move(moved);
  }
  if (!is_simple(out, kSame_m)) return std::nullopt;
  return out;
}

std::optional<Polygon> offset(const Polygon& polygon, double distance_m) {
  return offset(polygon, std::vector<double>(polygon.edge_count(), distance_m));
}

namespace {

bool in_triangle(const Vector2d& p, const Vector2d& a, const Vector2d& b, const Vector2d& c) {
  return cross(b - a, p - a) >= 0 && cross(c - b, p - b) >= 0 && cross(a - c, p - c) >= 0;
}

// One ring that walks into each hole and back over a bridge (D. Eberly, Triangulation by Ear Clipping).
Ring bridged(const Polygon& polygon) {
  Ring ring = polygon.outer;
  std::vector<const Ring*> holes;
  for (const auto& h : polygon.holes) holes.push_back(&h);
  const auto rightmost = [](const Ring& h) {
    return std::max_element(h.begin(), h.end(), [](const Vector2d& a, const Vector2d& b) {
      return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
    });
  };
  std::stable_sort(holes.begin(), holes.end(),
                   [&](const Ring* a, const Ring* b) { return rightmost(*a)->x() > rightmost(*b)->x(); });
  for (const Ring* hole : holes) {
    const auto start = rightmost(*hole);
    const Vector2d m = *start;
    double best_x = std::numeric_limits<double>::infinity();
    std::size_t best = 0;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Vector2d &a = ring[i], &b = ring[(i + 1) % ring.size()];
      if (!(a.y() <= m.y() && b.y() >= m.y()) || a.y() == b.y()) continue;  // seen from inside: upwards
      const double x = a.x() + (m.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
      if (x >= m.x() && x < best_x) {
        best_x = x;
        best = a.x() > b.x() ? i : (i + 1) % ring.size();
      }
    }
    // The bridge goes to that edge's farther end, unless a corner stands in between.
    const Vector2d hit(best_x, m.y()), p = ring[best];
    double least = std::numeric_limits<double>::infinity(), minimum_range = least;
    std::size_t chosen = best;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Vector2d& q = ring[i];
      if (q == p || q.x() < m.x()) continue;
      const bool inside = p.y() > m.y() ? in_triangle(q, m, hit, p) : in_triangle(q, m, p, hit);
      if (!inside) continue;
      const Vector2d before = ring[(i + ring.size() - 1) % ring.size()], after = ring[(i + 1) % ring.size()];
      if (cross(q - before, after - q) > 0) continue;
      const double slope = std::abs(q.y() - m.y()) / std::max(q.x() - m.x(), 1e-12);
      const double range = (q - m).norm();
      if (slope < least || (slope == least && range < minimum_range)) {
        least = slope;
        minimum_range = range;
        chosen = i;
      }
    }
    Ring joined(ring.begin(), ring.begin() + static_cast<std::ptrdiff_t>(chosen) + 1);
    joined.insert(joined.end(), start, hole->end());
    joined.insert(joined.end(), hole->begin(), start + 1);
    joined.insert(joined.end(), ring.begin() + static_cast<std::ptrdiff_t>(chosen), ring.end());
    ring = std::move(joined);
  }
  return ring;
}

}  // namespace

std::vector<std::array<Vector2d, 3>> triangulate(const Polygon& polygon) {
  const Ring ring = bridged(polygon);
  std::vector<std::size_t> left(ring.size());
  for (std::size_t i = 0; i < left.size(); ++i) left[i] = i;
  std::vector<std::array<Vector2d, 3>> out;
  while (left.size() > 2) {
    const std::size_t n = left.size();
    // The ear with the widest smallest angle would be the finest; the first that is one is good enough, but
    // flat ones wait until nothing else is left.
    std::size_t ear = n, flat = n;
    for (std::size_t i = 0; i < n && ear == n; ++i) {
      const Vector2d &a = ring[left[(i + n - 1) % n]], &b = ring[left[i]], &c = ring[left[(i + 1) % n]];
      const double turn = cross(b - a, c - b);
      if (turn <= 1e-12 * (b - a).norm() * (c - b).norm()) {
        if (flat == n && turn >= -1e-12 * (b - a).norm() * (c - b).norm()) flat = i;
        continue;
      }
      bool clear = true;
      for (std::size_t k = 0; k < n && clear; ++k) {
        const Vector2d& q = ring[left[k]];
        if (q == a || q == b || q == c) continue;
        clear = !in_triangle(q, a, b, c);
      }
      if (clear) ear = i;
    }
    if (ear == n) ear = flat;
    if (ear == n) break;
    const Vector2d &a = ring[left[(ear + n - 1) % n]], &b = ring[left[ear]], &c = ring[left[(ear + 1) % n]];
    if (cross(b - a, c - b) > 0) out.push_back({a, b, c});
    left.erase(left.begin() + static_cast<std::ptrdiff_t>(ear));
  }
  return out;
}

}  // namespace rigor::nature::built

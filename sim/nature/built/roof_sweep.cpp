#include "sim/nature/built/roof_sweep.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kSame_m = 1e-7;  // what the front does within this is done at once
constexpr double kWeld_m = 1e-5;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

// The front: rings of corners, each with the edge that leaves it.
class Front {
 public:
  Front(const Polygon& outline, std::span<const double> speeds) : speed_(speeds.begin(), speeds.end()) {
    for (const auto& ring : outline.rings()) {
      const int first = static_cast<int>(corners_.size()), n = static_cast<int>(ring.size());
      for (int i = 0; i < n; ++i) {
        const Vector2d& a = ring[static_cast<std::size_t>(i)];
        const Vector2d& b = ring[static_cast<std::size_t>((i + 1) % n)];
        const Vector2d d = (b - a).normalized();
        direction_.push_back(d);
        inward_.emplace_back(-d.y(), d.x());
        corners_.push_back({.at = a,
                            .edge = first + i,
                            .before = first + (i + n - 1) % n,
                            .after = first + (i + 1) % n,
                            .from = lifted(a),
                            .to = lifted(b)});
      }
    }
    triangles_of_.assign(speed_.size(), 0);
  }

  // False: entangled.
  bool run() {
    const std::size_t most = 40 * corners_.size() + 100;
    for (std::size_t step = 0; step < most; ++step) {
      clean();
      if (std::none_of(corners_.begin(), corners_.end(), [](const Corner& c) { return c.alive; }))
        return true;
      if (!give_velocities()) return false;
      const double dt = time_to_next_event();
      if (!std::isfinite(dt)) return false;
      for (Corner& c : corners_)
        if (c.alive) c.at += dt * c.velocity;
      t_ += dt;
    }
    return false;
  }

  std::vector<std::array<Vector3d, 3>> triangles;
  std::vector<int> tags;
  [[nodiscard]] double height() const { return t_; }
  [[nodiscard]] bool is_hip_end(std::size_t edge) const { return triangles_of_[edge] == 1; }

 private:
  struct Corner {
    Vector2d at;
    int edge = 0, before = 0, after = 0;
    Vector3d from = Vector3d::Zero(), to = Vector3d::Zero();  // ends of the edge when its present piece began
    Vector2d velocity = Vector2d::Zero();
    bool alive = true, reflex = false;
  };

  [[nodiscard]] Vector3d lifted(const Vector2d& p) const { return {p.x(), p.y(), t_}; }
  Corner& c(int i) { return corners_[static_cast<std::size_t>(i)]; }
  const Vector2d& direction(int e) const { return direction_[static_cast<std::size_t>(e)]; }
  const Vector2d& inward(int e) const { return inward_[static_cast<std::size_t>(e)]; }
  int edge_into(int i) { return c(c(i).before).edge; }

  void add(const Vector3d& p, const Vector3d& q, const Vector3d& r, int edge) {
    if ((q - p).cross(r - p).norm() < 1e-14) return;
    triangles.push_back({p, q, r});
    tags.push_back(edge);
    ++triangles_of_[static_cast<std::size_t>(edge)];
  }
  // Writes down what the edge that leaves corner i has swept since its piece began, and begins the next.
  void flush(int i) {
    Corner& u = c(i);
    const Vector3d a = lifted(u.at), b = lifted(c(u.after).at);
    if (a.z() - u.from.z() > 0 || a != u.from || b != u.to) {
      if ((u.to - u.from).norm() >= (b - a).norm()) {
        add(u.from, u.to, b, u.edge);
        add(u.from, b, a, u.edge);
      } else {
        add(u.from, u.to, a, u.edge);
        add(u.to, b, a, u.edge);
      }
    }
    u.from = a;
    u.to = b;
  }
  void kill_pair(int i) {
    const int j = c(i).after;
    flush(i);
    flush(j);
    c(i).alive = c(j).alive = false;
  }

  // Brings the front into a state in which it can move on: no edges without length, no spikes, no touching.
  void clean() {
    done_.clear();
    bool again = true;
    while (again) {
      again = false;
      for (int i = 0; i < static_cast<int>(corners_.size()); ++i) {
        if (!c(i).alive) continue;
        if (c(c(i).after).after == i) {
          kill_pair(i);
          again = true;
        } else if ((c(c(i).after).at - c(i).at).norm() < kSame_m) {
          drop_edge(i);
          again = true;
        } else if (direction(edge_into(i)).dot(direction(c(i).edge)) < -1 + 1e-12) {
          fold_spike(i);
          again = true;
        }
      }
      if (!again) again = part_touching();
    }
  }

  // The edge that leaves i has shrunk to a point.
  void drop_edge(int i) {
    const int p = c(i).before, v = c(i).after;
    flush(i);
    flush(p);
    flush(v);
    c(i).alive = false;
    c(p).after = v;
    c(v).before = p;
    c(p).to = lifted(c(v).at);
  }

  // The two edges at i lie on each other: where they do they end, as a level ridge.
  void fold_spike(int i) {
    const int p = c(i).before, q = c(i).after;
    flush(p);
    flush(i);
    flush(q);
    flush(c(p).before);
    const double in = (c(i).at - c(p).at).norm(), out = (c(q).at - c(i).at).norm();
    c(i).alive = false;
    c(p).after = q;
    c(q).before = p;
    if (std::abs(in - out) < kSame_m) {  // p and q meet: p's edge is gone too; drop_edge finds it
      c(p).at = c(q).at;
    } else if (in < out) {
      c(p).edge = c(i).edge;
    }
    c(p).from = lifted(c(p).at);
    c(p).to = lifted(c(q).at);
  }

  bool mark(int i, int j) { return done_.insert({std::min(i, j), std::max(i, j)}).second; }

  // A reflex corner that has reached another part of the front: the front parts there, or two become one.
  bool part_touching() {
    for (int i = 0; i < static_cast<int>(corners_.size()); ++i) {
      if (!c(i).alive || cross(direction(edge_into(i)), direction(c(i).edge)) > -1e-9) continue;
      for (int a = 0; a < static_cast<int>(corners_.size()); ++a) {
        if (!c(a).alive || a == i || c(a).after == i || c(i).after == a) continue;
        if ((c(a).at - c(i).at).norm() < kSame_m) {
          if (!mark(i, a)) continue;
          exchange(i, a);
          return true;
        }
        const Vector2d q = c(i).at - c(a).at;
        const int b = c(a).after;
        const double along = q.dot(direction(c(a).edge)),
                     length = (c(b).at - c(a).at).dot(direction(c(a).edge));
        if (std::abs(q.dot(inward(c(a).edge))) > kSame_m || along < kSame_m || along > length - kSame_m)
          continue;
        if ((c(b).at - c(i).at).norm() < kSame_m) continue;  // as a corner, when a is b
        split_edge(i, a);
        return true;
      }
    }
    return false;
  }

  void exchange(int i, int a) {
    for (const int k : {c(i).before, i, c(a).before, a}) {
      flush(k);
    }
    Corner &u = c(i), &v = c(a);
    std::swap(u.after, v.after);
    std::swap(u.edge, v.edge);
    for (const int k : {i, a}) {
      c(c(k).after).before = k;
      c(k).from = lifted(c(k).at);
      c(k).to = lifted(c(c(k).after).at);
    }
  }

  // Corner i has come upon the inside of the edge that leaves a.
  void split_edge(int i, int a) {
    for (const int k : {c(i).before, i, a}) {
      flush(k);
    }
    const int y = static_cast<int>(corners_.size()), b = c(a).after;
    corners_.push_back({.at = c(i).at, .edge = c(i).edge, .before = a, .after = c(i).after});
    c(c(y).after).before = y;
    c(i).edge = c(a).edge;
    c(i).after = b;
    c(b).before = i;
    c(a).after = y;
    for (const int k : {a, y, i}) {
      c(k).from = lifted(c(k).at);
      c(k).to = lifted(c(c(k).after).at);
    }
    mark(i, y);
  }

  bool give_velocities() {
    for (int i = 0; i < static_cast<int>(corners_.size()); ++i) {
      Corner& u = c(i);
      if (!u.alive) continue;
      const int l = edge_into(i), r = u.edge;
      const double wl = speed_[static_cast<std::size_t>(l)], wr = speed_[static_cast<std::size_t>(r)];
      const Vector2d &nl = inward(l), &nr = inward(r);
      const double det = cross(nl, nr);
      u.reflex = cross(direction(l), direction(r)) < -1e-9;
      if (std::abs(det) > 1e-9) {
        u.velocity = Vector2d(wl * nr.y() - wr * nl.y(), wr * nl.x() - wl * nr.x()) / det;
      } else if (nl.dot(nr) > 0 && std::abs(wl - wr) < 1e-9) {
        u.velocity = nl * wl;
      } else {
        return false;
      }
    }
    return true;
  }

  double time_to_next_event() {
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < static_cast<int>(corners_.size()); ++i) {
      Corner& u = c(i);
      if (!u.alive) continue;
      const Corner& v = c(u.after);
      const double length = (v.at - u.at).dot(direction(u.edge));
      const double rate = (v.velocity - u.velocity).dot(direction(u.edge));
      if (rate < -1e-12) least = std::min(least, std::max(length, 0.0) / -rate);
      if (!u.reflex) continue;
      for (int a = 0; a < static_cast<int>(corners_.size()); ++a) {
        if (!c(a).alive || a == i || c(a).after == i) continue;
        const int e = c(a).edge;
        const Corner& b = c(c(a).after);
        const double gap = (u.at - c(a).at).dot(inward(e));
        const double closing = u.velocity.dot(inward(e)) - speed_[static_cast<std::size_t>(e)];
        if (gap < -kSame_m || closing > -1e-12) continue;
        const double t = std::max(gap, 0.0) / -closing;
        if (t >= least) continue;
        const Vector2d at = u.at + t * u.velocity, from = c(a).at + t * c(a).velocity;
        const double along = (at - from).dot(direction(e));
        const double length_then = (b.at + t * b.velocity - from).dot(direction(e));
        if (along < -kSame_m || along > length_then + kSame_m) continue;
        if (t < 1e-13 && done_.contains({std::min(i, a), std::max(i, a)})) continue;
        if (t < 1e-13 && c(a).after != i &&
            done_.contains({std::min(i, c(a).after), std::max(i, c(a).after)}))
          continue;
        least = t;
      }
    }
    return least;
  }

  std::vector<double> speed_;
  std::vector<Vector2d> direction_, inward_;
  std::vector<Corner> corners_;
  std::vector<int> triangles_of_;
  std::set<std::pair<int, int>> done_;  // corners that have been parted at this instant
  double t_ = 0;
};

}  // namespace

std::optional<RoofSweep> sweep_roof(const Polygon& outline, std::span<const double> speeds) {
  if (speeds.size() != outline.edge_count()) return std::nullopt;
  Front front(outline, speeds);
  if (!front.run()) return std::nullopt;
  RoofSweep out;
  out.shell = weld(front.triangles, front.tags, kWeld_m);
  double covered = 0;
  for (const Facet& f : out.shell.facets) {
    const auto& p = out.shell.points;
    const Vector3d n =
        (p[static_cast<std::size_t>(f.corner[1])] - p[static_cast<std::size_t>(f.corner[0])])
            .cross(p[static_cast<std::size_t>(f.corner[2])] - p[static_cast<std::size_t>(f.corner[0])]);
    if (n.z() < -1e-7 * n.norm() - 1e-9) return std::nullopt;
    covered += n.z() / 2;
  }
  const double whole = area(outline);
  if (!(std::abs(covered - whole) < 1e-5 * whole)) return std::nullopt;
  for (const auto& e : open_edges(out.shell))
    for (const int i : e)
      if (out.shell.points[static_cast<std::size_t>(i)].z() > kWeld_m) return std::nullopt;
  for (const auto& p : out.shell.points) out.height_m = std::max(out.height_m, p.z());
  // Walls that are a centimetre off parallel part a hip end into a triangle and a sliver.
  std::vector<double> swept(speeds.size(), 0), top(speeds.size(), 0);
  for (const Facet& f : out.shell.facets) {
    const Vector3d p[3] = {out.shell.points[static_cast<std::size_t>(f.corner[0])],
                           out.shell.points[static_cast<std::size_t>(f.corner[1])],
                           out.shell.points[static_cast<std::size_t>(f.corner[2])]};
    const auto e = static_cast<std::size_t>(f.tag);
    swept[e] += (p[1] - p[0]).cross(p[2] - p[0]).z() / 2;
    for (const Vector3d& q : p) top[e] = std::max(top[e], q.z());
  }
  std::size_t e = 0;
  for (const auto& r : outline.rings())
    for (std::size_t i = 0; i < r.size(); ++i, ++e) {
      const double triangle = (r[(i + 1) % r.size()] - r[i]).norm() * top[e] * speeds[e] / 2;
      out.is_hip_end.push_back(front.is_hip_end(e) ||
                               (triangle > 0 && std::abs(swept[e] - triangle) < 0.01 * triangle));
    }
  return out;
}

std::vector<double> gable_speeds(const Polygon& outline, const RoofSweep& hipped) {
  std::vector<double> speeds(outline.edge_count(), 1.0);
  struct End {
    double length_m;
    std::size_t edge, before, after;
  };
  std::vector<End> ends;
  std::size_t first = 0;
  for (const auto& r : outline.rings()) {
    const std::size_t n = r.size();
    const auto along = [&](std::size_t i) -> Vector2d { return r[(i + 1) % n] - r[i % n]; };
    for (std::size_t i = 0; n > 3 && i < n; ++i) {
      const Vector2d in = along(i + n - 1).normalized(), out = along(i + 1).normalized();
      if (hipped.is_hip_end[first + i] && in.dot(out) < -0.85)
        ends.push_back({along(i).norm(), first + i, first + (i + n - 1) % n, first + (i + 1) % n});
    }
    first += n;
  }
  std::stable_sort(ends.begin(), ends.end(),
                   [](const End& a, const End& b) { return a.length_m < b.length_m - 1e-6; });
  for (const End& e : ends)
    if (speeds[e.before] > 0 && speeds[e.after] > 0) speeds[e.edge] = 0;
  return speeds;
}

}  // namespace rigor::nature::built

#include "sim/nature/built/road_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/nature/built/built_surfaces.h"
#include "sim/render/models/mesh_builder.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using render::Vertex;

constexpr double kLift_m = 0.04, kSkirt_m = 0.45;
constexpr double kLongest_m = 4.0, kShortest_m = 0.5, kSag_m = 0.01;  // of stations, against the ground
constexpr double kColumn_m = 1.0;
constexpr double kPiece_m = 150;
constexpr double kMarkedFrom_m = 5.5, kLine_m = 0.12, kEdgeLineAt_m = 0.2, kDash_m = 3, kDashPeriod_m = 9;

enum class Paint : std::uint8_t { none, always, dashed };
struct Column {
  double s = 0;               // of its right edge
  Paint paint = Paint::none;  // up to the next
};

std::vector<Column> columns_of(const RoadSpec& spec) {
  const double w = spec.width_m / 2;
  std::vector<Column> out;
  const auto fill = [&](double from_m, double to_m, Paint paint) {
    const int n = paint == Paint::none
                      ? std::max(1, static_cast<int>(std::ceil((to_m - from_m) / kColumn_m - 1e-9)))
                      : 1;
    for (int i = 0; i < n; ++i) out.push_back({(from_m + (to_m - from_m) * i / n) / w, paint});
  };
  if (!spec.own_cover && spec.surface == RoadSurface::asphalt && spec.width_m >= kMarkedFrom_m) {
    const double e0 = w - kEdgeLineAt_m - kLine_m, e1 = w - kEdgeLineAt_m, c = kLine_m / 2;
    fill(-w, -e1, Paint::none);
    fill(-e1, -e0, Paint::always);
    fill(-e0, -c, Paint::none);
    fill(-c, 0, Paint::dashed);
    fill(0, c, Paint::dashed);
    fill(c, e0, Paint::none);
    fill(e0, e1, Paint::always);
    fill(e1, w, Paint::none);
  } else {
    fill(-w, 0, Paint::none);
    fill(0, w, Paint::none);
  }
  out.push_back({1.0, Paint::none});
  return out;
}

class Road {
 public:
  explicit Road(const RoadSpec& spec) : spec_(spec), columns_(columns_of(spec)) {}

  std::vector<RoadPiece> make() {
    const auto corners = ribbon(spec_.line, spec_.width_m / 2);
    for (const CrossSection& c : corners) {
      if (std::isfinite(somewhere_)) break;
      somewhere_ = ground_at(c.middle);
    }
    if (!std::isfinite(somewhere_)) somewhere_ = 0;
    for (std::size_t i = 0; i + 1 < corners.size(); ++i) {
      stations_.push_back(corners[i]);
      if (corners[i + 1].along_m > corners[i].along_m) subdivide(corners[i], corners[i + 1]);
    }
    stations_.push_back(corners.back());
    place();
    std::vector<RoadPiece> pieces;
    for (std::size_t first = 0; first + 1 < stations_.size();) {
      std::size_t last = first + 1;
      while (last + 1 < stations_.size() && stations_[last].along_m - stations_[first].along_m < kPiece_m)
        ++last;
      pieces.push_back(piece(first, last));
      first = last;
    }
    return pieces;
  }

 private:
  [[nodiscard]] double ground_at(const Vector2d& p) const {
    return spec_.ground ? spec_.ground(p) : std::numeric_limits<double>::quiet_NaN();
  }

  // Stations strictly between two corners: at the ends of dashes, and as near as the ground asks.
  void subdivide(const CrossSection& a, const CrossSection& b) {
    const double length = b.along_m - a.along_m;
    std::vector<double> cuts{0.0, 1.0};
    if (std::any_of(columns_.begin(), columns_.end(),
                    [](const Column& c) { return c.paint == Paint::dashed; }))
      for (double k = std::floor(a.along_m / kDashPeriod_m); k * kDashPeriod_m < b.along_m; ++k)
        for (const double at : {k * kDashPeriod_m, k * kDashPeriod_m + kDash_m})
          if (at > a.along_m + 0.01 && at < b.along_m - 0.01) cuts.push_back((at - a.along_m) / length);
    std::sort(cuts.begin(), cuts.end());
    for (std::size_t i = 0; i + 1 < cuts.size(); ++i) {
      if (i > 0) stations_.push_back(between(a, b, cuts[i]));
      halve(a, b, cuts[i], cuts[i + 1], length);
    }
  }
  void halve(const CrossSection& a, const CrossSection& b, double f0, double f1, double length) {
    const double own = (f1 - f0) * length;
    if (own < 2 * kShortest_m || (own < kLongest_m && !bends(a, b, f0, f1))) return;
    const double middle = (f0 + f1) / 2;
    halve(a, b, f0, middle, length);
    stations_.push_back(between(a, b, middle));
    halve(a, b, middle, f1, length);
  }
  [[nodiscard]] bool bends(const CrossSection& a, const CrossSection& b, double f0, double f1) const {
    for (const double s : {-1.0, 0.0, 1.0}) {
      const auto z = [&](double f) { return ground_at(between(a, b, f).at(s)); };
      const double z0 = z(f0), z1 = z(f1);
      for (const double f : {0.25, 0.5, 0.75})
        if (std::abs(z(f0 + f * (f1 - f0)) - (z0 + f * (z1 - z0))) > kSag_m) return true;
    }
    return false;
  }

  [[nodiscard]] std::size_t at(std::size_t station, std::size_t column) const {
    return station * columns_.size() + column;
  }

  void place() {
    const bool paved = spec_.surface == RoadSurface::asphalt || spec_.surface == RoadSurface::concrete;
    const double crown_m = (paved ? 0.025 : 0.03) * spec_.width_m / 2;
    const std::size_t n = columns_.size();
    std::vector<double> last_ground(n, somewhere_);
    for (std::size_t i = 0; i < stations_.size(); ++i)
      for (std::size_t j = 0; j < n; ++j) {
        const Vector2d p = stations_[i].at(columns_[j].s);
        double& ground = last_ground[j];
        if (const double z = ground_at(p); std::isfinite(z)) ground = z;
        const double from_middle = (p - stations_[i].middle).norm() / (spec_.width_m / 2);
        points_.emplace_back(p.x(), p.y(), ground + kLift_m + crown_m * std::max(0.0, 1 - from_middle));
      }
    normals_.assign(points_.size(), Vector3d::Zero());
    for (std::size_t i = 0; i + 1 < stations_.size(); ++i)
      for (std::size_t j = 0; j + 1 < n; ++j)
        each_triangle(i, j, [&](std::size_t p, std::size_t q, std::size_t r) {
          const Vector3d area = (points_[q] - points_[p]).cross(points_[r] - points_[p]);
          for (const std::size_t k : {p, q, r}) normals_[k] += area;
        });
    for (Vector3d& v : normals_)
      v = v.norm() > 1e-12 ? Vector3d(v.normalized()) : Vector3d(Vector3d::UnitZ());
  }

  // The two triangles of a cell, less what has no area (the inside of a turning section).
  template <class Visit>
  void each_triangle(std::size_t i, std::size_t j, const Visit& visit) const {
    const std::size_t a = at(i, j), b = at(i + 1, j), c = at(i + 1, j + 1), d = at(i, j + 1);
    const auto put = [&](std::size_t p, std::size_t q, std::size_t r) {
      const Vector2d u = (points_[q] - points_[p]).head<2>(), v = (points_[r] - points_[p]).head<2>();
      if (u.x() * v.y() - u.y() * v.x() > 1e-9) visit(p, q, r);
    };
    put(a, b, c);
    put(a, c, d);
  }

  RoadPiece piece(std::size_t first, std::size_t last) const {
    const std::size_t n = columns_.size();
    Vector3d origin = points_[at((first + last) / 2, n / 2)];
    origin = origin.array().round();
    const Finish finish = spec_.surface == RoadSurface::asphalt    ? Finish::asphalt
                          : spec_.surface == RoadSurface::concrete ? Finish::concrete
                          : spec_.surface == RoadSurface::gravel   ? Finish::gravel
                                                                   : Finish::soil;
    const Cover c = spec_.own_cover ? Cover{spec_.own_cover, repeats_of(*spec_.own_cover)} : cover(finish);
    // Whole repeats are left out, so that a picture stays sharp far along the road.
    const double v0 = std::floor(stations_[first].along_m * c.repeats_per_m);
    const auto vertex = [&](std::size_t i, std::size_t j, double down_m, const Vector3d& normal) {
      Vertex v{};
      const Vector3d p = points_[at(i, j)] - origin - Vector3d(0, 0, down_m);
      for (int k = 0; k < 3; ++k) {
        v.position[k] = static_cast<float>(p[k]);
        v.normal[k] = static_cast<float>(normal[k]);
      }
      v.uv[0] = static_cast<float>((-columns_[j].s * spec_.width_m / 2 + down_m) * c.repeats_per_m);
      v.uv[1] = static_cast<float>(v0 - stations_[i].along_m * c.repeats_per_m);
      return v;
    };
    std::vector<Vertex> top;
    for (std::size_t i = first; i <= last; ++i)
      for (std::size_t j = 0; j < n; ++j) top.push_back(vertex(i, j, 0, normals_[at(i, j)]));
    std::vector<std::uint32_t> plain, painted;
    for (std::size_t i = first; i < last; ++i) {
      const double middle = (stations_[i].along_m + stations_[i + 1].along_m) / 2;
      const bool dash = std::fmod(middle, kDashPeriod_m) < kDash_m;
      for (std::size_t j = 0; j + 1 < n; ++j) {
        const Paint paint = columns_[j].paint;
        auto& into = paint == Paint::always || (paint == Paint::dashed && dash) ? painted : plain;
        each_triangle(i, j, [&](std::size_t p, std::size_t q, std::size_t r) {
          for (const std::size_t k : {p, q, r}) into.push_back(static_cast<std::uint32_t>(k - at(first, 0)));
        });
      }
    }
    render::MeshBuilder mesh;
    if (!plain.empty()) mesh.append(c.surface, top, plain);
    if (!painted.empty()) mesh.append(cover(Finish::road_marking).surface, top, painted);
    const auto skirt = [&](std::size_t i0, std::size_t j0, std::size_t i1, std::size_t j1) {
      const Vector3d along = points_[at(i1, j1)] - points_[at(i0, j0)];
      if (!(along.head<2>().norm() > 1e-6)) return;
      const Vector3d out = Vector3d(along.y(), -along.x(), 0).normalized();
      const Vertex v[] = {vertex(i0, j0, kSkirt_m, out), vertex(i1, j1, kSkirt_m, out),
                          vertex(i1, j1, 0, out), vertex(i0, j0, 0, out)};
      const std::uint32_t indices[] = {0, 1, 2, 0, 2, 3};
      mesh.append(c.surface, v, indices);
    };
    for (std::size_t i = first; i < last; ++i) {
      skirt(i, 0, i + 1, 0);
      skirt(i + 1, n - 1, i, n - 1);
    }
    for (std::size_t j = 0; j + 1 < n; ++j) {
      if (first == 0) skirt(0, j + 1, 0, j);
      if (last + 1 == stations_.size()) skirt(last, j, last, j + 1);
    }
    return {origin, mesh.finish()};
  }

  const RoadSpec& spec_;
  std::vector<Column> columns_;
  std::vector<CrossSection> stations_;
  std::vector<Vector3d> points_, normals_;  // station by station
  double somewhere_ = std::numeric_limits<double>::quiet_NaN();
};

}  // namespace

std::vector<RoadPiece> make_road(const RoadSpec& spec) { return Road(spec).make(); }

}  // namespace rigor::nature::built

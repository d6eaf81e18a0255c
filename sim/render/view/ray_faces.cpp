#include "sim/render/view/ray_faces.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <numbers>

namespace rigor::render {
namespace {

using std::numbers::pi;
/// Elevation from which on a ray belongs to the top or the bottom.
constexpr double kSide = 0.7071067811865476;
/// A side spans no more than this, so that its texels do not grow too small at its edges.
constexpr double kSideSpan_rad = 95.0 / 180 * pi;

Eigen::Vector3d direction_of(const Ray& r) {
  return Eigen::Vector3d(r.direction[0], r.direction[1], r.direction[2]);
}

Eigen::Matrix3d axes(const Eigen::Vector3d& forward, const Eigen::Vector3d& up) {
  Eigen::Matrix3d r;
  r.col(2) = forward.normalized();
  Eigen::Vector3d right = r.col(2).cross(up);
  if (right.norm() < 1e-6) right = r.col(2).unitOrthogonal();
  r.col(0) = right.normalized();
  r.col(1) = r.col(2).cross(r.col(0));
  return r;
}

/// Turned about its axis so that the rays fill a rectangle along its sides.
Eigen::Matrix3d aligned(const Eigen::Matrix3d& face, std::span<const Ray> rays,
                        std::span<const std::uint32_t> which) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  Eigen::Matrix2d square = Eigen::Matrix2d::Zero();
  for (const std::uint32_t i : which) {
    const Eigen::Vector3d d = face.transpose() * direction_of(rays[i]);
    const Eigen::Vector2d t(d.x() / d.z(), d.y() / d.z());
    mean += t;
    square += t * t.transpose();
  }
  mean /= static_cast<double>(which.size());
  const Eigen::Matrix2d spread = square / static_cast<double>(which.size()) - mean * mean.transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> solver(spread);
  // As wide as high: any turn is as good, and upright ones fill their rectangles.
  if (!(solver.eigenvalues()[1] > 1.05 * solver.eigenvalues()[0])) return face;
  Eigen::Vector2d along = solver.eigenvectors().col(1);
  if (along.x() < 0 || (along.x() == 0 && along.y() < 0)) along = -along;
  Eigen::Matrix3d turn;
  turn << along.x(), -along.y(), 0, along.y(), along.x(), 0, 0, 0, 1;
  return face * turn;
}

/// The axis about which rays all round lie: where they are fewest. The world's own where it is as good.
Eigen::Vector3d pole_of(std::span<const Ray> rays, std::span<const std::uint32_t> which) {
  Eigen::Matrix3d square = Eigen::Matrix3d::Zero();
  for (const std::uint32_t i : which) {
    const Eigen::Vector3d d = direction_of(rays[i]);
    square += d * d.transpose();
  }
  square /= static_cast<double>(which.size());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(square);
  if (square(2, 2) <= 1.05 * solver.eigenvalues()[0] + 1e-4) return Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d pole = solver.eigenvectors().col(0);
  return pole.z() < 0 ? Eigen::Vector3d(-pole) : pole;
}

/// Where within a texel rays mostly go: of rays that lie in a grid of as many texels (the pixels of a
/// camera), so that each gets a texel of its own, drawn where the ray goes. 0 where they lie anyhow.
class Phase {
 public:
  void add(double px) {
    sum_ += std::polar(1.0, 2 * pi * (px - std::floor(px)));
    ++count_;
  }
  [[nodiscard]] double get() const {
    return std::abs(sum_) > 0.5 * static_cast<double>(count_) ? std::arg(sum_) / (2 * pi) : 0.0;
  }

 private:
  std::complex<double> sum_;
  std::size_t count_ = 0;
};

/// Cuts a face to its rays, and into parts where it is too large.
void cut(const Eigen::Matrix3d& axes_of_face, const std::vector<std::uint32_t>& which,
         std::span<const Ray> rays, const FaceOptions& o, std::vector<RayFace>& out) {
  if (which.empty()) return;
  struct Place {
    double u = 0, v = 0;
  };
  std::vector<Place> places(which.size());
  Phase across_u, across_v;
  constexpr double kFar = 1e300;
  double u0 = kFar, u1 = -kFar, v0 = kFar, v1 = -kFar, farthest = 0;
  for (std::size_t k = 0; k < which.size(); ++k) {
    const Eigen::Vector3d d = axes_of_face.transpose() * direction_of(rays[which[k]]);
    const double u = o.pixels_per_rad * d.x() / d.z(), v = o.pixels_per_rad * d.y() / d.z();
    places[k] = {u, v};
    across_u.add(u);
    across_v.add(v);
    u0 = std::min(u0, u);
    u1 = std::max(u1, u);
    v0 = std::min(v0, v);
    v1 = std::max(v1, v);
    farthest = std::max(farthest, u * u + v * v);
  }
  // A texel round what is used: sampling looks at neighbours.
  const double phase_u = across_u.get(), phase_v = across_v.get();
  const auto texel_u = [&](double u) { return std::floor(u - phase_u + 0.5); };
  const auto texel_v = [&](double v) { return std::floor(v - phase_v + 0.5); };
  const double left = texel_u(u0) - 1 + phase_u, top = texel_v(v0) - 1 + phase_v;
  const double width = texel_u(u1) - texel_u(u0) + 3, height = texel_v(v1) - texel_v(v0) + 3;
  const double cosine = 1.0 / std::sqrt(1.0 + farthest / (o.pixels_per_rad * o.pixels_per_rad));
  const auto finish = [&](double part_left, double part_top, double part_width, double part_height) {
    RayFace f;
    f.R_world_face = axes_of_face;
    f.pinhole.width_px = static_cast<int>(part_width);
    f.pinhole.height_px = static_cast<int>(part_height);
    f.pinhole.fx_px = f.pinhole.fy_px = o.pixels_per_rad;
    f.pinhole.cx_px = -part_left;
    f.pinhole.cy_px = -part_top;
    f.pinhole.near_m = o.near_m * cosine;
    return f;
  };
  const auto put = [&](RayFace& f, std::size_t k) {
    f.rays.push_back(which[k]);
    f.at_px.push_back({static_cast<float>(places[k].u + f.pinhole.cx_px),
                       static_cast<float>(places[k].v + f.pinhole.cy_px)});
  };
  if (width <= o.largest_side_px && height <= o.largest_side_px) {
    RayFace f = finish(left, top, width, height);
    f.rays.reserve(which.size());
    f.at_px.reserve(which.size());
    for (std::size_t k = 0; k < which.size(); ++k) put(f, k);
    out.push_back(std::move(f));
    return;
  }
  // Parts of equal size, those without rays left out.
  const double step = std::max(o.largest_side_px - 3, 1);
  const auto across = static_cast<std::size_t>(std::ceil(width / step));
  std::vector<std::vector<std::size_t>> of_part(across * static_cast<std::size_t>(std::ceil(height / step)));
  for (std::size_t k = 0; k < which.size(); ++k)
    of_part[static_cast<std::size_t>((texel_v(places[k].v) - texel_v(v0)) / step) * across +
            static_cast<std::size_t>((texel_u(places[k].u) - texel_u(u0)) / step)]
        .push_back(k);
  for (const auto& part : of_part) {
    std::vector<std::uint32_t> some;
    some.reserve(part.size());
    for (const std::size_t k : part) some.push_back(which[k]);
    cut(axes_of_face, some, rays, o, out);
  }
}

}  // namespace

std::vector<RayFace> faces_for(std::span<const Ray> rays, std::span<const std::uint32_t> which,
                               const FaceOptions& o) {
  std::vector<RayFace> out;
  if (which.empty()) return out;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const std::uint32_t i : which) mean += direction_of(rays[i]);
  if (mean.norm() > 1e-3 * static_cast<double>(which.size())) {
    mean.normalize();
    double least = 1;
    for (const std::uint32_t i : which) least = std::min(least, direction_of(rays[i]).dot(mean));
    if (least >= std::cos(kOneView_rad)) {
      const Eigen::Matrix3d face = aligned(axes(mean, Eigen::Vector3d::UnitZ()), rays, which);
      cut(face, {which.begin(), which.end()}, rays, o, out);
      return out;
    }
  }
  const Eigen::Vector3d pole = pole_of(rays, which);
  const Eigen::Vector3d east = axes(pole, Eigen::Vector3d::UnitY()).col(0), north = pole.cross(east);
  const auto azimuth = [&](const Eigen::Vector3d& d) { return std::atan2(d.dot(north), d.dot(east)); };
  // Where nothing looks, in degrees.
  constexpr int kBins = 360;
  std::array<bool, kBins> used{};
  std::vector<std::uint32_t> sides, up, down;
  for (const std::uint32_t i : which) {
    const Eigen::Vector3d d = direction_of(rays[i]);
    const double z = d.dot(pole);
    if (std::abs(z) > kSide) {
      (z > 0 ? up : down).push_back(i);
      continue;
    }
    sides.push_back(i);
    used[static_cast<std::size_t>(std::clamp((azimuth(d) / pi + 1) * 0.5 * kBins, 0.0, kBins - 1.0))] = true;
  }
  int gap = 0, gap_end = 0;
  for (int run = 0, k = 0; k < 2 * kBins; ++k) {
    run = used[static_cast<std::size_t>(k % kBins)] ? 0 : run + 1;
    if (run > gap && run <= kBins) gap = run, gap_end = k + 1;
  }
  const double span = (kBins - gap) * 2 * pi / kBins;
  const double begin = (static_cast<double>(gap_end % kBins) / kBins * 2 - 1) * pi;
  const int count = std::max(1, static_cast<int>(std::ceil(span / kSideSpan_rad)));
  std::vector<std::vector<std::uint32_t>> of_side(static_cast<std::size_t>(count));
  for (const std::uint32_t i : sides) {
    double a = azimuth(direction_of(rays[i])) - begin;
    a -= std::floor(a / (2 * pi)) * 2 * pi;
    of_side[static_cast<std::size_t>(std::clamp(static_cast<int>(a / span * count), 0, count - 1))].push_back(
        i);
  }
  for (int k = 0; k < count; ++k) {
    const double a = begin + (k + 0.5) * span / count;
    cut(axes(std::cos(a) * east + std::sin(a) * north, pole), of_side[static_cast<std::size_t>(k)], rays, o,
        out);
  }
  cut(axes(pole, north), up, rays, o, out);
  cut(axes(-pole, north), down, rays, o, out);
  return out;
}

}  // namespace rigor::render

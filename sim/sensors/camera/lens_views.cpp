#include "sim/sensors/camera/lens_views.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

namespace rigor {
namespace {

/// A lens that sees no further than this to a side is one view.
constexpr double kWidestTangent = 2.2;
/// Beyond the outermost reading.
constexpr int kMargin_px = 2;
constexpr int kMaxSide_px = 8192;
/// Less than this share of a view pixel beside a pixel's centre is rounding.
constexpr double kRounding_px = 1e-4;

/// Axes of a cube's face in the optical frame: right, down, forward.
Eigen::Matrix3d face(int i) {
  Eigen::Vector3d forward = Eigen::Vector3d::UnitZ(), down = Eigen::Vector3d::UnitY();
  switch (i) {
    case 1:
      forward = Eigen::Vector3d::UnitX();
      break;
    case 2:
      forward = -Eigen::Vector3d::UnitX();
      break;
    case 3:
      forward = Eigen::Vector3d::UnitY();
      down = -Eigen::Vector3d::UnitZ();
      break;
    case 4:
      forward = -Eigen::Vector3d::UnitY();
      down = Eigen::Vector3d::UnitZ();
      break;
    case 5:
      forward = -Eigen::Vector3d::UnitZ();
      break;
    default:
      break;
  }
  Eigen::Matrix3d r;
  r << down.cross(forward), down, forward;
  return r;
}

std::size_t face_of(const Eigen::Vector3f& d) {
  const Eigen::Vector3f a = d.cwiseAbs();
  if (a.z() >= a.x() && a.z() >= a.y()) return d.z() > 0 ? 0 : 5;
  if (a.x() >= a.y()) return d.x() > 0 ? 1 : 2;
  return d.y() > 0 ? 3 : 4;
}

struct Extent {
  double x0 = 1e300, x1 = -1e300, y0 = 1e300, y1 = -1e300;
  void add(double x, double y) {
    x0 = std::min(x0, x);
    x1 = std::max(x1, x);
    y0 = std::min(y0, y);
    y1 = std::max(y1, y);
  }
};

}  // namespace

Result<LensViews> LensViews::of(const CameraModel& camera, const std::vector<int>& channels,
                                double supersampling, int border_px) {
  LensViews out;
  for (const int c : channels) out.grids_.emplace_back(camera, c, border_px);
  const int side = std::clamp(static_cast<int>(std::ceil(supersampling)), 1, 4);
  bool one = true;
  for (const LensGrid& grid : out.grids_)
    for (const auto& p : grid.pixels())
      if (p.lit() && !(p.ray.z() > 0 && std::max(std::abs(p.ray.x()), std::abs(p.ray.y())) <=
                                            static_cast<float>(kWidestTangent) * p.ray.z()))
        one = false;
  std::array<Extent, 6> extent;
  const auto each_reading = [&](const LensGrid::Pixel& p, auto&& use) {
    for (int j = 0; j < side; ++j)
      for (int i = 0; i < side; ++i) {
        const auto at = [&](int k) {
          return (static_cast<float>(k) + 0.5F) / static_cast<float>(side) - 0.5F;
        };
        use(p.lit() && side > 1 ? p.at(at(i), at(j)) : p.ray, j * side + i);
      }
  };
  std::array<Eigen::Matrix3d, 6> axes;
  for (int i = 0; i < 6; ++i) axes[static_cast<std::size_t>(i)] = face(i);
  for (const LensGrid& grid : out.grids_)
    for (const auto& p : grid.pixels()) {
      if (!p.lit()) continue;
      const std::size_t f = one ? 0 : face_of(p.ray);  // all readings of a pixel in one view
      each_reading(p, [&](const Eigen::Vector3f& d, int) {
        const Eigen::Vector3d q = axes[f].transpose() * d.cast<double>();
        extent[f].add(q.x() / q.z(), q.y() / q.z());
      });
    }
  const double fx = camera.fx_px * supersampling, fy = camera.fy_px * supersampling;
  std::array<std::size_t, 6> view_of{};
  for (std::size_t f = 0; f < 6; ++f) {
    const Extent& e = extent[f];
    if (e.x1 < e.x0) continue;
    LensView view;
    view.R_sensor_view = axes[f];
    // Where the lens does not distort, readings fall on centres of view pixels.
    const double half = side % 2 == 0 ? 0.5 : 0.0;
    render::Pinhole& p = view.pinhole;
    p.fx_px = fx;
    p.fy_px = fy;
    const auto centre = [&](double low, double f_px, double centre_px) {
      const double wanted = kMargin_px - low * f_px;
      if (!one) return wanted;
      // Of a reading at (c − sensor centre)·supersampling the fraction is known: keep it whole.
      const double fraction = centre_px * supersampling - std::floor(centre_px * supersampling);
      return std::ceil(wanted - fraction) + fraction + half;
    };
    p.cx_px = centre(e.x0, fx, camera.cx_px);
    p.cy_px = centre(e.y0, fy, camera.cy_px);
    const double width = std::ceil(p.cx_px + e.x1 * fx) + kMargin_px + 1,
                 height = std::ceil(p.cy_px + e.y1 * fy) + kMargin_px + 1;
    if (!(width <= kMaxSide_px && height <= kMaxSide_px))
      return fail(ErrorCode::bad_input, "camera model",
                  "lens: its views need " + std::to_string(static_cast<long long>(width)) + "x" +
                      std::to_string(static_cast<long long>(height)) + " px, expected at most " +
                      std::to_string(kMaxSide_px) + " a side: choose less supersampling");
    p.width_px = static_cast<int>(width);
    p.height_px = static_cast<int>(height);
    p.near_m = 0.01;
    view.first = out.pixels_;
    out.pixels_ += static_cast<std::size_t>(p.width_px) * static_cast<std::size_t>(p.height_px);
    view_of[f] = out.views_.size();
    out.views_.push_back(view);
  }
  if (out.views_.empty())
    return fail(ErrorCode::bad_input, "camera model",
                "lens: expected coefficients under which light reaches a pixel, got none");

  for (const LensGrid& grid : out.grids_) {
    ResampleMap map;
    map.taps_per_pixel = side * side;
    map.taps.resize(grid.pixels().size() * static_cast<std::size_t>(map.taps_per_pixel));
    tbb::parallel_for(std::size_t{0}, grid.pixels().size(), [&](std::size_t i) {
      const auto& pixel = grid.pixels()[i];
      if (!pixel.lit()) return;
      const std::size_t f = one ? 0 : face_of(pixel.ray);
      const LensView& view = out.views_[view_of[f]];
      each_reading(pixel, [&](const Eigen::Vector3f& d, int k) {
        const Eigen::Vector3d q = axes[f].transpose() * d.cast<double>();
        const auto settle = [](double x) {
          return std::abs(x - std::round(x)) < kRounding_px ? std::round(x) : x;
        };
        const double x = settle(view.pinhole.fx_px * q.x() / q.z() + view.pinhole.cx_px),
                     y = settle(view.pinhole.fy_px * q.y() / q.z() + view.pinhole.cy_px);
        const double left = std::clamp(std::floor(x), 0.0, view.pinhole.width_px - 2.0),
                     top = std::clamp(std::floor(y), 0.0, view.pinhole.height_px - 2.0);
        ViewTap& tap =
            map.taps[i * static_cast<std::size_t>(map.taps_per_pixel) + static_cast<std::size_t>(k)];
        tap.index = static_cast<std::uint32_t>(
            view.first + static_cast<std::size_t>(top) * static_cast<std::size_t>(view.pinhole.width_px) +
            static_cast<std::size_t>(left));
        tap.view = static_cast<std::uint32_t>(view_of[f]);
        tap.x = static_cast<float>(std::clamp(x - left, 0.0, 1.0));
        tap.y = static_cast<float>(std::clamp(y - top, 0.0, 1.0));
      });
    });
    out.maps_.push_back(std::move(map));
  }
  const LensGrid& grid = out.grids_.front();
  out.rows_of_.assign(static_cast<std::size_t>(grid.height_px()), {});
  const int width = out.views_.front().pinhole.width_px;
  for (const ResampleMap& map : out.maps_)
    for (std::size_t i = 0; i < map.taps.size(); ++i) {
      if (map.taps[i].index == ViewTap::kNowhere) continue;
      Rows& r = out.rows_of_[i / static_cast<std::size_t>(map.taps_per_pixel) /
                             static_cast<std::size_t>(grid.width_px())];
      const int row = static_cast<int>(map.taps[i].index / static_cast<std::uint32_t>(width));
      if (r.last == 0) r = {row, row + 2};
      r.first = std::min(r.first, row);
      r.last = std::max(r.last, row + 2);
    }
  return out;
}

LensViews::Rows LensViews::rows_read(int first, int last) const {
  if (views_.size() != 1) return {0, std::numeric_limits<int>::max()};
  const int border = grids_.front().border_px();
  Rows all;
  for (int v = std::max(first, 0); v < std::min(last + 2 * border, static_cast<int>(rows_of_.size())); ++v) {
    const Rows& r = rows_of_[static_cast<std::size_t>(v)];
    if (r.last == 0) continue;
    if (all.last == 0) all = r;
    all.first = std::min(all.first, r.first);
    all.last = std::max(all.last, r.last);
  }
  return all;
}

}  // namespace rigor

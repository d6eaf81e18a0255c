#include "sim/render/scene/lens_rays.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/models/one_source.h"

namespace rigor::render {
namespace {

/// Eight rooks on a board of eight by eight, none near another.
constexpr std::array<int, LensRays::kFine> kRookRow = {1, 4, 7, 2, 5, 0, 3, 6};

}  // namespace

Result<LensRays> LensRays::create(const CameraModel& c) {
  LensRays s;
  s.width_px_ = c.width_px;
  s.height_px_ = c.height_px;
  const auto f = [](double v) { return static_cast<float>(v); };
  s.per_fx_ = f(1 / c.fx_px);
  s.per_fy_ = f(1 / c.fy_px);
  const std::size_t pixels = static_cast<std::size_t>(c.width_px) * static_cast<std::size_t>(c.height_px);
  s.u_.assign(pixels + kRayPadding, 0);
  s.v_.assign(pixels + kRayPadding, 0);
  s.width_u_.assign(pixels + kRayPadding, s.per_fx_);
  s.width_v_.assign(pixels + kRayPadding, s.per_fy_);
  std::vector<unsigned char> dark(pixels, 0);  // of bytes: rows are written at the same time
  const auto for_rows = [&](const auto& body) {
    tbb::parallel_for(tbb::blocked_range<int>(0, c.height_px, 8), [&](const tbb::blocked_range<int>& rows) {
      for (int row = rows.begin(); row < rows.end(); ++row)
        for (int column = 0; column < c.width_px; ++column) body(column, row, s.at(column, row));
    });
  };
  for_rows([&](int column, int row, std::size_t i) {
    const OpenCvLens& l = c.lens;
    float x = (static_cast<float>(column) - f(c.cx_px)) / f(c.fx_px);
    float y = (static_cast<float>(row) - f(c.cy_px)) / f(c.fy_px);
    float valid = 1;
    if (l != OpenCvLens{})
      models::LensMath<float>::lens_undistort(x, y, f(l.k1), f(l.k2), f(l.p1), f(l.p2), f(l.k3), f(l.k4),
                                              f(l.k5), f(l.k6), 1e-6f, x, y, valid);
    if (valid > 0.5f)
      s.u_[i] = x, s.v_[i] = y;
    else
      dark[i] = 1;
  });
  const auto unlit = std::count(dark.begin(), dark.end(), 1);
  if (static_cast<std::size_t>(unlit) == pixels)
    return fail(ErrorCode::bad_input, "camera model",
                "lens: expected coefficients under which light reaches a pixel, got none");
  if (unlit > 0) s.dark_.assign(dark.begin(), dark.end());
  for_rows([&](int column, int row, std::size_t i) {
    const Steps d = s.steps(column, row);
    s.width_u_[i] = std::abs(d.column_u);
    s.width_v_[i] = std::abs(d.row_v);
  });
  for (int row = 0; row < c.height_px; ++row)
    for (int first = 0; first < c.width_px; first += kRayTile) {
      Eigen::AlignedBox2f tile;
      for (int x = first; x < std::min(first + kRayTile, c.width_px); ++x)
        tile.extend(Eigen::Vector2f(s.u_[s.at(x, row)], s.v_[s.at(x, row)]));
      s.tiles_.push_back(tile);
    }
  return s;
}

bool LensRays::lit(int x_px, int y_px) const { return dark_.empty() || !dark_[at(x_px, y_px)]; }

RayRow LensRays::row(int x_px, int y_px, int count) const {
  const std::size_t i = at(x_px, y_px);
  const std::size_t tile = static_cast<std::size_t>(y_px) * static_cast<std::size_t>(tiles_of(width_px_)) +
                           static_cast<std::size_t>(x_px / kRayTile);
  return {u_.data() + i,       v_.data() + i, width_u_.data() + i,
          width_v_.data() + i, count,         tiles_.data() + tile};
}

LensRays::Steps LensRays::steps(int x_px, int y_px) const {
  Steps d{per_fx_, 0, 0, per_fy_};
  if (!lit(x_px, y_px)) return d;
  // Between the neighbours that there are: the lens images them, and the sensor has them.
  const auto along = [&](int dx, int dy, float& du, float& dv) {
    std::size_t ends[2];
    int span = 0;
    for (const int side : {0, 1}) {
      const int x = x_px + (side ? dx : -dx), y = y_px + (side ? dy : -dy);
      const bool there = x >= 0 && y >= 0 && x < width_px_ && y < height_px_ && lit(x, y);
      ends[side] = there ? at(x, y) : at(x_px, y_px);
      span += there;
    }
    if (span == 0) return;
    du = (u_[ends[1]] - u_[ends[0]]) / static_cast<float>(span);
    dv = (v_[ends[1]] - v_[ends[0]]) / static_cast<float>(span);
  };
  along(1, 0, d.column_u, d.column_v);
  along(0, 1, d.row_u, d.row_v);
  return d;
}

void LensRays::fine(int x_px, int y_px, float* u, float* v, float* width_u, float* width_v) const {
  const std::size_t i = at(x_px, y_px);
  const Steps d = steps(x_px, y_px);
  const float share = 1 / std::sqrt(static_cast<float>(kFine));
  for (int k = 0; k < kFine; ++k) {
    const float x = (static_cast<float>(k) + 0.5f) / kFine - 0.5f;
    const float y = (static_cast<float>(kRookRow[static_cast<std::size_t>(k)]) + 0.5f) / kFine - 0.5f;
    u[k] = u_[i] + x * d.column_u + y * d.row_u;
    v[k] = v_[i] + x * d.column_v + y * d.row_v;
    width_u[k] = share * width_u_[i];
    width_v[k] = share * width_v_[i];
  }
}

Eigen::AlignedBox2f LensRays::field() const {
  Eigen::AlignedBox2f all;
  for (const Eigen::AlignedBox2f& tile : tiles_) all.extend(tile);
  return all;
}

std::vector<std::array<float, 2>> LensRays::rays() const {
  std::vector<std::array<float, 2>> out(u_.size() - kRayPadding);
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t i = 0; i < out.size(); ++i)
    out[i] = dark_.empty() || !dark_[i] ? std::array{u_[i], v_[i]} : std::array{nan, nan};
  return out;
}

}  // namespace rigor::render

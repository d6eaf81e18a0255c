#include "sim/render/scene/lens_rays.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/models/one_source.h"

namespace rigor::render {
namespace {

constexpr int kFine = LensRays::kFine;

/// Eight rooks on a board of eight by eight, none near another: rows in pixels from the centre, by column.
constexpr std::array<float, kFine> kColumn = {-7.f / 16, -5.f / 16, -3.f / 16, -1.f / 16,
                                              1.f / 16,  3.f / 16,  5.f / 16,  7.f / 16};
constexpr std::array<float, kFine> kRow = {-5.f / 16, 1.f / 16,  7.f / 16,  -3.f / 16,
                                           3.f / 16,  -7.f / 16, -1.f / 16, 5.f / 16};
constexpr float kFineWidth = 0.35355339f;  // 1 / sqrt(kFine)

}  // namespace

Result<LensRays> LensRays::create(const CameraModel& c) {
  LensRays s;
  s.width_px_ = c.width_px;
  s.height_px_ = c.height_px;
  const auto f = [](double v) { return static_cast<float>(v); };
  const std::size_t pixels = static_cast<std::size_t>(c.width_px) * static_cast<std::size_t>(c.height_px);
  for (auto* values : {&s.u_, &s.v_, &s.column_v_, &s.row_u_}) values->assign(pixels + kRayPadding, 0);
  s.column_u_.assign(pixels + kRayPadding, f(1 / c.fx_px));
  s.row_v_.assign(pixels + kRayPadding, f(1 / c.fy_px));
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
  for_rows([&](int column, int row, std::size_t) { s.set_steps(column, row); });
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
  return {u_.data() + i, v_.data() + i, column_u_.data() + i, row_v_.data() + i, count, tiles_.data() + tile};
}

void LensRays::set_steps(int x_px, int y_px) {
  if (!lit(x_px, y_px)) return;
  const std::size_t i = at(x_px, y_px);
  // Between the neighbours that there are: the lens images them, and the sensor has them.
  const auto along = [&](int dx, int dy, float& du, float& dv) {
    std::size_t ends[2];
    int span = 0;
    for (const int side : {0, 1}) {
      const int x = x_px + (side ? dx : -dx), y = y_px + (side ? dy : -dy);
      const bool there = x >= 0 && y >= 0 && x < width_px_ && y < height_px_ && lit(x, y);
      ends[side] = there ? at(x, y) : i;
      span += there;
    }
    if (span == 0) return;
    du = (u_[ends[1]] - u_[ends[0]]) / static_cast<float>(span);
    dv = (v_[ends[1]] - v_[ends[0]]) / static_cast<float>(span);
  };
  along(1, 0, column_u_[i], column_v_[i]);
  along(0, 1, row_u_[i], row_v_[i]);
}

void LensRays::fine(int x_px, int y_px, float* __restrict u, float* __restrict v, float* __restrict width_u,
                    float* __restrict width_v, Eigen::AlignedBox2f& box) const {
  const std::size_t i = at(x_px, y_px);
  const float u0 = u_[i], v0 = v_[i], cu = column_u_[i], cv = column_v_[i], ru = row_u_[i], rv = row_v_[i];
  for (std::size_t k = 0; k < kFine; ++k) {
    u[k] = u0 + kColumn[k] * cu + kRow[k] * ru;
    v[k] = v0 + kColumn[k] * cv + kRow[k] * rv;
    width_u[k] = kFineWidth * cu;
    width_v[k] = kFineWidth * rv;
  }
  const Eigen::Vector2f centre(u0, v0),
      reach(0.5f * (std::abs(cu) + std::abs(ru)), 0.5f * (std::abs(cv) + std::abs(rv)));
  box.extend(centre - reach).extend(centre + reach);
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

#include "sim/render/scene/lens_sampler.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/wide.h"

namespace rigor::render {
namespace {

constexpr int kPictureMargin_px = 2;  // bilinear taps of the outermost pixels stay inside
constexpr int kMaxPictureSide_px = 8192;

RIGOR_WIDE void sample_run(const float* __restrict u, const float* __restrict v, int count, int stride,
                           float shift_u, float shift_v, const float* __restrict picture,
                           float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    const float x = u[i] + shift_u, y = v[i] + shift_v;
    const auto column = static_cast<std::int32_t>(x), row = static_cast<std::int32_t>(y);
    const float fx = x - static_cast<float>(column), fy = y - static_cast<float>(row);
    const std::int32_t at = row * stride + column;
    const float a = picture[at], b = picture[at + 1], c = picture[at + stride], d = picture[at + stride + 1];
    const float top = a + (b - a) * fx, bottom = c + (d - c) * fx;
    out[i] = top + (bottom - top) * fy;
  }
}

RIGOR_WIDE void add_scaled(const float* __restrict from, float scale, int count, float* __restrict to) {
  for (int i = 0; i < count; ++i) to[i] += from[i] * scale;
}

}  // namespace

Result<LensSampler> LensSampler::create(const CameraModel& c, double supersampling) {
  LensSampler s;
  s.width_px_ = c.width_px;
  s.height_px_ = c.height_px;
  const std::size_t pixels = static_cast<std::size_t>(c.width_px) * static_cast<std::size_t>(c.height_px);
  s.u_.resize(pixels);
  s.v_.resize(pixels);
  const auto f = [](double v) { return static_cast<float>(v); };
  tbb::parallel_for(tbb::blocked_range<int>(0, c.height_px, 8), [&](const tbb::blocked_range<int>& rows) {
    for (int row = rows.begin(); row < rows.end(); ++row)
      for (int column = 0; column < c.width_px; ++column) {
        const OpenCvLens& l = c.lens;
        float x = (static_cast<float>(column) - f(c.cx_px)) / f(c.fx_px);
        float y = (static_cast<float>(row) - f(c.cy_px)) / f(c.fy_px);
        float valid = 1;
        if (l != OpenCvLens{})
          models::LensMath<float>::lens_undistort(x, y, f(l.k1), f(l.k2), f(l.p1), f(l.p2), f(l.k3), f(l.k4),
                                                  f(l.k5), f(l.k6), 1e-6f, x, y, valid);
        const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(c.width_px) +
                              static_cast<std::size_t>(column);
        s.u_[i] = valid > 0.5f ? x : std::numeric_limits<float>::quiet_NaN();
        s.v_[i] = valid > 0.5f ? y : std::numeric_limits<float>::quiet_NaN();
      }
  });
  float x0 = std::numeric_limits<float>::infinity(), x1 = -x0, y0 = x0, y1 = -x0;
  for (std::size_t i = 0; i < pixels; ++i) {
    if (!(s.u_[i] == s.u_[i])) continue;
    x0 = std::min(x0, s.u_[i]);
    x1 = std::max(x1, s.u_[i]);
    y0 = std::min(y0, s.v_[i]);
    y1 = std::max(y1, s.v_[i]);
  }
  if (!(x0 <= x1))
    return fail(ErrorCode::bad_input, "camera model",
                "lens: expected coefficients under which light reaches a pixel, got none");
  s.taps_ = static_cast<int>(std::ceil(supersampling));
  s.tap_px_ = f(supersampling / s.taps_);
  PictureGeometry& p = s.picture_;
  p.focal_x_px = c.fx_px * supersampling;
  p.focal_y_px = c.fy_px * supersampling;
  // With an even number of taps a sensor pixel's centre lies between picture pixels, so that its taps fall on
  // them.
  const double shift = kPictureMargin_px + (s.taps_ % 2 == 0 ? 0.5 : 0.0) + supersampling;
  p.centre_u_px = shift - static_cast<double>(x0) * p.focal_x_px;
  p.centre_v_px = shift - static_cast<double>(y0) * p.focal_y_px;
  const double width = std::ceil(static_cast<double>(x1 - x0) * p.focal_x_px + 2 * shift) + 1;
  const double height = std::ceil(static_cast<double>(y1 - y0) * p.focal_y_px + 2 * shift) + 1;
  if (!(width <= kMaxPictureSide_px && height <= kMaxPictureSide_px))
    return fail(
        ErrorCode::bad_input, "camera model",
        "lens: its rays reach tan x = " + std::to_string(std::max(-x0, x1)) +
            ", tan y = " + std::to_string(std::max(-y0, y1)) + ", which needs a pinhole picture of " +
            std::to_string(width) + "x" + std::to_string(height) + " px; expected at most " +
            std::to_string(kMaxPictureSide_px) +
            " a side: choose a narrower lens, less supersampling, or give the channel `renderer: rays`");
  p.width_px = static_cast<int>(width);
  p.height_px = static_cast<int>(height);
  for (std::size_t i = 0; i < pixels; ++i) {
    const bool lit = s.u_[i] == s.u_[i];
    s.u_[i] = lit ? f(static_cast<double>(s.u_[i]) * p.focal_x_px + p.centre_u_px) : 3.0f;
    s.v_[i] =
        lit ? f(static_cast<double>(s.v_[i]) * p.focal_y_px + p.centre_v_px) : f(p.height_px + kDarkRows / 2);
  }
  return s;
}

PictureArea LensSampler::seen_by(int x_px, int y_px, int width_px, int height_px) const {
  float u0 = std::numeric_limits<float>::infinity(), u1 = -u0, v0 = u0, v1 = -u0;
  for (int y = y_px; y < y_px + height_px; ++y)
    for (int x = x_px; x < x_px + width_px; ++x) {
      const std::size_t i =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px_) + static_cast<std::size_t>(x);
      if (v_[i] >= static_cast<float>(picture_.height_px)) continue;
      u0 = std::min(u0, u_[i]);
      u1 = std::max(u1, u_[i]);
      v0 = std::min(v0, v_[i]);
      v1 = std::max(v1, v_[i]);
    }
  if (!(u0 <= u1)) return {};
  const float reach = 0.5f * static_cast<float>(taps_ - 1) * tap_px_;
  const auto clip = [](float v, int size) { return std::clamp(static_cast<int>(v), 0, size); };
  return {clip(u0 - reach, picture_.width_px), clip(v0 - reach, picture_.height_px),
          clip(u1 + reach + 2, picture_.width_px), clip(v1 + reach + 2, picture_.height_px)};
}

void LensSampler::sample(int x_px, int y_px, int count, const float* even, const float* odd,
                         float* out) const {
  constexpr int kRun = 256;
  const std::size_t first =
      static_cast<std::size_t>(y_px) * static_cast<std::size_t>(width_px_) + static_cast<std::size_t>(x_px);
  alignas(32) float one[kRun], other[kRun];
  const auto mean = [&](std::size_t at, int n, const float* picture, float* to) {
    if (taps_ == 1) {
      sample_run(u_.data() + at, v_.data() + at, n, picture_.width_px, 0.0f, 0.0f, picture, to);
      return;
    }
    alignas(32) float tap[kRun];
    std::fill_n(to, n, 0.0f);
    const float begin = -0.5f * static_cast<float>(taps_ - 1);
    const float share = 1.0f / static_cast<float>(taps_ * taps_);
    for (int j = 0; j < taps_; ++j)
      for (int i = 0; i < taps_; ++i) {
        sample_run(u_.data() + at, v_.data() + at, n, picture_.width_px,
                   (static_cast<float>(i) + begin) * tap_px_, (static_cast<float>(j) + begin) * tap_px_,
                   picture, tap);
        add_scaled(tap, share, n, to);
      }
  };
  for (int x = 0; x < count; x += kRun) {
    const int n = std::min(kRun, count - x);
    mean(first + static_cast<std::size_t>(x), n, even, one);
    if (odd != even) {
      mean(first + static_cast<std::size_t>(x), n, odd, other);
      for (int i = (x_px + x) % 2 == 0 ? 1 : 0; i < n; i += 2) one[i] = other[i];
    }
    std::copy_n(one, n, out + x);
  }
}

std::vector<std::array<float, 2>> LensSampler::rays() const {
  std::vector<std::array<float, 2>> out(u_.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    const bool lit = v_[i] < static_cast<float>(picture_.height_px);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    out[i] = {static_cast<float>(
                  lit ? (static_cast<double>(u_[i]) - picture_.centre_u_px) / picture_.focal_x_px : nan),
              static_cast<float>(
                  lit ? (static_cast<double>(v_[i]) - picture_.centre_v_px) / picture_.focal_y_px : nan)};
  }
  return out;
}

}  // namespace rigor::render

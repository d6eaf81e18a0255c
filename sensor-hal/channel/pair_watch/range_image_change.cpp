#include "sensor-hal/channel/pair_watch/range_image_change.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

namespace rigor::pair_watch {
namespace {

enum Place : std::size_t {
  kOffset,
  kScale,
  kLow,
  kHigh,
  kAmplitude,
  kNoise,
  kFlying = kNoise + 4,
  kLost,
  kGained
};

struct Plane {
  const std::byte* data;
  std::size_t width;
  double operator()(std::size_t x, std::size_t y) const noexcept {
    float v;
    std::memcpy(&v, data + (y * width + x) * sizeof v, sizeof v);
    return double{v};
  }
};

}  // namespace

Result<RangeImageChange> RangeImageChange::make(const RangeImageInfo& shape,
                                                const RangeImageChangeOptions& o) {
  if (shape.width_px < 8 || shape.height_px < 8)
    return fail(ErrorCode::bad_input, "shape",
                "expected at least 8x8 pixels, got " + std::to_string(shape.width_px) + "x" +
                    std::to_string(shape.height_px));
  if (!(o.noise_exponent >= 0 && o.noise_exponent <= 2))
    return fail(ErrorCode::bad_input, "noise_exponent",
                "expected 0 to 2, got " + std::to_string(o.noise_exponent));
  if (!(o.sigma_m > 0) || !(o.amplitude_max > 0) || !(o.edge_m > 0))
    return fail(ErrorCode::bad_input, "range image",
                "expected sigma_m, amplitude_max and edge_m above 0, got " + std::to_string(o.sigma_m) +
                    ", " + std::to_string(o.amplitude_max) + ", " + std::to_string(o.edge_m));
  return RangeImageChange(shape, o);
}

RangeImageChange::RangeImageChange(const RangeImageInfo& shape, const RangeImageChangeOptions& o)
    : shape_(shape),
      options_(o),
      parameters_{{"offset", "m", 0},
                  {"range scale", "1", 0},
                  {"low amplitude", "m", 0},
                  {"high amplitude", "m", 0},
                  {"amplitude", "1", 0},
                  {"noise", "1", 0},
                  {"noise low amplitude", "1", 0},
                  {"noise middle amplitude", "1", 0},
                  {"noise high amplitude", "1", 0},
                  {"flying", "1", 0},
                  {"lost", "1", 0},
                  {"gained", "1", 0}},
      window_(4),
      amplitude_(1) {}

double RangeImageChange::variance_at(double amplitude) const noexcept {
  const double at_half = options_.sigma_m * options_.sigma_m;
  if (options_.noise_exponent == 0) return at_half;
  // Below a hundredth the model says nothing any more.
  const double share = std::max(0.01, 2 * amplitude / options_.amplitude_max);
  return at_half / std::pow(share, 2 * options_.noise_exponent);
}

bool RangeImageChange::add(const Sample& real, const Sample& simulated) noexcept {
  const auto *a = real.as<RangeImageInfo>(), *b = simulated.as<RangeImageInfo>();
  if (!a || !b || ((real.stamp.validity | simulated.stamp.validity) & (kIncomplete | kCorrupt)) != 0)
    return false;
  for (const RangeImageInfo* i : {a, b})
    if (i->width_px != shape_.width_px || i->height_px != shape_.height_px) return false;
  const std::size_t w = shape_.width_px, h = shape_.height_px, plane = w * h * sizeof(float);
  if (real.size_bytes < plane || simulated.size_bytes < plane) return false;
  const bool amplitudes = real.size_bytes >= 2 * plane && simulated.size_bytes >= 2 * plane;
  const Plane x{real.bytes().data(), w}, y{simulated.bytes().data(), w};
  const Plane ax{real.bytes().data() + (amplitudes ? plane : 0), w};
  const Plane ay{simulated.bytes().data() + (amplitudes ? plane : 0), w};
  const double edge = options_.edge_m, limit = 5 * options_.sigma_m;
  const auto flies = [&](const Plane& p, std::size_t u, std::size_t v) {
    const double l = p(u - 1, v), m = p(u, v), r = p(u + 1, v);
    return std::abs(r - l) > edge && m > std::min(l, r) + limit && m < std::max(l, r) - limit;
  };
  for (std::size_t v = 1; v + 1 < h; ++v)
    for (std::size_t u = 1; u + 1 < w; ++u) {
      const double s = y(u, v), residual = x(u, v) - s;
      const bool has_real = std::isfinite(x(u, v)), has_simulated = std::isfinite(s);
      both_ += has_real && has_simulated, lost_ += !has_real && has_simulated;
      gained_ += has_real && !has_simulated;
      ++looked_at_;
      flying_[0] += flies(x, u, v), flying_[1] += flies(y, u, v);
      if (!std::isfinite(residual)) continue;
      bool smooth = true;  // false also where a neighbour has no return
      for (const double n : {y(u - 1, v), y(u + 1, v), y(u, v - 1), y(u, v + 1)})
        smooth = smooth && std::abs(n - s) <= edge;
      if (!smooth) continue;
      const double level = amplitudes ? ay(u, v) / options_.amplitude_max : 0.5;
      const std::size_t bin = level < 1.0 / 3 ? 0 : level < 2.0 / 3 ? 1 : 2;
      const double variance = variance_at(level * options_.amplitude_max), weight = 1 / (2 * variance);
      // Huber's weight against what noise may do, wide enough for any change that is sought.
      const double far = std::abs(residual) / (edge + 5 * std::sqrt(variance));
      const std::array<WindowFit::Term, 3> terms{
          {{kOffset, 1}, {kScale, s}, {bin == 0 ? std::size_t{kLow} : std::size_t{kHigh}, 1}}};
      const double w_far = far > 1 ? weight / far : weight;
      window_.add({terms.data(), bin == 1 ? 2u : 3u}, residual, w_far);
      // The range itself is noisy: that of the pixels beside is an instrument for the scale.
      const double off = w_far * ((y(u - 1, v) + y(u + 1, v) + y(u, v - 1) + y(u, v + 1)) / 4 - s);
      window_.correct(kScale, -off * s, off * residual);
      weights_ += weight;
      if (amplitudes && std::isfinite(ax(u, v)) && std::isfinite(ay(u, v))) {
        const WindowFit::Term t{0, ay(u, v)};
        amplitude_.add({&t, 1}, ax(u, v) - ay(u, v), 1);
      }
      if (u % 3 != 0) continue;  // so that no residual counts twice
      const double second = x(u - 1, v) - y(u - 1, v) - 2 * residual + x(u + 1, v) - y(u + 1, v);
      if (!std::isfinite(second)) continue;
      noise_sums_.add(second * second / (6 * variance), bin);
    }
  return true;
}

void RangeImageChange::finish(Estimate& e) noexcept {
  e.value.fill(kNaN), e.sigma.fill(kNaN);
  e.left = e.shift_px = kNaN;
  if (window_.count() >= 16) {
    // A thousandth of all pixels says that amplitudes make no difference: decides where nothing else does.
    for (const std::size_t k : {std::size_t{kLow}, std::size_t{kHigh}}) {
      const WindowFit::Term none{k, 1};
      window_.add({&none, 1}, 0, 1e-3 * weights_);
    }
    window_.solve();
    for (std::size_t k = 0; k < 4; ++k) e.value[k] = window_.value(k), e.sigma[k] = window_.sigma(k);
    e.left = std::sqrt(2 * window_.variance()) * options_.sigma_m;
  }
  if (amplitude_.count() >= 16) {
    amplitude_.solve();
    e.value[kAmplitude] = amplitude_.value(0), e.sigma[kAmplitude] = amplitude_.sigma(0);
  }
  noise_sums_.finish(e, kNoise);
  if (looked_at_ > 0) {
    e.value[kFlying] = (flying_[0] - flying_[1]) / looked_at_;
    e.sigma[kFlying] = std::sqrt(flying_[0] + flying_[1] + 1) / looked_at_;
  }
  if (const double all = both_ + lost_ + gained_; all > 0) {
    e.value[kLost] = lost_ / all, e.value[kGained] = gained_ / all;
    e.sigma[kLost] = std::sqrt(lost_ + 1) / all, e.sigma[kGained] = std::sqrt(gained_ + 1) / all;
  }
  window_.clear(), amplitude_.clear();
  weights_ = 0;
  both_ = lost_ = gained_ = flying_[0] = flying_[1] = looked_at_ = 0;
}

}  // namespace rigor::pair_watch

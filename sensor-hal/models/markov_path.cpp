#include "sensor-hal/models/markov_path.h"

#include <cmath>

namespace rigor::models {

std::array<double, 3> normal_draws(PhiloxKey key, NoiseEffect effect, std::uint64_t index,
                                   std::uint32_t element) noexcept {
  const auto words = draw_words(key, effect, index, element);
  std::array<double, 3> z{};
  for (std::size_t i = 0; i < 3; ++i)
    z[i] = NoiseMath<double>::normal_quantile(NoiseMath<double>::unit_from_bits(words[i]));
  return z;
}

namespace {
constexpr std::uint64_t kEnd = std::uint64_t{1} << MarkovPath::kLevels;
// Middles lie at 1 to 2^40 − 1, so the ends' draws have counters of their own.
constexpr std::uint64_t kLowDraw = 0, kHighDraw = kEnd;
}  // namespace

MarkovPath MarkovPath::stationary(PhiloxKey key, NoiseEffect effect, std::uint32_t stream,
                                  double correlation_captures) {
  MarkovPath p;
  p.active_ = true;
  p.key_ = key;
  p.effect_ = effect;
  p.stream_ = stream;
  for (unsigned level = 0; level < kLevels; ++level) {
    const double h = std::ldexp(1.0, static_cast<int>(level)) / correlation_captures;
    p.weight_[level] = 0.5 / std::cosh(h);
    p.sigma_[level] = std::sqrt(std::tanh(h));
  }
  const double r = std::exp(-static_cast<double>(kEnd) / correlation_captures);
  p.set_ends(r, std::sqrt(1 - r * r), true);
  return p;
}

MarkovPath MarkovPath::walk(PhiloxKey key, NoiseEffect effect, std::uint32_t stream) {
  MarkovPath p;
  p.active_ = true;
  p.key_ = key;
  p.effect_ = effect;
  p.stream_ = stream;
  for (unsigned level = 0; level < kLevels; ++level) {
    p.weight_[level] = 0.5;
    p.sigma_[level] = std::sqrt(0.5 * std::ldexp(1.0, static_cast<int>(level)));
  }
  p.set_ends(0, std::sqrt(static_cast<double>(kEnd)), false);
  return p;
}

void MarkovPath::set_ends(double high_of_low, double high_sigma, bool low_is_drawn) {
  Interval& whole = way_[kLevels];
  if (low_is_drawn) whole.low = normal_draws(key_, effect_, kLowDraw, stream_);
  const Value z = normal_draws(key_, effect_, kHighDraw, stream_);
  for (std::size_t i = 0; i < 3; ++i) whole.high[i] = high_of_low * whole.low[i] + high_sigma * z[i];
}

std::array<double, 3> MarkovPath::at(std::uint64_t index) noexcept {
  if (!active_) return {};
  index &= kEnd - 1;
  unsigned level = known_;
  while (level < kLevels && (index >> level) != (way_[level].begin >> level)) ++level;
  for (; level > 0; --level) {
    const Interval& whole = way_[level];
    const unsigned half = level - 1;
    const std::uint64_t middle_at = whole.begin + (std::uint64_t{1} << half);
    const Value z = normal_draws(key_, effect_, middle_at, stream_);
    Value middle;
    for (std::size_t i = 0; i < 3; ++i)
      middle[i] = weight_[half] * (whole.low[i] + whole.high[i]) + sigma_[half] * z[i];
    Interval& next = way_[half];
    if (index >= middle_at) {
      next = {middle_at, middle, whole.high};
    } else {
      next = {whole.begin, whole.low, middle};
    }
  }
  known_ = 0;
  return way_[0].low;
}

}  // namespace rigor::models

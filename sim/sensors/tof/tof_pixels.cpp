#include "sim/sensors/tof/tof_pixels.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/models/tof/tof_math.h"
#include "sensor-hal/models/wide.h"
#include "sim/sensors/tof/tof_effects.h"

namespace rigor::tof {
namespace {

using Math = models::TofMath<float>;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr double kLightSpeed_mps = 299792458.0;
/// (e + this) − this is the whole number nearest to e, |e| < 2²²: a float has no room for a fraction there.
constexpr float kRound = 12582912.0F;

/// Parts of the picture that overlap by less hide nothing of each other.
constexpr float kOverlap = 1.02F;

struct Correlation {
  float triangle = 0, a3 = 0, a5 = 0, a7 = 0, a9 = 0, bias = 1, variation = 1;
};

Correlation correlation_of(const models::TofModulation& m) {
  Correlation c;
  // Harmonics of which nothing is wanted are not worked out.
  if (m.waveform == models::TofWaveform::sine || (!m.wiggling_bias && !m.sine_like_noise)) return c;
  c.bias = m.wiggling_bias ? 1 : 0;
  c.variation = m.sine_like_noise ? 1 : 0;
  if (m.waveform == models::TofWaveform::triangle) {
    c.triangle = 1;
    return c;
  }
  c.a3 = static_cast<float>(m.harmonics[0]);
  c.a5 = static_cast<float>(m.harmonics[1]);
  c.a7 = static_cast<float>(m.harmonics[2]);
  c.a9 = static_cast<float>(m.harmonics[3]);
  return c;
}

/// Samples' E times their phasors. Any width of vectors gives the same: each sample on its own.
RIGOR_WIDE void phasors_of(const float* e, const float* range_m, std::size_t begin, std::size_t end,
                           float turns_per_m, Correlation c, float* x, float* y) {
  for (std::size_t i = begin; i < end; ++i) {
    float px = 0, py = 0;
    Math::tof_phasor(range_m[i] * turns_per_m, c.triangle, c.a3, c.a5, c.a7, c.a9, c.bias, c.variation, px,
                     py);
    x[i] = e[i] * px;
    y[i] = e[i] * py;
  }
}
RIGOR_WIDE void sines_of(const float* e, const float* range_m, std::size_t begin, std::size_t end,
                         float turns_per_m, float* x, float* y) {
  for (std::size_t i = begin; i < end; ++i) {
    float s = 0, c = 0;
    Math::tof_sincos_turns(range_m[i] * turns_per_m, s, c);
    x[i] = e[i] * c;
    y[i] = e[i] * s;
  }
}

template <class F>
void each_row(std::size_t count, std::size_t grain, const F& f) {
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, grain),
                    [&](const auto& range) { f(range.begin(), range.end()); });
}

}  // namespace

ExposedTaps taps_of(const models::TofModulation& m, int exposure) {
  const auto e = static_cast<std::size_t>(exposure);
  if (m.taps == models::TofTaps::differential)
    return {.first_frequency = e / 2, .even = e % 2 == 0, .odd = e % 2 == 1};
  return {.first_frequency = e / 4, .one = true, .tap = e % 4};
}

PixelArray::PixelArray(const models::TofModel& model, models::PhiloxKey key)
    : model_(model),
      key_(key),
      pixels_(static_cast<std::size_t>(model.width_px) * static_cast<std::size_t>(model.height_px)) {
  const auto& f = model_.modulation.frequencies_hz;
  for (const double hz : f) turns_per_m_.push_back(static_cast<float>(2 * hz / kLightSpeed_mps));
  reference_ = static_cast<std::size_t>(std::max_element(f.begin(), f.end()) - f.begin());
  unambiguous_m_ = static_cast<float>(model_.unambiguous_range_m());
  if (f.size() > 1)
    wraps_ =
        static_cast<int>(std::lround(model_.unambiguous_range_m() * 2 * f[reference_] / kLightSpeed_mps));
  const auto& spline = model_.range_error.wiggling.coefficients_m;
  if (model_.modulation.wiggling_bias) spline_m_.assign(spline.begin(), spline.end());
  make_fixed_pattern();
}

void PixelArray::make_fixed_pattern() {
  const auto& p = model_.pixel;
  if (p.range_offset_sigma_m <= 0 && p.gain_sigma <= 0) return;
  offset_m_.assign(pixels_, 0);
  gain_.assign(pixels_, 1);
  each_row(pixels_, 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const auto words =
          models::draw_words(key_, models::NoiseEffect::tof_fixed_pattern, 0, static_cast<std::uint32_t>(i));
      offset_m_[i] =
          static_cast<float>(p.range_offset_sigma_m) * Math::normal_quantile(Math::unit_from_bits(words[0]));
      gain_[i] = std::max(
          0.0F, 1 + static_cast<float>(p.gain_sigma) * Math::normal_quantile(Math::unit_from_bits(words[1])));
    }
  });
}

void PixelArray::phasors(const std::vector<float>& e, const std::vector<float>& true_range_m,
                         std::size_t frequency, std::vector<float>& x, std::vector<float>& y) {
  x.resize(e.size());
  y.resize(e.size());
  if (!spline_m_.empty()) add_spline(true_range_m);
  const std::vector<float>& range_m = spline_m_.empty() ? true_range_m : wiggled_m_;
  const Correlation c = correlation_of(model_.modulation);
  const bool sine = c.triangle == 0 && c.a3 == 0 && c.a5 == 0 && c.a7 == 0 && c.a9 == 0;
  each_row(e.size(), 4096, [&](std::size_t begin, std::size_t end) {
    if (sine)
      sines_of(e.data(), range_m.data(), begin, end, turns_per_m_[frequency], x.data(), y.data());
    else
      phasors_of(e.data(), range_m.data(), begin, end, turns_per_m_[frequency], c, x.data(), y.data());
  });
}

void PixelArray::add_spline(const std::vector<float>& range_m) {
  const auto& w = model_.range_error.wiggling;
  const auto from = static_cast<float>(w.from_m), to = static_cast<float>(w.to_m),
             pieces = static_cast<float>(spline_m_.size() - 3);
  wiggled_m_.resize(range_m.size());
  each_row(range_m.size(), 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      float first = 0, b[4];
      Math::tof_spline(range_m[i], from, to, pieces, first, b[0], b[1], b[2], b[3]);
      const float* c = spline_m_.data() + static_cast<std::size_t>(first);
      wiggled_m_[i] = range_m[i] + b[0] * c[0] + b[1] * c[1] + b[2] * c[2] + b[3] * c[3];
    }
  });
}

void PixelArray::put(std::size_t pixel, std::size_t frequency, const ExposedTaps& taps, const Sums& sums) {
  const float gain = gain_.empty() ? 1.0F : gain_[pixel];
  const auto dark =
      static_cast<float>(model_.pixel.dark_current_e_per_s * model_.modulation.integration_time_s);
  // The shutter lets half of the light into a tap; the dark current runs all the time.
  const float background = 0.5F * gain * sums.ambient + dark;
  float d[4];
  Math::tof_taps(gain * sums.active, gain * sums.x, gain * sums.y,
                 static_cast<float>(model_.modulation.contrast), background, d[0], d[1], d[2], d[3]);
  for (std::size_t k = 0; k < 4; ++k) {
    if (taps.one ? k != taps.tap : !(k % 2 == 0 ? taps.even : taps.odd)) continue;
    means_[(frequency * 4 + k) * pixels_ + pixel] = d[k];
    if (!drained_.empty())
      drained_[(frequency * 4 + k) * pixels_ + pixel] =
          static_cast<float>(model_.pixel.ambient_suppression) * background;
  }
}

void PixelArray::add_parts(const SampleLight& light, std::size_t frequency, const ExposedTaps& taps) {
  const bool ambient = !light.ambient_e.empty();
  const auto range_m = [&](const PixelParts::Part& part) {
    const float r = light.range_m[part.sample];
    return r > 0 ? r : std::numeric_limits<float>::infinity();
  };
  each_row(pixels_, 1024, [&](std::size_t begin, std::size_t end) {
    std::vector<PixelParts::Part> parts;
    for (std::size_t p = begin; p < end; ++p) {
      parts.clear();
      light.parts.each_part(p, [&](const PixelParts::Part& part) { parts.push_back(part); });
      // Where more lies than a pixel has room for, the nearest hides the farthest.
      const bool hidden = light.parts.cover(p) > kOverlap;
      if (hidden)
        std::sort(parts.begin(), parts.end(), [&](const PixelParts::Part& a, const PixelParts::Part& b) {
          const float ra = range_m(a), rb = range_m(b);
          return ra != rb ? ra < rb : a.sample < b.sample;
        });
      Sums sum;
      float covered = 0;
      for (const PixelParts::Part& part : parts) {
        const float area = hidden ? std::min(part.area_px, 1.0F - covered) : part.area_px;
        sum.active += area * light.active_e[part.sample];
        sum.x += area * x_[part.sample];
        sum.y += area * y_[part.sample];
        if (ambient) sum.ambient += area * light.ambient_e[part.sample];
        covered += area;
      }
      const float share = covered > 0 ? 1 / covered : 0;
      put(p, frequency, taps, {sum.active * share, sum.x * share, sum.y * share, sum.ambient * share});
    }
  });
}

void PixelArray::expose(const SampleRays& rays, const SampleLight& light, const ExposedTaps& taps) {
  const std::size_t frequencies = model_.modulation.frequencies_hz.size();
  means_.resize(frequencies * 4 * pixels_);
  if (model_.pixel.ambient_suppression > 0) drained_.resize(means_.size());
  const auto s = static_cast<std::size_t>(rays.side), width = static_cast<std::size_t>(rays.width_px);
  const std::size_t n = s * s, bounces = light.bounce_e.size() / pixels_;
  const bool ambient = !light.ambient_e.empty();
  for (std::size_t j = taps.first_frequency; j < taps.first_frequency + taps.frequencies; ++j) {
    phasors(light.active_e, light.range_m, j, x_, y_);
    if (bounces > 0) phasors(light.bounce_e, light.bounce_range_m, j, bounce_x_, bounce_y_);
    const auto add_bounces = [&](std::size_t p, Sums& sum) {
      for (std::size_t i = p * bounces; i < (p + 1) * bounces; ++i) {
        sum.active += light.bounce_e[i];
        sum.x += bounce_x_[i];
        sum.y += bounce_y_[i];
      }
    };
    if (!light.parts.empty()) {
      add_parts(light, j, taps);
      continue;
    }
    if (!rays.lattice) {
      const float weight = 1.0F / static_cast<float>(n);
      each_row(pixels_, 2048, [&](std::size_t begin, std::size_t end) {
        for (std::size_t p = begin; p < end; ++p) {
          Sums sum;
          for (std::size_t i = p * n; i < (p + 1) * n; ++i) {
            sum.active += light.active_e[i];
            sum.x += x_[i];
            sum.y += y_[i];
            if (ambient) sum.ambient += light.ambient_e[i];
          }
          sum = {sum.active * weight, sum.x * weight, sum.y * weight, sum.ambient * weight};
          add_bounces(p, sum);
          put(p, j, taps, sum);
        }
      });
      continue;
    }
    // The integral over the pixel of light that is bilinear between the lattice's samples: its own s along a
    // side and one on each side, of which an eighth of a cell lies in the pixel.
    float w[6];
    const float cell = 1.0F / static_cast<float>(s);
    std::fill(w, w + s + 2, cell);
    w[0] = w[s + 1] = cell / 8;
    w[1] -= cell / 8;
    w[s] -= cell / 8;
    const auto columns = static_cast<std::size_t>(rays.lattice_width());
    each_row(static_cast<std::size_t>(rays.height_px), 4, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v)
        for (std::size_t u = 0; u < width; ++u) {
          Sums sum;
          for (std::size_t b = 0; b < s + 2; ++b)
            for (std::size_t a = 0; a < s + 2; ++a) {
              const std::size_t i = (v * s + b) * columns + u * s + a;
              const float weight = w[a] * w[b];
              sum.active += weight * light.active_e[i];
              sum.x += weight * x_[i];
              sum.y += weight * y_[i];
              if (ambient) sum.ambient += weight * light.ambient_e[i];
            }
          const std::size_t p = v * width + u;
          add_bounces(p, sum);
          put(p, j, taps, sum);
        }
    });
  }
}

TofPixelStatus PixelArray::range_of(const float* turns, float& range_m) const {
  if (turns_per_m_.size() == 1) {
    range_m = turns[0] / turns_per_m_[0];
    return TofPixelStatus::valid;
  }
  // Of the ranges that the highest frequency's phase allows, the one that the others agree with best.
  const float reference = turns_per_m_[reference_];
  int best = 0;
  float best_cost = std::numeric_limits<float>::infinity();
  for (int n = 0; n < wraps_; ++n) {
    const float r = (turns[reference_] + static_cast<float>(n)) / reference;
    float cost = 0;
    for (std::size_t j = 0; j < turns_per_m_.size(); ++j) {
      if (j == reference_) continue;
      float e = r * turns_per_m_[j] - turns[j];
      e -= (e + kRound) - kRound;
      cost += e * e;
    }
    if (cost < best_cost) best_cost = cost, best = n;
  }
  const float about = (turns[reference_] + static_cast<float>(best)) / reference;
  // sigma goes with 1/f at the same amplitude: weights f².
  float sum = 0, weights = 0;
  for (std::size_t j = 0; j < turns_per_m_.size(); ++j) {
    const float w = turns_per_m_[j] * turns_per_m_[j];
    sum += w * (Math::tof_nearest_range(turns[j], turns_per_m_[j], about) - about);
    weights += w;
  }
  range_m = about + sum / weights;
  if (model_.modulation.unwrap_tolerance_m > 0) {
    float squares = 0;
    for (std::size_t j = 0; j < turns_per_m_.size(); ++j) {
      const float e = Math::tof_nearest_range(turns[j], turns_per_m_[j], about) - range_m;
      squares += turns_per_m_[j] * turns_per_m_[j] * e * e;
    }
    if (!(std::sqrt(squares / weights) <= static_cast<float>(model_.modulation.unwrap_tolerance_m)))
      return TofPixelStatus::ambiguous;
  }
  if (range_m < 0) range_m += unambiguous_m_;
  if (range_m >= unambiguous_m_) range_m -= unambiguous_m_;
  return TofPixelStatus::valid;
}

void PixelArray::read(std::uint64_t index, TofPicture& picture, bool keep_taps) {
  const std::size_t frequencies = turns_per_m_.size();
  const models::TofPixel& pixel = model_.pixel;
  const auto full_well = static_cast<float>(pixel.full_well_e);
  const auto read_noise = static_cast<float>(pixel.trembling ? pixel.read_noise_e : 0);
  const auto step = static_cast<float>(
      pixel.adc_bits > 0 ? pixel.full_well_e / (std::ldexp(1.0, pixel.adc_bits) - 1) : 0.0);
  const auto least = static_cast<float>(model_.limits.min_amplitude_e);
  const auto range_offset = static_cast<float>(model_.range_error.offset_m),
             amplitude_error = static_cast<float>(model_.range_error.amplitude_error_m_e);
  const bool shifted = !offset_m_.empty() || range_offset != 0 || amplitude_error != 0;
  const auto near_m = static_cast<float>(model_.limits.min_range_m),
             far_m = static_cast<float>(model_.limits.max_range_m);
  picture.range_m.resize(pixels_);
  picture.amplitude.resize(pixels_);
  picture.status.resize(pixels_);
  picture.taps.resize(keep_taps ? pixels_ * 4 : 0);
  each_row(pixels_, 1024, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      float turns[models::TofModel::kMaxFrequencies];
      float amplitude = 0, saturated = 0;
      bool any = false;
      for (std::size_t j = 0; j < frequencies; ++j) {
        std::array<std::uint32_t, 4> shot{}, noise{};
        if (pixel.trembling)
          shot = models::draw_words(key_, shot_effect(j), index, static_cast<std::uint32_t>(p));
        if (read_noise > 0)
          noise = models::draw_words(key_, read_effect(j), index, static_cast<std::uint32_t>(p));
        float d[4], mean[4];
        for (std::size_t k = 0; k < 4; ++k) {
          const std::size_t at = (j * 4 + k) * pixels_ + p;
          mean[k] = means_[at];
          const float arrived =
              pixel.trembling ? Math::poisson_quantile(mean[k], Math::unit_from_bits(shot[k])) : mean[k];
          const float draw = read_noise > 0 ? Math::normal_quantile(Math::unit_from_bits(noise[k])) : 0.0F;
          float full = 0;
          d[k] = Math::tof_read_tap(arrived, drained_.empty() ? 0.0F : drained_[at], full_well, read_noise,
                                    draw, step, full);
          saturated += full;
          if (keep_taps && j == 0) picture.taps[p * 4 + k] = d[k];
        }
        any = any || mean[0] != mean[2] || mean[1] != mean[3];
        float a = 0;
        Math::tof_demodulate(d[0], d[1], d[2], d[3], turns[j], a);
        amplitude += a;
      }
      amplitude /= static_cast<float>(frequencies);
      if (shifted) {
        const float shift = (offset_m_.empty() ? 0.0F : offset_m_[p]) +
                            Math::tof_range_error(range_offset, amplitude_error, amplitude);
        for (std::size_t j = 0; j < frequencies; ++j) {
          turns[j] += shift * turns_per_m_[j];
          turns[j] -= std::floor(turns[j]);
        }
      }
      TofPixelStatus status = TofPixelStatus::valid;
      float range_m = kNaN;
      if (saturated > 0)
        status = TofPixelStatus::saturated;
      else if (!any || !(amplitude > 0))
        status = TofPixelStatus::no_return;
      else if (amplitude < least)
        status = TofPixelStatus::dark;
      else {
        status = range_of(turns, range_m);
        if (status == TofPixelStatus::valid && (range_m < near_m || (far_m > 0 && range_m > far_m)))
          status = TofPixelStatus::out_of_range;
      }
      picture.range_m[p] = status == TofPixelStatus::valid ? range_m : kNaN;
      picture.amplitude[p] = amplitude;
      picture.status[p] = status;
    }
  });
}

}  // namespace rigor::tof

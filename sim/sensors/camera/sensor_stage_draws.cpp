#include "sim/sensors/camera/sensor_stage_draws.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/wide.h"

namespace rigor::sensor_stage {
namespace {

using Noise = models::NoiseMath<float>;

/// Pixels at a time: their arrays stay in the first-level cache.
constexpr int kRun = 256;
constexpr float kMiddle = 0.180625f;       // of normal_quantile
constexpr float kExpansionFrom_e = 10.0f;  // of poisson_quantile

struct alignas(32) Words {
  std::uint32_t w[4][kRun];
};

/// Philox for neighbouring elements. The rounds stand outside of the loop over elements, which is what the
/// compiler then makes wide.
RIGOR_WIDE void draw_run(models::PhiloxKey key, std::uint32_t first_element, std::uint32_t effect,
                         std::uint64_t capture_index, Words& out) {
  std::uint32_t* __restrict w0 = out.w[0];
  std::uint32_t* __restrict w1 = out.w[1];
  std::uint32_t* __restrict w2 = out.w[2];
  std::uint32_t* __restrict w3 = out.w[3];
  const auto low = static_cast<std::uint32_t>(capture_index);
  const auto high = static_cast<std::uint32_t>(capture_index >> 32);
  for (int i = 0; i < kRun; ++i) {
    std::uint32_t r0 = 0, r1 = 0, r2 = 0, r3 = 0;
    models::PhiloxMath::philox4x32_10(first_element + static_cast<std::uint32_t>(i), effect, low, high,
                                      key.word0, key.word1, r0, r1, r2, r3);
    w0[i] = r0;
    w1[i] = r1;
    w2[i] = r2;
    w3[i] = r3;
  }
}

/// A float whose logarithm is made of +, -, *, / alone: loops take it eight at a time, and it is the same on
/// every machine, which a library's is not.
struct WideFloat {
  float v;
  RIGOR_WIDE_STEP explicit WideFloat(float x) : v(x) {}
  RIGOR_WIDE_STEP explicit WideFloat(double x) : v(static_cast<float>(x)) {}
  RIGOR_WIDE_STEP WideFloat operator-() const { return WideFloat(-v); }
  friend RIGOR_WIDE_STEP WideFloat operator+(WideFloat a, WideFloat b) { return WideFloat(a.v + b.v); }
  friend RIGOR_WIDE_STEP WideFloat operator-(WideFloat a, WideFloat b) { return WideFloat(a.v - b.v); }
  friend RIGOR_WIDE_STEP WideFloat operator*(WideFloat a, WideFloat b) { return WideFloat(a.v * b.v); }
  friend RIGOR_WIDE_STEP WideFloat operator/(WideFloat a, WideFloat b) { return WideFloat(a.v / b.v); }
  friend RIGOR_WIDE_STEP bool operator<(WideFloat a, WideFloat b) { return a.v < b.v; }
  friend RIGOR_WIDE_STEP WideFloat sqrt(WideFloat a) { return WideFloat(std::sqrt(a.v)); }
  /// Of normal numbers above 0, within 1 ulp: the series of FreeBSD's msun/src/e_logf.c.
  friend RIGOR_WIDE_STEP WideFloat log(WideFloat a) {
    constexpr std::int32_t kRootOfHalf = 0x3f3504f3;
    const std::int32_t bits = std::bit_cast<std::int32_t>(a.v) + (0x3f800000 - kRootOfHalf);
    const auto exponent = static_cast<float>((bits >> 23) - 127);
    const float f = std::bit_cast<float>((bits & 0x007fffff) + kRootOfHalf) - 1.0f;
    const float s = f / (2.0f + f), z = s * s, w = z * z;
    const float series =
        z * (0.66666662693f + w * 0.28498786688f) + w * (0.40000972152f + w * 0.24279078841f);
    const float half_square = 0.5f * f * f;
    return WideFloat(s * (half_square + series) + exponent * 9.0580006145e-06f - half_square + f +
                     exponent * 6.9313812256e-01f);
  }
};

/// normal_quantile(unit_from_bits(bits)) for a run; `u` keeps the uniform draws. Middle and tails are both
/// worked out for each draw, which costs less than parting them.
RIGOR_WIDE void normal_run(const std::uint32_t* __restrict bits, float* __restrict u, float* __restrict z) {
  for (int i = 0; i < kRun; ++i) {
    // As unit_from_bits; the 23 bits fit a signed number, which vector units turn to float faster.
    const float unit =
        (static_cast<float>(static_cast<std::int32_t>(bits[i] >> 9)) + 0.5f) * 1.1920928955078125e-7f;
    const float q = unit - 0.5f;
    const float middle = Noise::normal_quantile_middle(q);
    const float tail = models::NoiseMath<WideFloat>::normal_quantile_tail(WideFloat(unit)).v;
    u[i] = unit;
    z[i] = q * q <= kMiddle ? middle : tail;
  }
}

RIGOR_WIDE void mean_run(const float* __restrict rate, const float* __restrict gain,
                         const float* __restrict dark, float exposure_s, float* __restrict mean) {
  for (int i = 0; i < kRun; ++i) mean[i] = Noise::emva_mean_electrons(rate[i], dark[i], gain[i], exposure_s);
}

/// floor(max(n, 0)) of poisson_quantile: below 2^23 by way of an integer, above it every float is whole.
RIGOR_WIDE void poisson_large(const float* __restrict mean, const float* __restrict z,
                              float* __restrict electrons) {
  for (int i = 0; i < kRun; ++i) {
    const float n = Noise::poisson_expansion(mean[i], z[i]);
    const float bounded = n > 0.0f ? (n < 8388608.0f ? n : 8388608.0f) : 0.0f;
    const float whole = static_cast<float>(static_cast<std::int32_t>(bounded));
    const float above = n - 8388608.0f;  // exact, as is the sum
    electrons[i] = whole + (above > 0.0f ? above : 0.0f);
  }
}

RIGOR_WIDE void quantise_run(const float* __restrict shot, const float* __restrict offset,
                             const float* __restrict z, float full_well, float read_noise, float gain,
                             float black, float max_dn, float* __restrict dn) {
  for (int i = 0; i < kRun; ++i) {
    const float e = Noise::emva_collected_electrons(shot[i], full_well, offset[i], read_noise, z[i]);
    const float y = Noise::emva_analogue_dn(e, gain, black) + 0.5f;
    // emva_quantise: clipped first, so that cutting off what follows the point is the floor.
    const float bounded = y > 0.0f ? (y < 65536.0f ? y : 65536.0f) : 0.0f;
    const float whole = static_cast<float>(static_cast<std::int32_t>(bounded));
    dn[i] = whole < max_dn ? whole : max_dn;
  }
}

/// The same with a response that bends.
RIGOR_WIDE void quantise_bent_run(const float* __restrict shot, const float* __restrict offset,
                                  const float* __restrict z, float full_well, float read_noise, float gain,
                                  float black, float max_dn, float c2, float c3, float* __restrict dn) {
  for (int i = 0; i < kRun; ++i) {
    const float e = Noise::emva_collected_electrons(shot[i], full_well, offset[i], read_noise, z[i]);
    const float x = Noise::emva_response(Noise::emva_analogue_dn(e, gain, 0.0f), max_dn - black, c2, c3);
    const float y = black + x + 0.5f;
    const float bounded = y > 0.0f ? (y < 65536.0f ? y : 65536.0f) : 0.0f;
    const float whole = static_cast<float>(static_cast<std::int32_t>(bounded));
    dn[i] = whole < max_dn ? whole : max_dn;
  }
}

struct alignas(32) Lanes {
  float v[kRun];
};

/// One sample of each pixel of a padded run.
void expose_samples(const ExposureConstants& c, const Lanes& rate, const Lanes& gain, const Lanes& offset,
                    const Lanes& dark, const std::uint32_t* shot_bits, const std::uint32_t* read_bits,
                    int count, std::uint16_t* numbers) {
  Lanes mean, u, z, electrons;
  mean_run(rate.v, gain.v, dark.v, c.exposure_s, mean.v);
  if (c.shot_noise) {
    normal_run(shot_bits, u.v, z.v);
    poisson_large(mean.v, z.v, electrons.v);
    for (int i = 0; i < count; ++i)
      if (mean.v[i] < kExpansionFrom_e) electrons.v[i] = Noise::poisson_search(mean.v[i], u.v[i]);
  } else {
    electrons = mean;
  }
  if (c.read_noise)
    normal_run(read_bits, u.v, z.v);
  else
    std::fill(z.v, z.v + kRun, 0.0f);
  if (c.response_c2 == 0 && c.response_c3 == 0)
    quantise_run(electrons.v, offset.v, z.v, c.full_well_e, c.read_noise_e, c.gain_dn_per_e, c.black_dn,
                 c.max_dn, mean.v);
  else
    quantise_bent_run(electrons.v, offset.v, z.v, c.full_well_e, c.read_noise_e, c.gain_dn_per_e, c.black_dn,
                      c.max_dn, c.response_c2, c.response_c3, mean.v);
  for (int i = 0; i < count; ++i) numbers[i] = static_cast<std::uint16_t>(mean.v[i]);
}

void load(Lanes& lanes, const float* from, int at, int count, float otherwise) {
  if (from == nullptr) {
    std::fill(lanes.v, lanes.v + kRun, otherwise);
    return;
  }
  std::copy(from + at, from + at + count, lanes.v);
  std::fill(lanes.v + count, lanes.v + kRun, otherwise);
}

}  // namespace

void expose_run(const ExposureConstants& c, const PixelRun& run, const RunRates& rates,
                const RunNumbers& numbers) {
  const bool draws = c.shot_noise || c.read_noise;
  Words words[2];
  Lanes rate, gain, offset, dark;
  for (int at = 0; at < run.count; at += kRun) {
    const int n = std::min(kRun, run.count - at);
    const std::uint32_t element = run.first_element + static_cast<std::uint32_t>(at);
    using models::NoiseEffect;
    if (draws)
      draw_run(c.key, element, static_cast<std::uint32_t>(NoiseEffect::camera_shot_and_read), c.capture_index,
               words[0]);
    if (draws && rates.planes == 3)
      draw_run(c.key, element, static_cast<std::uint32_t>(NoiseEffect::camera_shot_and_read_2),
               c.capture_index, words[1]);
    load(gain, run.gain, at, n, 1.0f);
    load(offset, run.offset_e, at, n, 0.0f);
    load(dark, run.dark_e_per_s, at, n, c.dark_e_per_s);
    for (int p = 0; p < rates.planes; ++p) {
      load(rate, rates.plane[p], at, n, 0.0f);
      // Samples 0 and 1 have words 0, 1 and 2, 3 of the first draw, sample 2 words 0, 1 of the second.
      const auto& w = words[p / 2].w;
      expose_samples(c, rate, gain, offset, dark, w[p % 2 * 2], w[p % 2 * 2 + 1], n, numbers.plane[p] + at);
    }
  }
}

RIGOR_WIDE void rates_of_run(const float* __restrict radiance, int count, const float even_response[4],
                             const float odd_response[4], float max_radiance, float* __restrict rate) {
  const auto clean = [max_radiance](float v) {
    const float positive = v > 0.0f ? v : 0.0f;  // a NaN is not above 0
    return positive < max_radiance ? positive : max_radiance;
  };
  const float e0 = even_response[0], e1 = even_response[1], e2 = even_response[2], e3 = even_response[3];
  const float o0 = odd_response[0], o1 = odd_response[1], o2 = odd_response[2], o3 = odd_response[3];
  for (int i = 0; i < count; ++i) {
    const float* const l = radiance + 4 * static_cast<std::ptrdiff_t>(i);
    const float a = clean(l[0]), b = clean(l[1]), c = clean(l[2]), d = clean(l[3]);
    const float even = a * e0 + b * e1 + c * e2 + d * e3;
    const float odd = a * o0 + b * o1 + c * o2 + d * o3;
    rate[i] = (i & 1) == 0 ? even : odd;
  }
}

RIGOR_WIDE BadRadiance count_bad_radiance(const float* radiance, int count, float max_radiance) {
  BadRadiance bad;
  for (int i = 0; i < count; ++i) {
    const float* const l = radiance + 4 * static_cast<std::ptrdiff_t>(i);
    std::uint32_t invalid = 0, clipped = 0;
    for (int b = 0; b < 4; ++b) {
      invalid |= l[b] >= 0.0f ? 0u : 1u;
      clipped |= l[b] > max_radiance ? 1u : 0u;
    }
    bad.invalid += invalid;
    bad.clipped += clipped;
  }
  return bad;
}

}  // namespace rigor::sensor_stage

// The sensor as EMVA 1288 measures it: flat fields return what was configured. Seeds are fixed; limits are 4
// standard deviations of the estimate, named at each.
#include <array>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"
#include "sim/sensors/camera/sensor_stage_draws.h"
#include "tests/sim/sensors/camera/sensor_stage_fixture.h"

namespace rigor {
namespace {

using test::even_picture;
using test::make_stage;
using test::Moments;
using test::moments;
using test::numbers;
using test::quiet_camera;

/// EMVA 1288: temporal variance from two pictures, without the fixed pattern.
double pair_variance(const std::vector<int>& a, const std::vector<int>& b) {
  std::vector<int> d(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) d[i] = a[i] - b[i];
  return 0.5 * moments(d).variance;
}

std::vector<double> mean_picture(SensorStage& stage, const OpticsPicture& p, int frames) {
  std::vector<double> sum(static_cast<std::size_t>(p.width_px) * p.height_px);
  for (int i = 0; i < frames; ++i) {
    const auto dn = numbers(stage, p, static_cast<std::uint64_t>(100 + i));
    for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += dn[k];
  }
  for (double& v : sum) v /= frames;
  return sum;
}

// 76,800 pixels: a variance from pairs has the relative standard deviation sqrt(2 / N) = 0.51 %.
TEST(FlatField, ReturnsGainReadNoiseDsnuAndPrnu) {
  for (const double gain_db : {0.0, 6.0}) {
    CameraModel m = quiet_camera();
    m.noise.black_level_dn = 120;
    m.noise.shot_noise = true;
    m.noise.read_noise_e = 7;
    m.noise.dsnu_e = 4;
    m.noise.prnu = 0.02;
    const double k = 0.25 * std::pow(10.0, gain_db / 20);
    const double n = 320.0 * 240.0, sd = std::sqrt(2 / n);
    const auto stage = make_stage(m);
    const auto shot = [&](double electrons, std::uint64_t index) {
      return numbers(*stage, even_picture(m, electrons), index, 0.01, gain_db);
    };
    const auto dark_a = shot(0, 0), dark_b = shot(0, 1), bright_a = shot(5000, 2), bright_b = shot(5000, 3);
    const double dark_mean = 0.5 * (moments(dark_a).mean + moments(dark_b).mean);
    const double bright_mean = 0.5 * (moments(bright_a).mean + moments(bright_b).mean);
    const double dark_variance = pair_variance(dark_a, dark_b), variance = pair_variance(bright_a, bright_b);
    // mu_y = mu_dark + K eta mu_p; the mean of n pixels with DSNU, PRNU and noise.
    EXPECT_NEAR(dark_mean, 120, 4 * k * std::sqrt((16 + 49) / n));
    EXPECT_NEAR(bright_mean - dark_mean, k * 5000, 4 * k * std::sqrt((5000 + 1e4 + 130) / n));
    // var_y = K^2 var_d + 1/12 + K (mu_y - mu_dark)
    const double gain = (variance - dark_variance) / (bright_mean - dark_mean);
    EXPECT_NEAR(gain / k, 1, 4 * sd * 1.02);
    const double read_e = std::sqrt(dark_variance - 1.0 / 12) / k;
    EXPECT_NEAR(read_e / 7, 1, 4 * 0.5 * sd * dark_variance / (dark_variance - 1.0 / 12));
    if (gain_db != 0) continue;
    // DSNU^2 = (s^2_dark - sigma^2 / L) / K^2, and the same for the light's pattern less the dark one's.
    constexpr int kFrames = 16;
    const auto dark = mean_picture(*stage, even_picture(m, 0), kFrames);
    const auto bright = mean_picture(*stage, even_picture(m, 5000), kFrames);
    const double s_dark = moments(dark).variance, s_bright = moments(bright).variance;
    const double dsnu2 = (s_dark - dark_variance / kFrames) / (k * k);
    EXPECT_NEAR(dsnu2 / 16, 1, 4 * sd * s_dark / (16 * k * k));
    const double prnu2 = (s_bright - variance / kFrames - (s_dark - dark_variance / kFrames)) /
                         ((bright_mean - dark_mean) * (bright_mean - dark_mean));
    EXPECT_NEAR(prnu2 / 4e-4, 1, 4 * sd * s_bright / (4e-4 * 5000 * 5000 * k * k));
  }
}

// Photo-electrons of the same pixel in two captures are independent, and so are those of neighbours.
TEST(FlatField, NoiseIsWhiteInSpaceAndTime) {
  CameraModel m = quiet_camera();
  m.noise.shot_noise = true;
  m.noise.read_noise_e = 10;
  const auto stage = make_stage(m);
  const OpticsPicture p = even_picture(m, 4000);
  const auto a = numbers(*stage, p, 5), b = numbers(*stage, p, 6);
  const Moments ma = moments(a), mb = moments(b);
  double in_time = 0, along = 0, down = 0;
  for (std::size_t i = 0; i + 320 < a.size(); ++i) {
    in_time += (a[i] - ma.mean) * (b[i] - mb.mean);
    along += (a[i] - ma.mean) * (a[i + 1] - ma.mean);
    down += (a[i] - ma.mean) * (a[i + 320] - ma.mean);
  }
  const double n = static_cast<double>(a.size() - 320), limit = 4 / std::sqrt(n);
  EXPECT_NEAR(in_time / n / ma.variance, 0, limit);
  EXPECT_NEAR(along / n / ma.variance, 0, limit);
  EXPECT_NEAR(down / n / ma.variance, 0, limit);
  EXPECT_EQ(numbers(*stage, p, 5), a) << "the same capture is the same picture";
  EXPECT_NE(numbers(*make_stage(m, true, 2), p, 5), a) << "another seed is another one";
}

TEST(DarkCurrent, GrowsWithExposureAndDoublesWithTemperature) {
  CameraModel m = quiet_camera();
  m.noise.dark_current_e_per_s = 2000;
  m.noise.shot_noise = true;
  // A gain of 1/4 would put every fourth count on the edge between two numbers, where rounding goes up.
  const double k = 0.2371;
  m.noise.system_gain_dn_per_e = k;
  const double n = 320.0 * 240.0;
  for (const double more_k : {0.0, 7.0, 14.0}) {
    m.noise.temperature_c = m.noise.dark_reference_c + more_k;
    const auto stage = make_stage(m);
    for (const double exposure_s : {0.5, 1.0}) {
      const double electrons = 2000 * exposure_s * std::exp2(more_k / 7);
      const Moments dn = moments(numbers(*stage, even_picture(m, 0), 1, exposure_s));
      EXPECT_NEAR(dn.mean, k * electrons, 4 * k * std::sqrt(electrons / n));
      EXPECT_NEAR(dn.variance, k * k * electrons + 1.0 / 12,
                  4 * std::sqrt(2 / n) * (k * k * electrons + 0.1));
    }
  }
}

// Hot pixels: 76,800 pixels, share 0.5 %: 384 +- 4 sqrt(384); their excess is exponential, mean 40 e-, whose
// mean over 384 has the standard deviation 40 / sqrt(384).
TEST(DarkCurrent, HotPixelsAreTheSameInEveryPicture) {
  CameraModel m = quiet_camera();
  m.noise.hot_pixel_share = 0.005;
  m.noise.hot_pixel_dark_e_per_s = 4000;
  m.noise.system_gain_dn_per_e = 20;  // fine enough that hardly any hides below half a number
  m.noise.adc_bits = 16;
  m.noise.full_well_e = 3000;
  const auto hot = [&](double temperature_c, std::uint64_t index) {
    m.noise.temperature_c = temperature_c;
    return numbers(*make_stage(m), even_picture(m, 0), index);
  };
  const auto first = hot(25, 0);
  EXPECT_EQ(hot(25, 77), first);
  const double expected = 0.005 * 320 * 240;
  double count = 0, sum = 0, sum_of_squares = 0;
  for (const int dn : first)
    if (dn > 0) {
      ++count;
      sum += dn / 20.0;
      sum_of_squares += dn / 20.0 * (dn / 20.0);
    }
  EXPECT_NEAR(count, expected, 4 * std::sqrt(expected));
  EXPECT_NEAR(sum / count, 40, 4 * 40 / std::sqrt(count));
  // E x^2 = 2 mean^2, with the relative standard deviation sqrt(5 / n).
  EXPECT_NEAR(sum_of_squares / count / 3200, 1, 4 * std::sqrt(5 / count));
  const auto warm = hot(32, 0);
  for (std::size_t i = 0; i < warm.size(); ++i) {
    ASSERT_NEAR(warm[i], 2 * first[i], 1.01) << "the same pixels, twice as hot";
  }
}

// With all of the well: the variance grows up to it and falls beyond, where every pixel is full.
TEST(Saturation, IsWhereTheVariancePeaks) {
  CameraModel m = quiet_camera(128, 96);
  m.noise.shot_noise = true;
  m.noise.full_well_e = 10000;
  const auto stage = make_stage(m);
  double peak = 0, peak_at = 0;
  for (double electrons = 500; electrons <= 14000; electrons += 250) {
    const Moments dn = moments(numbers(*stage, even_picture(m, electrons), 3));
    if (dn.variance > peak) peak = dn.variance, peak_at = electrons;
    if (electrons >= 11000) {
      EXPECT_EQ(dn.variance, 0) << electrons;
      EXPECT_EQ(dn.mean, 2500);
    }
  }
  EXPECT_GE(peak_at, 9000);
  EXPECT_LE(peak_at, 10000);
}

// One photo-electron in the mean, each worth one number: Poisson's distribution, by chi-squared. 0.999
// quantile of 6 degrees of freedom: 22.5.
TEST(ShotNoise, OneElectronIsPoisson) {
  CameraModel m = quiet_camera();
  m.noise.shot_noise = true;
  m.noise.system_gain_dn_per_e = 1;
  const auto dn = numbers(*make_stage(m), even_picture(m, 1.0), 9);
  std::array<double, 7> seen{};
  for (const int v : dn) seen[static_cast<std::size_t>(std::min(v, 6))] += 1;
  double chi2 = 0, p = std::exp(-1.0), left = 1;
  for (std::size_t k = 0; k < 7; ++k) {
    const double expected = (k == 6 ? left : p) * static_cast<double>(dn.size());
    chi2 += (seen[k] - expected) * (seen[k] - expected) / expected;
    left -= p;
    p /= static_cast<double>(k + 1);
  }
  EXPECT_LT(chi2, 22.5);
}

TEST(ShotNoise, AFullWellIsFull) {
  CameraModel m = quiet_camera(64, 48);
  m.noise.shot_noise = true;
  m.noise.full_well_e = 10000;
  m.noise.black_level_dn = 100;
  for (const double electrons : {20000.0, 1e7, 1e12})
    for (const int dn : numbers(*make_stage(m), even_picture(m, electrons))) ASSERT_EQ(dn, 2600);
  m.noise.system_gain_dn_per_e = 1;
  for (const int dn : numbers(*make_stage(m), even_picture(m, 20000))) ASSERT_EQ(dn, 4095) << "the converter";
}

// Noise of 0.2 DN before rounding: what comes out is the Gaussian's mass in each interval, here worked out
// exactly. 1/12 for the rounding is then wrong: by half an order at the middle of an interval, and the other
// way at its edge. Chi-squared over numbers with more than five expected; 0.999 quantiles of 2 and 3 degrees.
TEST(Rounding, NoiseBelowPointFourNumbersFollowsTheExactDistribution) {
  CameraModel m = quiet_camera();
  m.noise.read_noise_e = 2;
  m.noise.system_gain_dn_per_e = 0.1;
  const auto stage = make_stage(m);
  const double sigma = 0.2;
  for (const double mu : {50.0, 50.2, 50.5}) {
    const auto dn = numbers(*stage, even_picture(m, 10 * mu), 4);
    const double n = static_cast<double>(dn.size());
    double mean = 0, square = 0, fourth = 0, chi2 = 0;
    int used = 0;
    const auto mass = [&](int k) {
      const auto below = [&](double v) { return 0.5 * std::erfc(-(v - mu) / sigma / std::sqrt(2.0)); };
      return below(k + 0.5) - below(k - 0.5);
    };
    for (int k = 47; k <= 54; ++k) {
      mean += k * mass(k);
      const double expected = n * mass(k);
      const auto seen = static_cast<double>(std::count(dn.begin(), dn.end(), k));
      if (expected > 5) chi2 += (seen - expected) * (seen - expected) / expected, ++used;
      if (expected < 1e-6) {
        EXPECT_EQ(seen, 0) << k;
      }
    }
    for (int k = 47; k <= 54; ++k) {
      square += (k - mean) * (k - mean) * mass(k);
      fourth += std::pow(k - mean, 4) * mass(k);
    }
    EXPECT_LT(chi2, used <= 3 ? 13.8 : 16.3) << mu;
    const Moments got = moments(dn);
    const double sd = std::sqrt((fourth - square * square) / n);
    EXPECT_NEAR(got.variance, square, 4 * sd) << mu;
    EXPECT_GT(std::abs(got.variance - (sigma * sigma + 1.0 / 12)), 10 * sd)
        << "1/12 does not hold here: " << mu;
  }
}

// Many pixels at a time, as wide as the machine is, against the model's functions one by one: equal to the
// bit, for means of 0 to beyond every whole float, in runs of odd lengths.
TEST(WideArithmetic, IsThatOfTheModels) {
  using namespace sensor_stage;
  using N = models::NoiseMath<float>;
  ExposureConstants c;
  c.key = models::channel_key(11, 12);
  c.capture_index = (std::uint64_t{3} << 32) + 5;
  c.shot_noise = c.read_noise = true;
  c.exposure_s = 0.01f;
  c.dark_e_per_s = 30;
  c.full_well_e = 1e9f;
  c.read_noise_e = 3.7f;
  c.black_dn = 64;
  c.max_dn = 65535;
  for (const float gain : {0.31f, 1e-4f, 1e-6f, 40.0f, 0.7f})
    for (const int count : {1, 7, 256, 257, 1000}) {
      c.gain_dn_per_e = gain;
      const bool bent = gain == 0.7f;
      c.response_c2 = bent ? -0.12f : 0, c.response_c3 = bent ? 0.03f : 0;
      std::vector<float> rate(static_cast<std::size_t>(count)), prnu = rate, dsnu = rate;
      for (std::size_t i = 0; i < rate.size(); ++i) {
        const auto w = models::philox({static_cast<std::uint32_t>(i), 0, 0, 9}, c.key);
        rate[i] = 100.0f * std::exp2(40 * N::unit_from_bits(w[0]) - 8);
        prnu[i] = 1 + 0.01f * N::normal_quantile(N::unit_from_bits(w[1]));
        dsnu[i] = 2 * N::normal_quantile(N::unit_from_bits(w[2]));
        if (i % 50 == 0) rate[i] = 0;
      }
      std::vector<std::uint16_t> got[3];
      RunRates rates;
      RunNumbers to;
      rates.planes = 3;
      for (int p = 0; p < 3; ++p) {
        rates.plane[p] = rate.data();
        got[p].resize(rate.size());
        to.plane[p] = got[p].data();
      }
      constexpr std::uint32_t kFirst = 4000000000u;
      expose_run(c, {.first_element = kFirst, .count = count, .gain = prnu.data(), .offset_e = dsnu.data()},
                 rates, to);
      for (std::size_t i = 0; i < rate.size(); ++i) {
        const auto element = kFirst + static_cast<std::uint32_t>(i);
        const auto a =
            models::draw_words(c.key, models::NoiseEffect::camera_shot_and_read, c.capture_index, element);
        const auto b =
            models::draw_words(c.key, models::NoiseEffect::camera_shot_and_read_2, c.capture_index, element);
        const std::uint32_t bits[3][2] = {{a[0], a[1]}, {a[2], a[3]}, {b[0], b[1]}};
        for (int p = 0; p < 3; ++p) {
          const float mean = N::emva_mean_electrons(rate[i], c.dark_e_per_s, prnu[i], c.exposure_s);
          const float shot = N::poisson_quantile(mean, N::unit_from_bits(bits[p][0]));
          const float e = N::emva_collected_electrons(shot, c.full_well_e, dsnu[i], c.read_noise_e,
                                                      N::normal_quantile(N::unit_from_bits(bits[p][1])));
          const float y =
              bent ? c.black_dn + N::emva_response(N::emva_analogue_dn(e, gain, 0.0f), c.max_dn - c.black_dn,
                                                   c.response_c2, c.response_c3)
                   : N::emva_analogue_dn(e, gain, c.black_dn);
          const float dn = N::emva_quantise(y, c.max_dn);
          ASSERT_EQ(got[p][i], static_cast<std::uint16_t>(dn)) << "mean " << mean << " gain " << gain;
        }
      }
    }
}

}  // namespace
}  // namespace rigor

// Errors of the simulator's pixels: the three things called wiggling, noise, wells, converters, patterns.
#include <tbb/global_control.h>

#include <cstring>
#include <filesystem>

#include "sensor-hal/models/tof/tof_yaml.h"
#include "tests/paths.h"
#include "tests/sim/sensors/tof/tof_fixture.h"

namespace rigor::test {
namespace {

using models::TofModel;
using models::TofWaveform;

template <class T>
bool same_bytes(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0;
}
bool same(const TofPicture& a, const TofPicture& b) {
  return same_bytes(a.range_m, b.range_m) && same_bytes(a.amplitude, b.amplitude) &&
         same_bytes(a.status, b.status);
}

/// Range error over range, one pixel before a wall.
std::vector<double> errors_over(const TofModel& m, double from_m, double to_m, int steps) {
  std::vector<double> e;
  for (int i = 0; i < steps; ++i) {
    TofBench b;
    const double range = from_m + (to_m - from_m) * i / steps;
    b.wall(range);
    const double u = m.unambiguous_range_m();
    e.push_back(std::remainder(double(b.shoot(m).range_m[0]) - range, u));
  }
  return e;
}

TEST(WigglingBias, OfTheSimulatorHasTheAmplitudeAndPeriodOfItsHarmonics) {
  TofModel m = perfect(1, 1, 100);
  m.modulation.waveform = TofWaveform::triangle;
  for (const auto& [f, peak_to_peak_m] : {std::pair{30e6, 0.113}, {50e6, 0.068}}) {
    m.modulation.frequencies_hz = {f};
    const double period = kLightSpeed_mps / (8 * f);
    const auto e = errors_over(m, 0.5, 0.5 + period, 400),
               later = errors_over(m, 0.5 + period, 0.5 + 2 * period, 400);
    const auto [low, high] = std::minmax_element(e.begin(), e.end());
    EXPECT_NEAR(*high - *low, peak_to_peak_m, 0.0006);
    for (std::size_t i = 0; i < e.size(); ++i) ASSERT_NEAR(e[i], later[i], 1e-5);
    // Not periodic with less.
    double half = 0;
    for (std::size_t i = 0; i < 200; ++i) half = std::max(half, std::abs(e[i] - e[i + 200]));
    EXPECT_GT(half, 0.05 * peak_to_peak_m / 0.068);
  }
  m.modulation.frequencies_hz = {30e6};
  m.modulation.waveform = TofWaveform::harmonics;
  m.modulation.harmonics = {1.0 / 9};
  const auto e = errors_over(m, 0.5, 5.5, 800);
  EXPECT_NEAR(*std::max_element(e.begin(), e.end()), 6.38 / 360 * m.unambiguous_range_m(), 1e-4);
  m.modulation.wiggling_bias = false;
  for (const double off : errors_over(m, 0.5, 5.5, 50)) ASSERT_NEAR(off, 0, 1e-5);
}

TEST(RangeError, OfTheSimulatorIsTheModelsSplineOffsetAndErrorOfTheAmplitude) {
  TofModel m = perfect(1, 1, 100);
  m.range_error.wiggling = {0.7, 3.2, {0, 8e-3, -5e-3, 6e-3, 1e-3, -4e-3, 2e-3}};
  const auto spline = [&](double r) {
    double first = 0, b[4], w = 0;
    models::TofMath<double>::tof_spline(r, 0.7, 3.2, 4, first, b[0], b[1], b[2], b[3]);
    for (int k = 0; k < 4; ++k)
      w +=
          b[k] * m.range_error.wiggling.coefficients_m[static_cast<std::size_t>(static_cast<int>(first) + k)];
    return w;
  };
  const auto e = errors_over(m, 0.5, 3.5, 60);
  for (int i = 0; i < 60; ++i) ASSERT_NEAR(e[static_cast<std::size_t>(i)], spline(0.5 + 0.05 * i), 2e-6);
  EXPECT_GT(*std::max_element(e.begin(), e.end()), 3e-3);
  m.modulation.wiggling_bias = false;
  for (const double off : errors_over(m, 0.5, 3.5, 20)) ASSERT_NEAR(off, 0, 2e-6);
  m.range_error.offset_m = 0.02;
  m.range_error.amplitude_error_m_e = 40;
  for (const double range : {1.0, 2.0, 4.5}) {
    const double amplitude = 0.5 * 0.5 * m.active_electrons(range, 0.8);
    EXPECT_NEAR(errors_over(m, range, range + 1, 1)[0], 0.02 + 40 / amplitude, 5e-6) << range;
  }
  // Beyond the end of the unambiguous range it starts anew, as a phase does.
  TofBench b;
  const double last = m.unambiguous_range_m() - 0.005;
  b.wall(last);
  EXPECT_NEAR(b.shoot(m).range_m[0], 0.015 + 40 / (0.25 * m.active_electrons(last, 0.8)), 5e-6);
}

TEST(RangeError, SplineMovesLightBeforeItMixes) {
  // Two surfaces in a pixel, each with the error of its own range.
  TofModel m = perfect(1, 1, 100);
  m.sampling.samples = 4;
  m.range_error.wiggling = {1, 3, {-0.02, -0.02, -0.02, 0.03, 0.03, 0.03}};
  TofBench b;
  b.engine->add(Rectangle{.centre = {5, 0, 1}, .half_u = {5, 0, 0}, .half_v = {0, 5, 0}},
                {.reflectance = grey(0.2F)});
  b.wall(2.9, 0.8F);
  const double f = m.modulation.frequencies_hz[0];
  const auto near = phasor_of(0.5 * m.active_electrons(1, 0.2), 1 - 0.02, f),
             far = phasor_of(0.5 * m.active_electrons(2.9, 0.8), 2.9 + 0.03, f);
  EXPECT_NEAR(b.shoot(m).range_m[0], range_of(near + far, f), 2e-4);
}

/// Noise of a wall whose pixels all see one range.
Spread wall_noise(TofModel m, double range_m, std::uint64_t index = 0,
                  std::vector<float>* amplitude = nullptr) {
  TofBench b;
  b.wall(range_m);
  const TofPicture p = b.shoot(m, index);
  if (amplitude) *amplitude = p.amplitude;
  return spread_of(p.range_m);
}
TofModel noisy(double intensity_w_per_sr = 0.2) {
  TofModel m = perfect(80, 80, 1e6);
  m.pixel.trembling = true;
  m.illumination.radiant_intensity_w_per_sr = intensity_w_per_sr;
  return m;
}

TEST(Trembling, NoiseOfRangeAndAmplitudeIsTheFormulas) {
  for (const double read : {0.0, 60.0})
    for (const double range : {1.0, 2.7, 4.2}) {
      TofModel m = noisy(2);
      m.pixel.read_noise_e = read;
      m.pixel.dark_current_e_per_s = 3e6;
      const double a = m.active_electrons(range, 0.8) / 2, background = 3e6 * m.modulation.integration_time_s;
      const double sigma =
          models::TofMath<double>::tof_range_sigma(2 * 30e6 / kLightSpeed_mps, a, background, read, 0.5);
      std::vector<float> amplitude;
      const Spread s = wall_noise(m, range, 0, &amplitude);
      const double phase = sigma * 4 * kPi * 30e6 / kLightSpeed_mps;
      ASSERT_LT(phase, 0.1);
      EXPECT_NEAR(s.sigma / sigma, 1, chi_bound(6400) + phase * phase) << range;
      EXPECT_NEAR(s.mean, range, 4 * sigma / 80 + 1e-5);
      const Spread s_a = spread_of(amplitude);
      EXPECT_NEAR(s_a.sigma / std::sqrt((a + background + read * read) / 2), 1,
                  chi_bound(6400) + phase * phase);
    }
}

TEST(Trembling, IsNewInEachFrameAndOffWithItsSwitch) {
  TofBench b;
  b.wall(2);
  TofModel m = noisy();
  m.pixel.read_noise_e = 30;
  const auto camera = b.camera(m);
  const TofPicture first = b.shoot(*camera, 0), again = b.shoot(*camera, 0), next = b.shoot(*camera, 1);
  EXPECT_TRUE(same(first, again));
  EXPECT_FALSE(same(first, next));
  double product = 0;
  for (std::size_t i = 0; i < 6400; ++i)
    product += (double(first.range_m[i]) - 2) * (double(next.range_m[i]) - 2);
  const double sigma = spread_of(first.range_m).sigma;
  EXPECT_NEAR(product / 6400 / (sigma * sigma), 0, 4 / 80.0);  // uncorrelated
  EXPECT_FALSE(same(first, b.shoot(*b.camera(m, false, 2))));
  EXPECT_FALSE(same(first, b.shoot(*b.camera(m, false, 1, "other"))));
  m.pixel.trembling = false;
  EXPECT_LT(spread_of(b.shoot(m).range_m).sigma, 1e-6);
}

TEST(SineLikeNoise, OfTheSimulatorHasItsRatioAndPeriod) {
  TofModel m = noisy(5);
  m.modulation.waveform = TofWaveform::triangle;
  m.modulation.wiggling_bias = false;
  m.pixel.dark_current_e_per_s = 5e7;  // what range does to the light, does little to the noise
  const double turn = kLightSpeed_mps / (2 * 30e6);
  // Noise times E is what the correlation's amplitude alone changes.
  const auto noise = [&](double turns) {
    const double range = turns * turn, e = m.active_electrons(range, 0.8);
    const double shot = std::sqrt(e / 2 + 5e4);
    return wall_noise(m, range).sigma * e / shot;
  };
  const double strong = noise(0.25), weak = noise(0.375), strong_again = noise(0.5);
  EXPECT_NEAR(strong / weak, std::sqrt(0.5), std::sqrt(0.5) * (1.5 * chi_bound(6400) + 0.01));
  EXPECT_NEAR(strong / strong_again, 1, 1.5 * chi_bound(6400) + 0.01);
  m.modulation.sine_like_noise = false;
  EXPECT_NEAR(noise(0.25) / noise(0.375), 1, 1.5 * chi_bound(6400) + 0.01);
}

TEST(TofSimulator, SeveralFrequenciesAreWeighedByTheirNoise) {
  TofModel m = noisy(2);
  m.modulation.frequencies_hz = {80e6, 100e6};
  const double a = m.active_electrons(2, 0.8) / 2;
  const auto sigma_of = [&](double f) {
    return models::TofMath<double>::tof_range_sigma(2 * f / kLightSpeed_mps, a, 0, 0, 0.5);
  };
  const double both = 1 / std::hypot(1 / sigma_of(80e6), 1 / sigma_of(100e6));
  EXPECT_NEAR(wall_noise(m, 2).sigma / both, 1, chi_bound(6400) + 0.01);
}

TEST(FixedPattern, RepeatsFromFrameToFrameWithItsSigmas) {
  TofBench b;
  b.wall(2);
  TofModel m = perfect(80, 80, 1e6);
  m.pixel.range_offset_sigma_m = 0.01;
  m.pixel.gain_sigma = 0.02;
  const auto camera = b.camera(m);
  const TofPicture first = b.shoot(*camera, 0), next = b.shoot(*camera, 17);
  EXPECT_TRUE(same(first, next));
  const Spread range = spread_of(first.range_m), amplitude = spread_of(first.amplitude);
  EXPECT_NEAR(range.sigma / 0.01, 1, chi_bound(6400));
  EXPECT_NEAR(range.mean, 2, 4 * 0.01 / 80);
  EXPECT_NEAR(amplitude.sigma / amplitude.mean / 0.02, 1, chi_bound(6400) + 0.001);
  EXPECT_FALSE(same(first, b.shoot(*b.camera(m, false, 2))));
}

TEST(FixedPattern, OffsetsWrapWithThePhase) {
  TofBench b;
  TofModel m = perfect(40, 40, 1e6);
  b.wall(m.unambiguous_range_m() - 0.005);
  m.pixel.range_offset_sigma_m = 0.01;
  int wrapped = 0;
  for (const float r : b.shoot(m).range_m) {
    ASSERT_GE(r, 0.0F);
    ASSERT_LT(r, float(m.unambiguous_range_m()) + 1e-4F);
    wrapped += r < 1;
  }
  EXPECT_NEAR(wrapped / 1600.0, 0.309, 4 * 0.46 / 40);  // of a normal draw beyond half a sigma
}

TEST(TofSimulator, WithoutNoiseOnlyTheConverterRounds) {
  TofBench b;
  b.wall(2.3);
  TofModel m = perfect(31, 21, 30);
  m.pixel.full_well_e = 3 * m.active_electrons(2.3, 0.8);
  const TofPicture exact = b.shoot(m, 0, true);
  m.pixel.adc_bits = 8;
  const TofPicture p = b.shoot(m, 0, true);
  const double step = m.pixel.full_well_e / 255;
  bool any = false;
  for (std::size_t i = 0; i < p.taps.size(); ++i) {
    ASSERT_NEAR(p.taps[i] / step, std::round(p.taps[i] / step), 1e-4);
    ASSERT_LE(std::abs(p.taps[i] - exact.taps[i]), step * 0.5001);
    any = any || p.taps[i] != exact.taps[i];
  }
  EXPECT_TRUE(any);
}

TEST(TofSimulator, OnePhotonAndFullWell) {
  TofBench b;
  b.wall(2);
  TofModel m = noisy(1);
  m.illumination.radiant_intensity_w_per_sr =
      0.5 / m.active_electrons(2, 0.8);  // half a photon in all taps' E
  const TofPicture few = b.shoot(m, 0, true);
  double sum = 0;
  for (const float d : few.taps) {
    ASSERT_EQ(d, std::floor(d));
    ASSERT_GE(d, 0);
    sum += double(d);
  }
  EXPECT_NEAR(sum / double(few.taps.size()), 0.25, 4 * 0.5 / std::sqrt(double(few.taps.size())));
  for (std::size_t i = 0; i < few.range_m.size(); ++i)
    ASSERT_EQ(std::isnan(few.range_m[i]), few.amplitude[i] == 0);  // taps that cancel say nothing
  // The well: full just above the largest tap, not just below.
  TofModel full = perfect(1, 1, 100);
  const double largest = full.active_electrons(2, 0.8) / 2 *
                         (1 + 0.5 * std::max({std::abs(std::cos(2 * kPi * turns_of(2, 30e6))),
                                              std::abs(std::sin(2 * kPi * turns_of(2, 30e6)))}));
  full.pixel.full_well_e = largest * 1.0001;
  EXPECT_EQ(b.shoot(full).status[0], TofPixelStatus::valid);
  full.pixel.full_well_e = largest * 0.9999;
  const TofPicture over = b.shoot(full);
  EXPECT_EQ(over.status[0], TofPixelStatus::saturated);
  EXPECT_TRUE(std::isnan(over.range_m[0]));
}

/// A model with all errors on, and a world that needs them.
TofModel everything() {
  TofModel m = perfect(48, 36, 45);
  m.pixel.trembling = true;
  m.pixel.read_noise_e = 30;
  m.pixel.adc_bits = 12;
  m.pixel.full_well_e = 3e5;
  m.pixel.range_offset_sigma_m = 0.004;
  m.pixel.gain_sigma = 0.01;
  m.modulation.frequencies_hz = {30e6, 40e6};
  m.modulation.waveform = TofWaveform::harmonics;
  m.modulation.harmonics = {0.03, 0.01};
  m.modulation.tap_window_s = 0.02;
  m.optics.filter_width_m = 40e-9;
  m.sampling = {.samples = 4, .motion = true, .multipath_rays = 2};
  m.filters = {.flying_pixel_m = 0.05, .median_px = 3, .bilateral_radius_px = 2};
  return m;
}
void furnish(TofBench& b) {
  b.wall(3);
  b.engine->add(Sphere{.centre = {0.2, 0, 2}, .radius_m = 0.4},
                {.velocity_m_per_s = {1, 0, 0}, .t_ref = b.t});
  b.world.still.frame.light.direction_to_sun = {0, -0.6, 0.8};
  b.world.still.frame.light.sun_irradiance = grey(10);
  b.world.moves = true;
}

TEST(TofSimulator, GivesTheSameBytesOnAnyNumberOfThreads) {
  TofBench b;
  furnish(b);
  for (int which = 0; which < 3; ++which) {
    TofModel m = everything();
    m.sampling.bilinear = which == 1;
    if (which == 2) {  // samples that instants share, of a sensor that moves
      m.sampling.multipath_rays = 0;
      b.pose = [&b](BenchTime t) {
        Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
        pose.translation().x() = (t - b.t).seconds();
        return pose;
      };
    }
    TofPicture one;
    for (const std::size_t threads : {1u, 2u, 4u}) {
      const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
      const TofPicture p = b.shoot(m, 5);
      if (threads == 1)
        one = p;
      else
        EXPECT_TRUE(same(one, p)) << threads;
    }
    EXPECT_GT(spread_of(one.range_m).count, 1000);
  }
}

TEST(TofSimulator, TwoEnginesHaveTheSameNoise) {
  // Noise belongs to seed, channel, pixel and frame: what a pixel reads does not hang on who found the range.
  TofBench a, b;
  furnish(a);
  furnish(b);
  b.engine->add(Sphere{.centre = {0, 0, -5}, .radius_m = 1});  // another scene that looks the same
  EXPECT_TRUE(same(a.shoot(everything(), 3), b.shoot(everything(), 3)));
}

TEST(Sr4000, HasFourMillimetresOnAWhiteWallAt130) {
  const auto model =
      load_tof_model(std::filesystem::path(rigor::test::source_dir()) / "configs/sensors/sr4000.yaml");
  ASSERT_TRUE(model) << model.error().text();
  TofBench b;
  b.wall(1.30, 0.9F);
  const auto camera = b.camera(*model);
  const int frames = 12;
  const std::size_t pixels = 176 * 144;
  std::vector<double> sum(pixels, 0), squares(pixels, 0);
  for (int i = 0; i < frames; ++i) {
    const TofPicture p = b.shoot(*camera, std::uint64_t(i));
    for (std::size_t k = 0; k < pixels; ++k) {
      ASSERT_FALSE(std::isnan(p.range_m[k]));
      sum[k] += double(p.range_m[k]);
      squares[k] += double(p.range_m[k]) * double(p.range_m[k]);
    }
  }
  double sigma = 0;
  for (std::size_t k = 0; k < pixels; ++k)
    sigma += std::sqrt(std::max(0.0, (squares[k] - sum[k] * sum[k] / frames) / (frames - 1)));
  sigma /= double(pixels) * 0.9776;  // mean of a sample standard deviation of 12 (c4)
  EXPECT_NEAR(sigma, 4.0e-3, 0.4e-3);
}

}  // namespace
}  // namespace rigor::test

#include "calibration/photon/photon_fit.h"

#include <Eigen/Dense>
#include <cmath>
#include <iostream>
#include <map>
#include <numbers>
#include <random>

#include "calibration/photon/rounding.h"
#include "calibration/photon/twin.h"
#include "sensor-hal/models/one_source.h"
#include "tests/calibration/photon/photon_fixture.h"

namespace rigor::calibration {
namespace {

std::map<std::string, double> truth_of(const CameraModel& m) {
  return {{"system_gain_dn_per_e", m.noise.system_gain_dn_per_e},
          {"black_level_dn", m.noise.black_level_dn},
          {"read_noise_e", m.noise.read_noise_e},
          {"dark_current_e_per_s", m.noise.dark_current_e_per_s},
          {"dsnu_e", m.noise.dsnu_e},
          {"prnu", m.noise.prnu},
          {"full_well_e", m.noise.full_well_e},
          {"dark_doubling_k", m.noise.dark_doubling_k},
          {"response_c2", m.noise.response_c2},
          {"response_c3", m.noise.response_c3}};
}

struct Closing {
  double chi2 = 0, dof = 0;
  int inside = 0, intervals = 0;
  std::map<std::string, std::pair<double, double>> normalised;  // sum, sum of squares
};

void judge(const FitResult& r, const std::map<std::string, double>& truth, Closing& c) {
  std::vector<Eigen::Index> at;
  std::vector<double> error;
  for (std::size_t i = 0; i < r.parameters.size(); ++i) {
    const Parameter& p = r.parameters[i];
    const auto t = truth.find(p.name);
    if (t == truth.end()) continue;
    at.push_back(static_cast<Eigen::Index>(i));
    error.push_back(p.value - t->second);
    const double z = error.back() / p.sigma;
    c.normalised[p.name].first += z;
    c.normalised[p.name].second += z * z;
    c.inside += std::abs(z) <= 1.959964;
    ++c.intervals;
  }
  const Eigen::MatrixXd cov = r.covariance(at, at);
  const Eigen::Map<Eigen::VectorXd> e(error.data(), static_cast<Eigen::Index>(error.size()));
  c.chi2 += e.dot(cov.ldlt().solve(e));
  c.dof += static_cast<double>(error.size());
}

/// Limits that a right covariance passes in 999 of 1000 runs.
void expect_honest(const Closing& c) {
  for (const auto& [name, s] : c.normalised)
    std::cout << "  " << name << ": mean of normalised errors " << s.first / 100 << ", mean square "
              << s.second / 100 << "\n";
  std::cout << "  χ²/dof " << c.chi2 / c.dof << " of " << c.dof << ", inside " << c.inside << " of "
            << c.intervals << "\n";
  const double z = 3.29, a = 2 / (9 * c.dof);
  EXPECT_LT(c.chi2 / c.dof, std::pow(1 - a + z * std::sqrt(a), 3));
  EXPECT_GT(c.chi2 / c.dof, std::pow(1 - a - z * std::sqrt(a), 3));
  // The intervals of one fit are correlated: at most as much as if there were one for each two.
  const double n = c.intervals, sigma = std::sqrt(n * 0.95 * 0.05);
  EXPECT_NEAR(c.inside, 0.95 * n, 3.29 * sigma + 0.5);
}

TEST(PhotonFit, RecoversTheSimulatedSensorWithinItsOwnUncertainty) {
  const CameraModel m = noisy_camera(64, 48);
  Closing c;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Bench bench(m, seed);
    FrameStacks stacks;
    take(stacks, bench, {});
    // The search for other models costs most of the time, and changes nothing where it finds none.
    const auto fit = fit_photon(stacks, {.model = seed % 4 == 0 ? "auto" : "one_gain"});
    ASSERT_TRUE(fit) << fit.error().text();
    if (seed == 0) std::cout << all_words(fit->result);
    ASSERT_EQ(fit->result.model, "one_gain") << "seed " << seed;
    ASSERT_EQ(fit->result.find("full_well_e") != nullptr, true) << all_words(fit->result);
    judge(fit->result, truth_of(m), c);
  }
  EXPECT_EQ(c.intervals, 700);
  expect_honest(c);
}

/// A response that bends by 5 % at full scale, and dark frames at two temperatures: everything at once.
TEST(PhotonFit, RecoversASensorWhoseResponseBends) {
  CameraModel m = noisy_camera(64, 48);
  m.noise.response_c2 = -0.07;
  m.noise.dark_doubling_k = 6.3;
  CameraModel warm = m;
  warm.noise.temperature_c = 43;
  Closing c;
  int cubic = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Bench bench(m, seed), warm_bench(warm, seed);
    warm_bench.index = 5000;
    FrameStacks stacks;
    Series s;
    s.frames = 5;
    s.light_s = {0.001, 0.004, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.072, 0.1};
    s.temperature_c = 25;
    take(stacks, bench, s);
    s.temperature_c = 43, s.dark_s = {0.002, 0.06}, s.light_s = {};
    take(stacks, warm_bench, s);
    const auto fit = fit_photon(stacks, {});
    ASSERT_TRUE(fit) << fit.error().text();
    if (seed == 0) std::cout << all_words(fit->result);
    ASSERT_EQ(fit->result.model, "one_gain_bent") << "seed " << seed << all_words(fit->result);
    ASSERT_TRUE(fit->result.find("full_well_e")) << all_words(fit->result);
    cubic += fit->response.terms == 2;
    judge(fit->result, truth_of(m), c);
  }
  // A term that is not there is taken where chance makes 16 of χ² with it.
  EXPECT_LE(cubic, 2);
  expect_honest(c);
}

/// A read-out that puts three steps into one above 900 DN, as companding does.
TEST(PhotonFit, RecoversAGainThatChanges) {
  const CameraModel m = noisy_camera(64, 48);
  auto truth = truth_of(m);
  truth["system_gain_above_dn_per_e"] = 0.38 / 3;
  Closing c;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Bench bench(m, seed);
    FrameStacks stacks;
    Series s;
    s.frames = 5;
    take(stacks, bench, s, [](std::vector<std::uint16_t>& pixels) {
      for (auto& p : pixels)
        if (p > 900) p = static_cast<std::uint16_t>(900 + (p - 900 + 1) / 3);
    });
    const auto fit = fit_photon(stacks, {});
    ASSERT_TRUE(fit) << fit.error().text();
    if (seed == 0) std::cout << all_words(fit->result);
    ASSERT_EQ(fit->result.model, "two_gains") << "seed " << seed << all_words(fit->result);
    judge(fit->result, truth, c);
  }
  expect_honest(c);
}

/// Eight bits of converter: the noise of the dark is a sixth of a step, the 1/12 of EMVA 1288 is wrong there.
TEST(PhotonFit, RecoversASensorWhoseNoiseIsBelowTheConvertersStep) {
  CameraModel m = noisy_camera(64, 48);
  m.noise.adc_bits = 8;
  m.noise.system_gain_dn_per_e = 0.03;
  m.noise.black_level_dn = 5.3;
  m.noise.full_well_e = 20000;
  m.noise.read_noise_e = 8;
  m.noise.dsnu_e = 6;
  Closing c;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Bench bench(m, seed);
    FrameStacks stacks;
    take(stacks, bench, {});
    const auto fit = fit_photon(stacks, {.model = "one_gain", .bits = 8});
    ASSERT_TRUE(fit) << fit.error().text();
    if (seed == 0) std::cout << all_words(fit->result);
    auto truth = truth_of(m);
    truth.erase("full_well_e");  // the converter is full first
    judge(fit->result, truth, c);
  }
  expect_honest(c);
}

TEST(PhotonFit, RoundingAgreesWithSampling) {
  std::mt19937_64 random(1);
  for (const auto& [mean, sigma, tau] :
       {std::array{5.3, 0.2, 0.1}, {5.5, 0.25, 0.02}, {7.1, 0.35, 0.3}, {3.0, 0.8, 0.0}, {4.2, 0.18, 1.0}}) {
    double m_sum = 0, v_sum = 0;
    const int pixels = 4000, frames = 400;
    std::normal_distribution<double> normal;
    for (int p = 0; p < pixels; ++p) {
      const double f = mean + tau * normal(random);
      double s = 0, q = 0;
      for (int k = 0; k < frames; ++k) {
        const double y = std::floor(f + sigma * normal(random) + 0.5);
        s += y, q += y * y;
      }
      m_sum += s / frames;
      v_sum += (q - s * s / frames) / (frames - 1);
    }
    double m = 0, v = 0;
    rounded_moments(mean, sigma * sigma, tau * tau, m, v);
    EXPECT_NEAR(m, m_sum / pixels,
                4 * std::hypot(sigma / std::sqrt(double(pixels) * frames), tau / std::sqrt(pixels)) + 1e-3);
    EXPECT_NEAR(v, v_sum / pixels, 0.006) << mean << " " << sigma << " " << tau;
  }
}

TEST(PhotonFit, DarkCurrentOverTemperatureGivesItsDoubling) {
  const CameraModel base = noisy_camera();
  FrameStacks stacks;
  for (const double t : {25.0, 35.0, 45.0}) {
    CameraModel m = base;
    m.noise.temperature_c = t;
    m.noise.dark_doubling_k = 6.3;
    Bench bench(m, 7);
    bench.index = static_cast<std::uint64_t>(t) * 1000;
    Series s;
    if (t > 25) s.light_s = {};
    s.temperature_c = t;
    take(stacks, bench, s);
  }
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter* doubling = fit->result.find("dark_doubling_k");
  ASSERT_TRUE(doubling) << all_words(fit->result);
  EXPECT_NEAR(doubling->value, 6.3, 3.5 * doubling->sigma);
  EXPECT_LT(doubling->sigma, 0.1);
  EXPECT_EQ(fit->temperature_reference_c, 25);
}

TEST(PhotonFit, ThirtyPercentHotPixelsAreLeftOutAndMeasured) {
  CameraModel m = noisy_camera();
  m.noise.hot_pixel_share = 0.3;
  m.noise.hot_pixel_dark_e_per_s = 20000;
  Bench bench(m, 3);
  FrameStacks stacks;
  take(stacks, bench, {});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const FitResult& r = fit->result;
  EXPECT_NEAR(static_cast<double>(fit->statistics.outliers.count) / (80 * 64), 0.3, 0.03);
  for (const auto& [name, t] : truth_of(m)) {
    if (!r.find(name)) continue;
    EXPECT_NEAR(r.find(name)->value, t, std::max(4 * r.find(name)->sigma, 0.02 * t)) << name << "\n"
                                                                                     << all_words(r);
  }
  ASSERT_TRUE(r.find("hot_pixel_share")) << all_words(r);
  EXPECT_NEAR(r.find("hot_pixel_share")->value, 0.3, 4 * r.find("hot_pixel_share")->sigma);
  EXPECT_NEAR(r.find("hot_pixel_dark_e_per_s")->value, 20000, 4 * r.find("hot_pixel_dark_e_per_s")->sigma);
  ASSERT_FALSE(r.rejected.empty());
  EXPECT_NE(r.rejected[0].what.find("pixel ("), std::string::npos);
}

/// EMVA 1288 release 4 splits the fixed patterns in rows, columns and pixels.
TEST(PhotonFit, StripesAreToldFromPixels) {
  const CameraModel m = noisy_camera(128, 96);
  for (const bool striped : {true, false}) {
    std::mt19937_64 random(3);
    std::normal_distribution<double> normal;
    std::vector<double> row(96), column(128);
    for (double& r : row) r = striped ? 1.1 * normal(random) : 0;
    for (double& c : column) c = striped ? 0.6 * normal(random) : 0;
    Bench bench(m, 31);
    FrameStacks stacks;
    Series s;
    s.frames = 8;
    std::uniform_real_distribution<double> dither(0, 1);  // offsets of less than a step
    take(stacks, bench, s, [&](std::vector<std::uint16_t>& pixels) {
      if (!striped) return;
      for (std::size_t i = 0; i < pixels.size(); ++i)
        pixels[i] = static_cast<std::uint16_t>(pixels[i] +
                                               std::floor(row[i / 128] + column[i % 128] + dither(random)));
    });
    const auto fit = fit_photon(stacks, {});
    ASSERT_TRUE(fit) << fit.error().text();
    const FitResult& r = fit->result;
    if (!striped) {
      EXPECT_FALSE(r.find("dsnu_row_e")) << all_words(r);
      EXPECT_FALSE(r.find("dsnu_column_e"));
      EXPECT_FALSE(r.find("prnu_row"));
      continue;
    }
    double rows = 0, columns = 0;
    for (const double x : row) rows += x * x / 96;
    for (const double x : column) columns += x * x / 128;
    ASSERT_TRUE(r.find("dsnu_row_e") && r.find("dsnu_column_e")) << all_words(r);
    EXPECT_NEAR(r.find("dsnu_row_e")->value, std::sqrt(rows) / 0.38, 4 * r.find("dsnu_row_e")->sigma);
    EXPECT_NEAR(r.find("dsnu_column_e")->value, std::sqrt(columns) / 0.38,
                4 * r.find("dsnu_column_e")->sigma);
    EXPECT_LT(r.find("dsnu_row_e")->sigma, 0.2 * r.find("dsnu_row_e")->value);
    const PatternVariance& pixel = fit->statistics.dark_split_dn2.pixel;
    EXPECT_NEAR(std::sqrt(pixel.value) / 0.38, 1.2, 0.1);
    EXPECT_NE(all_words(r).find("the offset pattern is striped"), std::string::npos);
  }
}

TEST(PhotonFit, UnitsOfTimeAndOfNumbersChangeNothingButTheUnits) {
  const CameraModel m = noisy_camera();
  const auto run = [&](double time, int shift) {
    Bench bench(m, 5);
    FrameStacks stacks;
    Series s;
    for (const bool light : {false, true})
      for (const double t : light ? s.light_s : s.dark_s)
        for (int i = 0; i < s.frames; ++i) {
          auto pixels = bench.frame(t, light);
          for (auto& p : pixels) p = static_cast<std::uint16_t>(p << shift);
          EXPECT_TRUE(stacks.add({"f", t * time, light}, pixels, m.width_px, m.height_px));
        }
    auto fit = fit_photon(stacks, {.bits = 12});
    EXPECT_TRUE(fit) << fit.error().text();
    return fit->result;
  };
  const FitResult a = run(1, 0), fast = run(1e-6, 0), slow = run(1e6, 4);
  for (const Parameter& p : a.parameters) {
    const double unit = p.name == "dark_current_e_per_s" ? 1e6 : 1;
    ASSERT_TRUE(fast.find(p.name) && slow.find(p.name)) << p.name << all_words(fast);
    EXPECT_NEAR(fast.find(p.name)->value / unit, p.value, 1e-5 * std::abs(p.value)) << p.name;
    EXPECT_NEAR(slow.find(p.name)->value * unit, p.value, 1e-5 * std::abs(p.value)) << p.name;
    EXPECT_NEAR(fast.find(p.name)->sigma / unit, p.sigma, 1e-3 * p.sigma) << p.name;
    EXPECT_NEAR(slow.find(p.name)->sigma * unit, p.sigma, 1e-3 * p.sigma) << p.name;
  }
}

TEST(PhotonFit, AToneCurveIsNamed) {
  const CameraModel m = noisy_camera();
  Bench bench(m, 2);
  FrameStacks stacks;
  take(stacks, bench, {}, [](std::vector<std::uint16_t>& pixels) {
    for (auto& p : pixels)
      p = static_cast<std::uint16_t>(60 + 4035 * std::pow(std::max(0, p - 60) / 4035.0, 1 / 2.2) + 0.5);
  });
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_TRUE(fit->response_exponent) << all_words(fit->result);
  EXPECT_LT(*fit->response_exponent, 0.7);
  EXPECT_NE(all_words(fit->result).find("tone curve"), std::string::npos);
}

TEST(PhotonFit, ALinearSensorIsFoundLinear) {
  Bench bench(noisy_camera(), 4);
  FrameStacks stacks;
  take(stacks, bench, {});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_TRUE(fit->linearity_error);
  EXPECT_LT(*fit->linearity_error, 0.001);
  EXPECT_NEAR(*fit->response_exponent, 1, 0.001);
  ASSERT_TRUE(fit->saturation_signal_dn);
  EXPECT_NEAR(*fit->saturation_signal_dn, 0.38 * 8000, 0.1 * 0.38 * 8000);
  EXPECT_FALSE(fit->converter_saturates);
}

/// Light whose fall-off leaves the corners at half, and a filament that breathes by 2 % from frame to frame.
TEST(PhotonFit, UnevenAndFlickeringLightDoNotMoveTheGain) {
  for (const bool uneven : {true, false}) {
    const CameraModel m = noisy_camera();
    Bench bench(m, 12);
    const OpticsPicture even = bench.bright;
    if (uneven)
      for (int y = 0; y < m.height_px; ++y)
        for (int x = 0; x < m.width_px; ++x)
          bench.bright.radiance[4 * static_cast<std::size_t>(y * m.width_px + x)] *=
              static_cast<float>(1 - 0.5 * (std::pow(x / 79.0 - 0.5, 2) + std::pow(y / 63.0 - 0.5, 2)) * 2);
    std::mt19937_64 random(7);
    std::normal_distribution<float> breath(1, 0.02f);
    FrameStacks stacks;
    Series s;
    s.frames = 8;
    take(stacks, bench, s, [&](std::vector<std::uint16_t>&) {
      // Before the next frame.
      const float f = breath(random);
      if (!uneven)
        for (std::size_t i = 0; i < even.radiance.size(); ++i)
          bench.bright.radiance[i] = f * even.radiance[i];
    });
    const auto fit = fit_photon(stacks, {});
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_EQ(fit->result.model, "one_gain") << all_words(fit->result);
    for (const char* name :
         {"system_gain_dn_per_e", "read_noise_e", "dark_current_e_per_s", "dsnu_e", "prnu"}) {
      const Parameter* p = fit->result.find(name);
      ASSERT_TRUE(p) << name << all_words(fit->result);
      EXPECT_NEAR(p->value, truth_of(m).at(name), 4 * p->sigma) << name << (uneven ? " uneven" : " flicker");
    }
    if (!uneven) {
      ASSERT_TRUE(fit->level_flicker);
      EXPECT_NEAR(*fit->level_flicker, 0.02 / std::sqrt(8), 0.005) << "2 % over eight frames";
    }
  }
}

/// Two runs of one rig draw the same noise for the same captures: the fit must say that it was deceived.
TEST(PhotonFit, NoiseThatRepeatsFromLevelToLevelIsSaid) {
  for (const bool repeated : {true, false}) {
    Bench bench(noisy_camera(), 5);
    FrameStacks stacks;
    for (const bool light : {false, true})
      for (const double t : {0.004, 0.01, 0.02}) {
        if (repeated) bench.index = 0;
        for (int i = 0; i < 4; ++i) ASSERT_TRUE(stacks.add({"f", t, light}, bench.frame(t, light), 80, 64));
      }
    const auto fit = fit_photon(stacks, {});
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_EQ(all_words(fit->result).find("pixel by pixel") != std::string::npos, repeated)
        << all_words(fit->result);
  }
}

/// What the sensor model says is simulated at each level: it must look like the recording, and not like
/// another sensor's.
TEST(PhotonFit, TheTwinIsAsNoisyAsTheSensorAndAWrongOneIsNot) {
  CameraModel m = noisy_camera(128, 96);
  m.noise.response_c2 = -0.05;
  Bench bench(m, 8);
  FrameStacks stacks;
  take(stacks, bench, {});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EmvaNoise sensor_model = m.noise;
  for (const bool wrong : {false, true}) {
    if (wrong) sensor_model.read_noise_e *= 1.5;
    const auto twins = noise_twins(stacks, *fit, sensor_model, 3);
    ASSERT_GE(twins.size(), 10u);
    for (const NoisePair& t : twins) {
      // Both are samples of 8192 and more: a percent of a standard deviation each.
      const double ratio = t.twin_sigma_dn / t.real_sigma_dn;
      if (!wrong) {
        EXPECT_NEAR(ratio, 1, 0.04) << t.level;
        // Of two samples' quantiles at q, and up to half a step of the converter each: √(q (1 − q)/n)/φ(z).
        for (std::size_t i = 1; i + 1 < kNoiseQuantiles.size(); ++i) {
          const double q = kNoiseQuantiles[i];
          const double z = models::NoiseMath<double>::normal_quantile(q);
          const double density = std::exp(-0.5 * z * z) / std::sqrt(2 * std::numbers::pi);
          const double n =
              1 / (1.0 / static_cast<double>(t.real_dn.size()) + 1.0 / static_cast<double>(t.twin_dn.size()));
          EXPECT_NEAR(t.twin_quantiles_dn[i], t.real_quantiles_dn[i],
                      4 * std::sqrt(q * (1 - q) / n) / density * t.real_sigma_dn + 0.5)
              << t.level << " quantile " << q;
        }
      } else if (t.signal_dn < 1) {
        EXPECT_GT(ratio, 1.2) << t.level;
      }
    }
  }
}

TEST(PhotonFit, TwoFramesOfEachLevelAreEnough) {
  const CameraModel m = noisy_camera();
  Bench bench(m, 21);
  FrameStacks stacks;
  Series s;
  s.frames = 2;
  take(stacks, bench, s);
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  for (const char* name : {"system_gain_dn_per_e", "read_noise_e", "black_level_dn", "prnu"}) {
    const Parameter* p = fit->result.find(name);
    ASSERT_TRUE(p) << name << all_words(fit->result);
    EXPECT_NEAR(p->value, truth_of(m).at(name), 4 * p->sigma) << name;
    EXPECT_LT(p->sigma, 0.1 * p->value) << name;
  }
}

// --- what the data do not say ----------------------------------------------------------------------------

TEST(PhotonFit, ASingleExposureGivesTheGainAndNoMore) {
  Bench bench(noisy_camera(), 1);
  FrameStacks stacks;
  take(stacks, bench, {.dark_s = {0.02}, .light_s = {0.02}, .frames = 16});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter* gain = fit->result.find("system_gain_dn_per_e");
  ASSERT_TRUE(gain);
  EXPECT_NEAR(gain->value, 0.38, 4 * gain->sigma);
  EXPECT_TRUE(not_identifiable(fit->result, "dark_current_e_per_s", "one exposure time"))
      << all_words(fit->result);
  EXPECT_TRUE(not_identifiable(fit->result, "linearity", "three exposure times"));
  EXPECT_TRUE(not_identifiable(fit->result, "full_well_e", "longer"));
  EXPECT_FALSE(fit->result.find("dark_current_e_per_s"));
}

TEST(PhotonFit, AllSaturatedIsRefusedWithWhatToDo) {
  Bench bench(noisy_camera(), 1);
  FrameStacks stacks;
  take(stacks, bench, {.dark_s = {}, .light_s = {0.02, 0.04}},
       [](auto& pixels) { std::fill(pixels.begin(), pixels.end(), std::uint16_t{4095}); });
  const auto fit = fit_photon(stacks, {});
  ASSERT_FALSE(fit);
  EXPECT_EQ(fit.error().exit_status(), 2);
  EXPECT_NE(fit.error().text().find("saturated"), std::string::npos) << fit.error().text();
}

TEST(PhotonFit, AllBlackIsRefusedWithWhatToDo) {
  Bench bench(noisy_camera(), 1);
  FrameStacks stacks;
  take(stacks, bench, {.dark_s = {0.02, 0.1}, .light_s = {0.01}},
       [](auto& pixels) { std::fill(pixels.begin(), pixels.end(), std::uint16_t{0}); });
  const auto fit = fit_photon(stacks, {});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().text().find("clipped at black"), std::string::npos) << fit.error().text();
  EXPECT_NE(fit.error().text().find("raise the black level"), std::string::npos);
}

TEST(PhotonFit, ClippedBlacksLeaveTheGainAndNeverReadAsNoNoise) {
  CameraModel m = noisy_camera();
  m.noise.black_level_dn = 0;
  m.noise.dark_current_e_per_s = 10;
  Bench bench(m, 1);
  FrameStacks stacks;
  take(stacks, bench, {});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter* gain = fit->result.find("system_gain_dn_per_e");
  ASSERT_TRUE(gain) << all_words(fit->result);
  EXPECT_NEAR(gain->value, 0.38, 4 * gain->sigma);
  for (const char* name : {"read_noise_e", "black_level_dn", "dsnu_e"}) {
    EXPECT_TRUE(not_identifiable(fit->result, name, "clipped at black")) << name << all_words(fit->result);
    EXPECT_FALSE(fit->result.find(name));
  }
}

TEST(PhotonFit, CopiesAreLeftOutAndNamed) {
  Bench bench(noisy_camera(), 1);
  FrameStacks stacks;
  const auto dark = bench.frame(0.02, false), light = bench.frame(0.02, true);
  for (const char* name : {"first", "second"}) {
    ASSERT_TRUE(stacks.add({std::string("dark ") + name, 0.02, false}, dark, 80, 64));
    ASSERT_TRUE(stacks.add({std::string("light ") + name, 0.02, true}, light, 80, 64));
  }
  EXPECT_EQ(stacks.copies().size(), 2u);
  const auto fit = fit_photon(stacks, {});
  ASSERT_FALSE(fit) << "two identical frames have no variance: no gain of 0, no noise of 0";
  EXPECT_NE(fit.error().text().find("one frame has no temporal variance"), std::string::npos)
      << fit.error().text();
}

/// Eight bits with 0.06 DN of noise: dark frames stand still. No noise of 0, no black level to a thousandth.
TEST(PhotonFit, NoiseFarBelowTheStepIsNoNumber) {
  CameraModel m = noisy_camera();
  m.noise.adc_bits = 8;
  m.noise.system_gain_dn_per_e = 0.025;
  m.noise.black_level_dn = 4.3;
  m.noise.dsnu_e = 1;
  m.noise.full_well_e = 20000;
  Bench bench(m, 4);
  FrameStacks stacks;
  Series s;
  s.dark_s = {0.002, 0.02};
  take(stacks, bench, s);
  const auto fit = fit_photon(stacks, {.bits = 8});
  ASSERT_TRUE(fit) << fit.error().text();
  const FitResult& r = fit->result;
  EXPECT_EQ(r.model, "one_gain") << all_words(r);
  EXPECT_TRUE(not_identifiable(r, "read_noise_e", "below the converter's step")) << all_words(r);
  EXPECT_FALSE(r.find("read_noise_e"));
  EXPECT_FALSE(r.find("dsnu_e"));
  ASSERT_TRUE(r.find("black_level_dn"));
  EXPECT_NEAR(r.find("black_level_dn")->value, 4.3, 4 * r.find("black_level_dn")->sigma);
  EXPECT_GT(r.find("black_level_dn")->sigma, 0.01) << "the statistics of frames that stand still say 0.0001";
  EXPECT_NEAR(r.find("system_gain_dn_per_e")->value, 0.025, 4 * r.find("system_gain_dn_per_e")->sigma);
}

TEST(PhotonFit, DarkFramesAloneGiveNothingInElectrons) {
  Bench bench(noisy_camera(), 1);
  FrameStacks stacks;
  take(stacks, bench, {.light_s = {}});
  const auto fit = fit_photon(stacks, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(not_identifiable(fit->result, "system_gain_dn_per_e"));
  EXPECT_TRUE(not_identifiable(fit->result, "read_noise_e", "electrons"));
  ASSERT_TRUE(fit->result.find("dark_noise_dn"));
  EXPECT_NEAR(fit->result.find("dark_noise_dn")->value, std::hypot(0.38 * 2.3, std::sqrt(1.0 / 12)), 0.05);
}

TEST(PhotonFit, PicturesOfTwoSizesAndTwoGainsAreRefused) {
  FrameStacks stacks;
  const std::vector<std::uint16_t> small(64, 5), large(80, 5);
  ASSERT_TRUE(stacks.add({"a.png", 0.01, true}, small, 8, 8));
  const Status size = stacks.add({"b.png", 0.01, true}, large, 10, 8);
  ASSERT_FALSE(size);
  EXPECT_NE(size.error().text().find("a.png"), std::string::npos);
  EXPECT_EQ(size.error().code, ErrorCode::bad_input);
  EXPECT_FALSE(stacks.add({"c.png", 0.01, true, 20, 6.0}, small, 8, 8));
  EXPECT_FALSE(stacks.add({"d.png", 0, true}, small, 8, 8)) << "an exposure of 0";
}

TEST(PhotonFit, EveryDepthOfConverter) {
  for (const int bits : {8, 10, 12, 16}) {
    CameraModel m = noisy_camera();
    const double scale = std::ldexp(1.0, bits - 12);
    m.noise.adc_bits = bits;
    m.noise.system_gain_dn_per_e = 0.38 * scale;
    m.noise.black_level_dn = bits == 8 ? 6 : 60 * scale;
    Bench bench(m, 9);
    FrameStacks stacks;
    take(stacks, bench, {});
    const auto fit = fit_photon(stacks, {.bits = bits});
    ASSERT_TRUE(fit) << fit.error().text();
    const Parameter* gain = fit->result.find("system_gain_dn_per_e");
    ASSERT_TRUE(gain) << bits;
    EXPECT_NEAR(gain->value, m.noise.system_gain_dn_per_e, 4.5 * gain->sigma) << bits;
    EXPECT_LT(gain->sigma, 0.02 * gain->value);
  }
}

}  // namespace
}  // namespace rigor::calibration

// The model that a pair asks for: planted changes come back, and their uncertainty is what it says.
#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "calibration/core/chi_squared.h"
#include "calibration/pair/cloud_model.h"
#include "calibration/pair/image_model.h"
#include "calibration/pair/range_model.h"
#include "calibration/pair/value_model.h"
#include "tests/calibration/pair/synthetic_pairs.h"

namespace rigor::calibration {
namespace {

using namespace testing;

void expect_within(const FitResult& change, const char* name, double truth, double sigmas = 4) {
  const Parameter* p = change.find(name);
  ASSERT_NE(p, nullptr) << name;
  EXPECT_NEAR(p->value, truth, sigmas * p->sigma) << name << " ± " << p->sigma;
  EXPECT_GT(p->sigma, 0) << name;
}

/// Joint normalised errors of these parameters over seeds, by the whole covariance, and how many lie
/// within 1.96 sigmas.
class Consistency {
 public:
  explicit Consistency(std::vector<std::pair<std::string, double>> truth) : truth_(std::move(truth)) {}
  void add(const FitResult& change) {
    const auto n = static_cast<Eigen::Index>(truth_.size());
    Eigen::VectorXd z(n);
    Eigen::MatrixXd correlation(n, n);
    std::vector<int> at;
    for (std::size_t i = 0; i < truth_.size(); ++i) {
      const Parameter* p = change.find(truth_[i].first);
      ASSERT_NE(p, nullptr) << truth_[i].first;
      at.push_back(change.index_of(truth_[i].first));
      z[Eigen::Index(i)] = (p->value - truth_[i].second) / p->sigma;
      mean_[i] += z[Eigen::Index(i)], mean_square_[i] += z[Eigen::Index(i)] * z[Eigen::Index(i)];
      inside_ += std::abs(z[Eigen::Index(i)]) < 1.959964;
    }
    for (Eigen::Index i = 0; i < n; ++i)
      for (Eigen::Index k = 0; k < n; ++k)
        correlation(i, k) = change.covariance(at[std::size_t(i)], at[std::size_t(k)]) /
                            (change.parameters[std::size_t(at[std::size_t(i)])].sigma *
                             change.parameters[std::size_t(at[std::size_t(k)])].sigma);
    squares_ += z.dot(correlation.ldlt().solve(z));
    n_ += int(n), ++seeds_;
  }
  void expect_good() const {
    const double n = n_, share = inside_ / n;
    for (std::size_t i = 0; i < truth_.size(); ++i)
      std::printf("  %s: mean error %+.2f sigmas, chi-squared per number %.2f\n", truth_[i].first.c_str(),
                  mean_[i] / seeds_, mean_square_[i] / seeds_);
    std::printf("  joint chi-squared %.1f of %d, coverage of 95 %%: %.3f\n", squares_, n_, share);
    EXPECT_LT(squares_, chi_squared_quantile(0.9995, n));
    EXPECT_GT(squares_, chi_squared_quantile(0.0005, n));
    // Parameters of a fit hang together: the binomial limit at 0.001 is that of half as many.
    EXPECT_GT(share, 0.95 - 3.29 * std::sqrt(0.95 * 0.05 / (n / 2)));
  }

 private:
  std::vector<std::pair<std::string, double>> truth_;
  double squares_ = 0;
  std::array<double, 8> mean_{}, mean_square_{};
  int n_ = 0, inside_ = 0, seeds_ = 0;
};

// ---- cameras

CameraChange all_of_a_camera() {
  CameraChange c;
  c.focal = 0.01, c.electronics = 0.1, c.offset_dn = 6,
  c.turn_rad = {0.3 * kDegree, -0.5 * kDegree, 0.4 * kDegree};
  return c;
}

TEST(ImagePair, AllChangesAtOnceComeBackAndOneStepAloneDoesNot) {
  const CameraModel simulated = small_camera();
  const CameraChange change = all_of_a_camera();
  const Pairs pairs = camera_pairs(simulated, change, 16, 1);
  const auto fit = fit_image_pair(pairs.each(), simulated, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(fit->converged);
  expect_within(fit->change, "focal_length", change.focal);
  expect_within(fit->change, "gain", change.electronics);
  expect_within(fit->change, "offset_dn", change.offset_dn);
  expect_within(fit->change, "mount_x_rad", change.turn_rad[0]);
  expect_within(fit->change, "mount_y_rad", change.turn_rad[1]);
  expect_within(fit->change, "mount_z_rad", change.turn_rad[2]);
  EXPECT_EQ(fit->change.find("a2"), nullptr);
  // The first step is off by many sigmas of what is solved for: that is why there are more.
  const int f = fit->change.index_of("focal_length");
  const double step = fit->one_step[std::size_t(f)];
  std::printf("  focal length: one step %.5f, solved %.5f ± %.5f\n", step,
              fit->change.find("focal_length")->value, fit->change.find("focal_length")->sigma);
  EXPECT_GT(std::abs(step - change.focal), 4 * fit->change.find("focal_length")->sigma);
  EXPECT_LT(fit->after.rms(), 0.3 * fit->before.rms());
}

TEST(ImagePair, UncertaintiesHoldOverSeeds) {
  const CameraModel simulated = small_camera();
  const CameraChange change = all_of_a_camera();
  Consistency c({{"focal_length", change.focal},
                 {"gain", change.electronics},
                 {"offset_dn", change.offset_dn},
                 {"mount_x_rad", change.turn_rad[0]},
                 {"mount_y_rad", change.turn_rad[1]},
                 {"mount_z_rad", change.turn_rad[2]}});
  for (std::uint64_t seed = 0; seed < 16; ++seed) {
    const Pairs pairs = camera_pairs(simulated, change, 8, 100 + seed);
    const auto fit = fit_image_pair(pairs.each(), simulated, {});
    ASSERT_TRUE(fit) << fit.error().text();
    c.add(fit->change);
  }
  c.expect_good();
}

/// Pictures that are carried over by nothing must not be rounded back to what they were.
TEST(ImagePair, WithoutAChangeGainAndOffsetAreWithinTheirUncertainties) {
  const CameraModel simulated = small_camera();
  Consistency c({{"focal_length", 0},
                 {"gain", 0},
                 {"offset_dn", 0},
                 {"mount_x_rad", 0},
                 {"mount_y_rad", 0},
                 {"mount_z_rad", 0}});
  int passes = 0;
  for (std::uint64_t seed = 0; seed < 16; ++seed) {
    const Pairs pairs = camera_pairs(simulated, {}, 8, 300 + seed);
    const auto fit = fit_image_pair(pairs.each(), simulated, {});
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_TRUE(fit->converged) << seed;
    passes += fit->passes;
    c.add(fit->change);
  }
  c.expect_good();
  std::printf("  %d passes\n", passes);
  EXPECT_LT(passes, 16 * 12);
}

TEST(ImagePair, PicturesOfAnotherShapeAreLeftOut) {
  const CameraModel simulated = small_camera();
  CameraChange change;
  change.turn_rad = {0, 0.5 * kDegree, 0};
  Pairs pairs = camera_pairs(simulated, change, 16, 3);
  CameraModel smaller = simulated;
  smaller.width_px /= 2, smaller.height_px /= 2;
  Pairs small = camera_pairs(smaller, change, 2, 3);
  pairs.simulated[4] = std::move(small.simulated[0]);  // of the simulated side alone, then of both
  pairs.real[9] = std::move(small.real[1]), pairs.simulated[9] = std::move(small.simulated[1]);
  const auto fit = fit_image_pair(pairs.each(), simulated, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->pairs, 14U);
  EXPECT_EQ(fit->unlike, 2U);
  expect_within(fit->change, "mount_y_rad", change.turn_rad[1]);
}

TEST(ImagePair, NoiseSaysWhetherLightOrElectronicsHaveChanged) {
  const CameraModel simulated = small_camera();
  CameraChange light, electronics;
  light.light = electronics.electronics = 0.1;
  using Gain = ImageNoiseFit::Gain;
  for (const auto& [change, expected] : {std::pair{light, Gain::light}, {electronics, Gain::electronics}}) {
    const Pairs pairs = camera_pairs(simulated, change, 40, 7);
    const auto fit = fit_image_pair(pairs.each(), simulated, {});
    ASSERT_TRUE(fit) << fit.error().text();
    const auto noise = fit_image_noise(*fit, simulated, fit->change.find("gain")->sigma);
    EXPECT_EQ(noise.gain, expected) << noise.chi2_light << " " << noise.chi2_electronics;
    EXPECT_NEAR(noise.read_noise_e, 12, 4 * noise.sigma_e);
  }
}

TEST(ImagePair, DoubledReadNoiseIsFoundAtAChangedMount) {
  const CameraModel simulated = small_camera();
  CameraChange change;
  change.read_noise = 2, change.turn_rad = {0, 0.5 * kDegree, 0};
  const Pairs pairs = camera_pairs(simulated, change, 16, 3);
  const auto fit = fit_image_pair(pairs.each(), simulated, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const auto noise = fit_image_noise(*fit, simulated, fit->change.find("gain")->sigma);
  EXPECT_NEAR(noise.read_noise_e, 24, 4 * noise.sigma_e);
  EXPECT_LT(noise.sigma_e, 2);
}

TEST(ImagePair, VignettingIsSolvedForWhereItHasChangedAndDirtIsNamed) {
  const CameraModel simulated = small_camera();
  CameraChange change;
  change.a2 = -0.15, change.dirt = 0.05;
  const Pairs pairs = camera_pairs(simulated, change, 10, 4);
  const auto fit = fit_image_pair(pairs.each(), simulated, {});
  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter* a2 = fit->change.find("a2");
  ASSERT_NE(a2, nullptr);
  EXPECT_NEAR(a2->value, -0.15, 0.03);  // dirt is in it
  ASSERT_FALSE(fit->tiles.empty());
  EXPECT_LT(fit->tiles.front().change, -0.03);
}

TEST(ImagePair, APrincipalPointThatHasMovedIsSolvedForWhereTheMountStays) {
  const CameraModel simulated = small_camera();
  CameraChange change;
  change.cx_px = 1.5;
  const Pairs pairs = camera_pairs(simulated, change, 8, 5);
  ImagePairOptions options;
  options.mount = false, options.principal_point = true;
  const auto fit = fit_image_pair(pairs.each(), simulated, options);
  ASSERT_TRUE(fit) << fit.error().text();
  expect_within(fit->change, "cx_px", 1.5);
  expect_within(fit->change, "cy_px", 0);
  EXPECT_EQ(fit->change.find("mount_y_rad"), nullptr);
}

TEST(ImagePair, AWhiteWallLeavesGeometryOpen) {
  CameraModel simulated = small_camera();
  Pairs pairs;
  Random random(1);
  for (int i = 0; i < 10; ++i)
    for (auto* side : {&pairs.real, &pairs.simulated}) {
      std::vector<std::uint16_t> pixels(std::size_t(simulated.width_px) * std::size_t(simulated.height_px),
                                        1500);
      Sample s;
      ImageInfo info;
      info.format = PixelFormat::mono12;
      info.width_px = std::uint32_t(simulated.width_px), info.height_px = std::uint32_t(simulated.height_px);
      s.info = info;
      put(s, pixels);
      side->push_back(std::move(s));
    }
  const auto fit = fit_image_pair(pairs.each(), simulated, {});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->change.find("focal_length"), nullptr);
  EXPECT_FALSE(fit->change.not_identifiable.empty());
}

// ---- LiDARs

CloudPairOptions scan_options(const ScanShape& shape) {
  CloudPairOptions o;
  o.rings = shape.rings, o.points = 20000, o.sigma_m = 0.015;
  return o;
}
ScanChange all_of_a_scanner() {
  ScanChange c;
  c.bias_m = 0.02, c.turn_rad = {0, 0, 0.5 * kDegree}, c.move_m = {0.03, -0.02, 0}, c.noise = 2,
  c.remission = 0.1;
  return c;
}

TEST(CloudPair, UncertaintiesOfAScannerHoldOverSeeds) {
  const ScanChange change = all_of_a_scanner();
  Consistency c({{"range_bias_m", change.bias_m},
                 {"range_scale", 0},
                 {"mount_z_rad", change.turn_rad[2]},
                 {"mount_move_x_m", change.move_m[0]},
                 {"mount_move_y_m", change.move_m[1]},
                 {"remission_gain", change.remission}});
  double one_step = 0, solved = 0, factor = 0;
  constexpr int kSeeds = 16;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    const Pairs pairs = cloud_pairs({}, change, 30, 500 + seed);
    const auto fit = fit_cloud_pair(pairs.each(), scan_options({}));
    ASSERT_TRUE(fit) << fit.error().text();
    c.add(fit->change);
    const int z = fit->change.index_of("mount_z_rad");
    one_step += fit->one_step[std::size_t(z)] / kSeeds / change.turn_rad[2];
    solved += fit->change.parameters[std::size_t(z)].value / kSeeds / change.turn_rad[2];
    const NoiseFactor noise = noise_factor(fit->noise);
    factor += noise.factor / kSeeds;
    EXPECT_NEAR(noise.factor, 2, 4.5 * noise.sigma);
  }
  std::printf("  turn about z over the truth: one step %.3f, solved %.3f; noise factor %.3f\n", one_step,
              solved, factor);
  EXPECT_NEAR(solved, 1, 0.02);
  c.expect_good();
}

TEST(CloudPair, ManyRingsSayAllOfAMountAndWhichBeamIsOff) {
  const ScanShape shape{8, 360, 1 * kDegree, -180 * kDegree};
  ScanChange change;
  change.turn_rad = {0.5 * kDegree, -0.3 * kDegree, 0.4 * kDegree}, change.move_m = {0.03, 0.02, 0};
  change.bias_m = 0.02, change.beam_m = 0.04;
  const Pairs pairs = cloud_pairs(shape, change, 12, 9);
  const auto fit = fit_cloud_pair(pairs.each(), scan_options(shape));
  ASSERT_TRUE(fit) << fit.error().text();
  expect_within(fit->change, "mount_x_rad", change.turn_rad[0]);
  expect_within(fit->change, "mount_y_rad", change.turn_rad[1]);
  expect_within(fit->change, "mount_z_rad", change.turn_rad[2]);
  expect_within(fit->change, "mount_move_x_m", change.move_m[0]);
  expect_within(fit->change, "mount_move_y_m", change.move_m[1]);
  // No beam meets floor or ceiling.
  EXPECT_EQ(fit->change.find("mount_move_z_m"), nullptr);
  EXPECT_EQ(fit->change.not_identifiable.size(), 1u);
  // Beams sum to nothing: what one has more, the bias has an eighth of.
  expect_within(fit->change, "beam_bias_m[3]", 0.04 * 7 / 8);
  expect_within(fit->change, "range_bias_m", 0.02 + 0.04 / 8);
}

/// The lowest ring meets the floor beside walls, and no ring is below it. A normal from it and the wall's
/// ring above it would be the same wrong one on both sides of all scans, which no scatter tells of: rolls
/// came out 5 % too large, and moves along z by ten standard uncertainties off.
TEST(CloudPair, AFloorBesideAWallIsNotTakenForOneSurface) {
  const ScanShape shape{16, 360, 1 * kDegree, -180 * kDegree};
  ScanChange change;
  change.turn_rad = {0.5 * kDegree, -0.3 * kDegree, 0}, change.bias_m = 0.02;
  Consistency c({{"range_bias_m", change.bias_m},
                 {"mount_x_rad", change.turn_rad[0]},
                 {"mount_y_rad", change.turn_rad[1]},
                 {"mount_z_rad", 0}});
  for (std::uint64_t seed = 0; seed < 12; ++seed) {
    const Pairs pairs = cloud_pairs(shape, change, 4, 700 + seed, 0.008, true);
    CloudPairOptions options = scan_options(shape);
    options.sigma_m = 0.008;
    const auto fit = fit_cloud_pair(pairs.each(), options);
    ASSERT_TRUE(fit) << fit.error().text();
    c.add(fit->change);
    if (const Parameter* z = fit->change.find("mount_move_z_m")) {
      EXPECT_LT(std::abs(z->value), 4 * z->sigma) << seed;
    }
  }
  c.expect_good();
}

/// One beam is off, by as much as the noise or by many times that, beside a mount that has changed: all beams
/// come out within their sigmas. A beam that is off by 0.2 m is an outlier with all its points, and the
/// device's own surfaces have a step there.
TEST(CloudPair, UncertaintiesOfBeamsHoldHoweverFarOneIsOff) {
  const ScanShape shape{8, 360, 1 * kDegree, -180 * kDegree};
  double squares = 0;
  int numbers = 0;
  for (const double off_m : {0.02, -0.1, 0.2, 0.3})
    for (const std::uint32_t beam : {0U, 3U}) {
      ScanChange change;
      change.turn_rad = {0.3 * kDegree, -0.2 * kDegree, 0.4 * kDegree};
      change.bias_m = 0.02, change.beam_m = off_m, change.beam = beam;
      const Pairs pairs = cloud_pairs(shape, change, 12, std::uint64_t(1000 + std::abs(off_m) * 100) + beam);
      const auto fit = fit_cloud_pair(pairs.each(), scan_options(shape));
      ASSERT_TRUE(fit) << fit.error().text();
      EXPECT_TRUE(fit->converged) << off_m << ", beam " << beam;
      Eigen::VectorXd error(shape.rings);
      Eigen::MatrixXd covariance(shape.rings, shape.rings);
      std::vector<int> at;
      for (std::uint32_t k = 0; k < shape.rings; ++k) {
        at.push_back(fit->change.index_of("beam_bias_m[" + std::to_string(k) + "]"));
        ASSERT_GE(at.back(), 0) << off_m << ", beam " << k;
        const Parameter& p = fit->change.parameters[std::size_t(at.back())];
        // Beams sum to nothing: what one has more, the bias has an eighth of.
        error[k] = p.value - ((k == beam ? off_m : 0) - off_m / shape.rings);
        EXPECT_LT(std::abs(error[k]), (k == beam ? 3 : 4) * p.sigma) << off_m << ", beam " << k;
        if (k == beam)
          std::printf("  beam %u off by %+.2f m: error %+.5f m, %+.1f sigmas, %d passes\n", beam, off_m,
                      error[k], error[k] / p.sigma, fit->passes);
      }
      expect_within(fit->change, "range_bias_m", 0.02 + off_m / shape.rings);
      for (std::uint32_t i = 0; i < shape.rings; ++i)
        for (std::uint32_t k = 0; k < shape.rings; ++k)
          covariance(i, k) = fit->change.covariance(at[i], at[k]);
      // One less than beams: their sum is known.
      const Eigen::Index n = shape.rings - 1;
      squares += error.head(n).dot(covariance.topLeftCorner(n, n).ldlt().solve(error.head(n)));
      numbers += int(n);
    }
  std::printf("  chi-squared of the beams %.1f of %d\n", squares, numbers);
  EXPECT_LT(squares, chi_squared_quantile(0.9995, numbers));
  EXPECT_GT(squares, chi_squared_quantile(0.0005, numbers));
}

TEST(CloudPair, NoPairsAreNoAnswer) {
  const Pairs none;
  const auto fit = fit_cloud_pair(none.each(), scan_options({}));
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->pairs, 0u);
  EXPECT_TRUE(fit->change.parameters.empty());
}

// ---- time of flight

Pairs range_pairs(double offset_m, double gain, double more_read_e2, std::size_t count, std::uint64_t seed) {
  constexpr std::size_t kWidth = 64, kHeight = 48;
  constexpr double kKappa = 0.6, kBackground = 1e4, kContrast = 0.5, kPattern_m = 0.003;
  Random random(seed);
  std::array<std::vector<double>, 2> pattern;
  for (auto& p : pattern)
    for (std::size_t i = 0; i < kWidth * kHeight; ++i) p.push_back(kPattern_m * random.normal());
  Pairs pairs;
  for (std::size_t i = 0; i < count; ++i)
    for (const bool device : {true, false}) {
      std::vector<float> planes(2 * kWidth * kHeight);
      for (std::size_t k = 0; k < kWidth * kHeight; ++k) {
        const double x = double(k % kWidth) / kWidth, y = double(k / kWidth) / kHeight;
        const double range = 1.5 + 0.8 * x + 0.3 * std::sin(4 * y);
        const double a =
            (20000 + 100000 * (0.5 + 0.5 * std::sin(9 * x + 5 * y))) / (range * range) * (device ? gain : 1);
        const double sigma =
            std::sqrt(kKappa * (2 * a / kContrast + kBackground + (device ? more_read_e2 : 0))) / a;
        planes[k] =
            float(range + (device ? offset_m : 0) + pattern[device][k] + sigma * random.quick_normal());
        planes[kWidth * kHeight + k] = float(a + std::sqrt(a) * random.quick_normal());
      }
      Sample s;
      s.info = RangeImageInfo{kWidth, kHeight};
      put(s, planes);
      (device ? pairs.real : pairs.simulated).push_back(std::move(s));
    }
  return pairs;
}

TEST(RangePair, UncertaintiesHoldOverSeedsBesideAFixedPattern) {
  Consistency c({{"range_offset_m", 0.02}, {"amplitude_gain", 0.1}});
  double squares = 0;
  constexpr int kSeeds = 24;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    const Pairs pairs = range_pairs(0.02, 1.1, 3e4, 20, 900 + seed);
    const auto fit = fit_range_pair(pairs.each(), {});
    ASSERT_TRUE(fit) << fit.error().text();
    FitResult change = fit->change;
    c.add(change);
    const RangeNoiseFit noise = fit_range_noise(*fit, 0.5);
    ASSERT_TRUE(noise.solved);
    squares += std::pow((noise.more_e2 - 3e4) / noise.sigma_e2, 2);
  }
  std::printf("  read noise: chi-squared %.1f of %d\n", squares, kSeeds);
  EXPECT_LT(squares, chi_squared_quantile(0.9995, kSeeds));
  EXPECT_GT(squares, chi_squared_quantile(0.0005, kSeeds));
  c.expect_good();
}

// ---- numbers

ValueSeries numbers(double bias, double scale, double delay_s, double noise, std::uint64_t seed) {
  ValueSeries s;
  s.name = "position", s.unit = "rad";
  Random random(seed);
  for (int i = 0; i < 3000; ++i) {
    const double t = 0.01 * i;
    const auto truth = [](double at) { return std::sin(1.7 * at) + 0.4 * std::sin(4.1 * at + 1); };
    s.t_s.push_back(t);
    s.simulated.push_back(truth(t) + 0.005 * random.normal());
    s.real.push_back(bias + (1 + scale) * truth(t - delay_s) + 0.005 * noise * random.normal());
  }
  return s;
}

TEST(ValuePair, ADelayOfManySamplesIsSolvedForWithTheRestOverSeeds) {
  double squares = 0;
  constexpr int kSeeds = 60;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    const auto fit = fit_value_pair(numbers(0.02, 0.01, 0.12, 2, 40 + seed));
    ASSERT_TRUE(fit) << fit.error().text();
    const double z[3] = {(fit->bias - 0.02) / fit->bias_sigma, (fit->scale - 0.01) / fit->scale_sigma,
                         (fit->delay_s - 0.12) / fit->delay_sigma_s};
    for (const double x : z) squares += x * x;
    EXPECT_NEAR(fit->noise_ratio, 2, 6 * fit->noise_ratio_sigma);
    if (seed == 0)
      std::printf("  delay: one step %.4f, solved %.4f ± %.4f s in %d passes\n", fit->one_step_delay_s,
                  fit->delay_s, fit->delay_sigma_s, fit->passes);
  }
  std::printf("  chi-squared %.1f of %d\n", squares, 3 * kSeeds);
  EXPECT_LT(squares, chi_squared_quantile(0.9995, 3 * kSeeds));
  EXPECT_GT(squares, chi_squared_quantile(0.0005, 3 * kSeeds));
}

TEST(ValuePair, WhatStandsStillHasABiasAlone) {
  ValueSeries s = numbers(0, 0, 0, 1, 1);
  Random random(3);
  for (std::size_t i = 0; i < s.t_s.size(); ++i) s.simulated[i] = 5, s.real[i] = 5.1 + 0.01 * random.normal();
  const auto fit = fit_value_pair(s);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_NEAR(fit->bias, 0.1, 4 * fit->bias_sigma);
  EXPECT_TRUE(std::isinf(fit->delay_sigma_s));
  s.t_s.resize(20), s.real.resize(20), s.simulated.resize(20);
  EXPECT_FALSE(fit_value_pair(s));
}

}  // namespace
}  // namespace rigor::calibration

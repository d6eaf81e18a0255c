// Ranges, amplitudes, wrapping, limits and truth of the simulator against closed forms.
#include <algorithm>
#include <cstring>

#include "sensor-hal/models/tof/tof_yaml.h"
#include "tests/sim/sensors/tof/tof_fixture.h"

namespace rigor::test {
namespace {

using models::TofModel;

TEST(TofSimulator, IdealMeasuresPlaneAndSphereExactly) {
  TofBench b;
  b.wall(4.0);
  b.engine->add(Sphere{.centre = {0.2, -0.1, 2.5}, .radius_m = 0.5});
  const TofModel m = perfect(41, 31, 40);
  const auto camera = b.camera(m, true);
  const TofPicture p = b.shoot(*camera);
  int on_sphere = 0;
  for (int v = 0; v < 31; ++v)
    for (int u = 0; u < 41; ++u) {
      const Eigen::Vector3d d =
          Eigen::Vector3d((u - m.cx_px) / m.fx_px, (v - m.cy_px) / m.fy_px, 1).normalized();
      const Eigen::Vector3d c(0.2, -0.1, 2.5);
      const double along = c.dot(d), q = 0.25 - (c - along * d).squaredNorm();
      const double expected = q > 0 ? along - std::sqrt(q) : 4 / d.z();
      on_sphere += q > 0;
      ASSERT_NEAR(p.range_m[size_t(v * 41 + u)], expected, 3e-6 * (1 + (q > 0 ? 0.1 / std::sqrt(q) : 0)));
      ASSERT_EQ(p.status[size_t(v * 41 + u)], TofPixelStatus::valid);
    }
  EXPECT_GT(on_sphere, 100);
}

TEST(TofSimulator, WithoutErrorsTheTapsGiveTheIdealsRangeAndAmplitude) {
  TofBench b;
  b.wall(3.2);
  TofModel m = perfect(31, 21, 30);
  m.optics.cos4_weight = 1;
  m.illumination.cosine_exponent = 2;
  const TofPicture ideal = b.shoot(*b.camera(m, true)), p = b.shoot(m, 0, true);
  ASSERT_EQ(p.taps.size(), 4 * p.range_m.size());
  for (int v = 0; v < 21; ++v)
    for (int u = 0; u < 31; ++u) {
      const std::size_t i = size_t(v * 31 + u);
      ASSERT_NEAR(p.range_m[i], ideal.range_m[i], 3e-6);
      const double c = axis_cosine(m, u, v), range = 3.2 / c;
      // Lambert's cosine, the lens's cos^4 and the light's cos^2.
      const double e = m.active_electrons(range, 0.8) * std::pow(c, 7);
      ASSERT_NEAR(p.amplitude[i] / (e * 0.25), 1, 3e-6);
      ASSERT_NEAR(ideal.amplitude[i] / (e * 0.25), 1, 3e-6);
      for (std::size_t k = 0; k < 4; ++k)
        ASSERT_NEAR(p.taps[4 * i + k],
                    e / 2 * (1 + 0.5 * std::cos(2 * kPi * turns_of(range, 30e6) + double(k) * kPi / 2)),
                    1e-5 * e);
    }
}

TEST(TofSimulator, PixelsLookWhereTheLensPutsThem) {
  TofBench b;
  b.wall(1.0);
  TofModel m = perfect(64, 48, 50);
  m.lens = {.k1 = -0.3, .k2 = 0.08, .p1 = 0.01, .p2 = -0.02, .k3 = 0.01};
  for (const bool ideal : {true, false}) {
    const TofPicture p = b.shoot(*b.camera(m, ideal));
    for (int v = 0; v < 48; ++v)
      for (int u = 0; u < 64; ++u)
        ASSERT_NEAR(p.range_m[size_t(v * 64 + u)], 1 / axis_cosine(m, u, v), 2e-6) << u << ' ' << v;
  }
  // A lens that folds within the picture: no ray comes to its corners.
  m.lens = {.k1 = -0.6};
  const TofPicture p = b.shoot(m);
  EXPECT_TRUE(std::isnan(p.range_m[0]));
  EXPECT_EQ(p.status[0], TofPixelStatus::no_return);
  EXPECT_FALSE(unproject(m.camera(), {0, 0}));
  EXPECT_NEAR(p.range_m[24 * 64 + 32], 1, 1e-3);
}

TEST(TofSimulator, AllSamplesLieInTheirPixel) {
  // A wall in stripes one pixel wide, alternately near and far: each pixel sees its own stripe alone.
  TofBench b;
  const int width = 24;
  TofModel m = perfect(width, 6, 40);
  for (int u = 0; u < width; ++u) {
    const double z = u % 2 ? 2.0 : 2.5, x = (u - m.cx_px) / m.fx_px * z;
    b.engine->add(Rectangle{.centre = {x, 0, z}, .half_u = {z / m.fx_px / 2, 0, 0}, .half_v = {0, 1, 0}});
  }
  for (const int samples : {1, 4, 9, 16}) {
    m.sampling.samples = samples;
    const TofPicture p = b.shoot(m);
    for (int v = 0; v < 6; ++v)
      for (int u = 0; u < width; ++u) {
        const double z = u % 2 ? 2.0 : 2.5;
        // The mean over the pixel is nearly the centre's.
        ASSERT_NEAR(p.range_m[size_t(v * width + u)], z / axis_cosine(m, u, v), 0.012) << samples;
      }
  }
}

TEST(TofSimulator, RangesWrapAtTheUnambiguousRange) {
  const TofModel m = perfect(1, 1, 100);
  const double unambiguous = m.unambiguous_range_m();
  for (const double range : {0.3, 4.9, 5.2, 7.7, 13.0}) {
    TofBench b;
    b.wall(range);
    EXPECT_NEAR(b.shoot(m).range_m[0], range - unambiguous * std::floor(range / unambiguous), 1e-5);
  }
}

TEST(TofSimulator, ATargetOnTheWrapReadsNearZeroOrNearTheEnd) {
  TofBench b;
  b.wall(3.0);
  TofModel m = perfect(64, 64, 1e6);
  m.modulation.frequencies_hz = {kLightSpeed_mps / 6};
  m.pixel.trembling = true;
  m.illumination.radiant_intensity_w_per_sr = 0.5;
  const TofPicture p = b.shoot(m);
  const double sigma =
      models::TofMath<double>::tof_range_sigma(1 / 3.0, m.active_electrons(3, 0.8) / 2, 0, 0, 0.5);
  int low = 0;
  std::vector<double> off;
  for (const float r : p.range_m) {
    ASSERT_GE(r, 0.0F);
    ASSERT_LE(r, 3.0F);
    low += r < 1.5F;
    off.push_back(r < 1.5F ? double(r) : double(r) - 3);
  }
  EXPECT_NEAR(low / 4096.0, 0.5, 4 * 0.5 / 64);  // half of them on each side: binomial
  const Spread s = spread_of(off);
  EXPECT_NEAR(s.sigma / sigma, 1, chi_bound(4096) + 0.01);
  EXPECT_NEAR(s.mean, 0, 4 * sigma / 64);
}

TEST(TofSimulator, SeveralFrequenciesReachTheirCommonRangeAndWrapThere) {
  TofModel m = perfect(8, 8, 1e5);
  m.pixel.trembling = true;
  m.illumination.radiant_intensity_w_per_sr = 200;
  for (const auto& frequencies : {std::vector{80e6, 100e6}, std::vector{20e6, 100e6, 90e6}}) {
    m.modulation.frequencies_hz = frequencies;
    const double limit = m.unambiguous_range_m();
    EXPECT_NEAR(limit, frequencies.size() == 2 ? 7.4948 : 14.9896, 1e-3);
    for (double range = 0.31; range < 2 * limit - 0.3; range += 0.377) {
      if (std::abs(range - limit) < 0.1) continue;
      TofBench b;
      b.wall(range);
      const TofPicture p = b.shoot(m);
      for (const float r : p.range_m) ASSERT_NEAR(r, range < limit ? range : range - limit, 0.03) << range;
    }
  }
}

TEST(TofSimulator, FrequenciesThatDisagreeHaveNoReturnWhereThatIsAskedFor) {
  // Half of the pixel at 1.0 m, half at 2.2 m: the two frequencies' mixed phases fit no one range.
  TofBench b;
  b.wall(2.2, 0.9F);
  b.engine->add(Rectangle{.centre = {-5, 0, 1}, .half_u = {5, 0, 0}, .half_v = {0, 5, 0}},
                {.reflectance = grey(0.18F)});
  TofModel m = perfect(5, 1, 100);
  m.modulation.frequencies_hz = {80e6, 100e6};
  m.sampling.samples = 4;
  const TofPicture all = b.shoot(m);
  EXPECT_FALSE(std::isnan(all.range_m[2]));
  m.modulation.unwrap_tolerance_m = 0.02;
  const TofPicture some = b.shoot(m);
  EXPECT_EQ(some.status[2], TofPixelStatus::ambiguous);
  EXPECT_TRUE(std::isnan(some.range_m[2]));
  for (const std::size_t u : {0u, 1u, 3u, 4u}) EXPECT_EQ(some.status[u], TofPixelStatus::valid);
}

TEST(TofSimulator, EmptyWorldHasNoReturn) {
  TofBench b;
  TofModel m = perfect(16, 12, 20);
  m.pixel.trembling = true;
  m.pixel.read_noise_e = 20;
  m.sampling.samples = 4;
  const TofPicture p = b.shoot(m);
  for (std::size_t i = 0; i < p.range_m.size(); ++i) {
    ASSERT_TRUE(std::isnan(p.range_m[i]));
    ASSERT_EQ(p.status[i], TofPixelStatus::no_return);
  }
  const TofPicture ideal = b.shoot(*b.camera(m, true));
  EXPECT_TRUE(std::isnan(ideal.range_m[0]));
}

TEST(TofSimulator, RangeLimitsAndAmplitudeThresholdHaveTheirReasons) {
  TofModel m = perfect(1, 1, 100);
  m.limits = {.min_range_m = 0.5, .max_range_m = 3, .min_amplitude_e = 0};
  const auto status_at = [&](double range_m) {
    TofBench b;
    b.wall(range_m);
    return b.shoot(m).status[0];
  };
  EXPECT_EQ(status_at(0.49), TofPixelStatus::out_of_range);
  EXPECT_EQ(status_at(0.51), TofPixelStatus::valid);
  EXPECT_EQ(status_at(2.99), TofPixelStatus::valid);
  EXPECT_EQ(status_at(3.01), TofPixelStatus::out_of_range);
  m.limits.min_amplitude_e = m.active_electrons(2, 0.8) * m.modulation.contrast / 2;
  EXPECT_EQ(status_at(1.99), TofPixelStatus::valid);
  EXPECT_EQ(status_at(2.01), TofPixelStatus::dark);
}

TEST(TofSimulator, FarFromTheOriginIsAsAtIt) {
  TofModel m = perfect(32, 24, 30);
  m.pixel.trembling = true;
  m.sampling.samples = 4;
  const auto shot_at = [&](const Eigen::Vector3d& where) {
    TofBench b;
    b.pose = still(where);
    b.engine->add(Plane{.point = where + Eigen::Vector3d(0, 0, 3), .normal = {0.3, 0, -1}});
    b.engine->add(Sphere{.centre = where + Eigen::Vector3d(0, 0, 2), .radius_m = 0.4});
    return b.shoot(m);
  };
  const TofPicture here = shot_at({0, 0, 0}), there = shot_at({1e5, -1e5, 2e3});
  for (std::size_t i = 0; i < here.range_m.size(); ++i) {
    // One electron more or less in a tap where the mean differs in its last bit.
    const double one = kLightSpeed_mps / (4 * kPi * 30e6) * 0.71 / double(here.amplitude[i]);
    ASSERT_NEAR(here.range_m[i], there.range_m[i], 2 * one + 1e-6);
  }
}

TEST(TofSimulator, TruthIsThatOfThePixelsCentres) {
  TofBench b;
  b.engine->add(Plane{.point = {0, 0, 3}, .normal = {0, 0, -1}}, {.node = {7}});
  b.engine->add(Sphere{.centre = {0, 0, 2}, .radius_m = 0.3}, {.node = {9}});
  b.engine->add(Sphere{.centre = {0.8, 0, 2}, .radius_m = 0.2}, {.node = {11}});
  b.world.still.types = {{{7}, "Wall"}, {{9}, "Ball"}, {{11}, "Ball"}};
  TofModel m = perfect(33, 25, 24);
  m.sampling.samples = 4;
  b.pose = [](BenchTime) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()).toRotationMatrix();
    return pose;
  };
  GroundTruth truth;
  const auto camera = b.camera(m);
  (void)b.shoot(*camera, 0, &truth);
  const TofPicture ideal = b.shoot(*b.camera(m, true));
  ASSERT_EQ(truth.width, 33u);
  ASSERT_EQ(truth.height, 25u);
  ASSERT_EQ(truth.range_m.size(), 33u * 25u);
  ASSERT_EQ(truth.class_names.size(), 3u);  // "", Wall, Ball
  int balls = 0;
  for (std::size_t i = 0; i < truth.range_m.size(); ++i) {
    ASSERT_EQ(truth.range_m[i], ideal.range_m[i]);
    const std::string name = truth.class_names[truth.class_index[i]];
    ASSERT_EQ(name, truth.node[i] == 7 ? "Wall" : "Ball");
    balls += name == "Ball";
    if (truth.node[i] == 7) {  // in the sensor's frame: turned back by its own rotation
      ASSERT_NEAR(truth.normal[3 * i], std::sin(0.1), 1e-6);
      ASSERT_NEAR(truth.normal[3 * i + 2], -std::cos(0.1), 1e-6);
    }
  }
  EXPECT_GT(balls, 20);
}

TEST(TofSimulator, RefusesAModelThatCannotBe) {
  TofModel m = perfect(4, 4, 10);
  m.modulation.contrast = 2;
  const auto made = TofSimulator::create({.name = "front", .model = m}, std::make_shared<AnalyticEngine>());
  ASSERT_FALSE(made);
  EXPECT_EQ(made.error().code, ErrorCode::bad_input);
  EXPECT_NE(made.error().text().find("front"), std::string::npos);
  EXPECT_FALSE(TofSimulator::create({.name = "front", .model = perfect(4, 4, 10)}, nullptr));
}

}  // namespace
}  // namespace rigor::test

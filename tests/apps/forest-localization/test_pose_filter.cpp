// Whether the filter is as sure as it says: normalised errors over seeds 0 to 99, against a truth that is
// drawn here and moves by its own code.
#include "apps/forest-localization/pose_filter.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cstdio>

#include "tests/apps/forest-localization/disc_forest.h"

namespace rigor::forest {
namespace {

constexpr int kSeeds = 100;

/// A truth with everything that the filter believes of it, drawn.
class Truth {
 public:
  Truth(const PoseFilterConfig& config, unsigned seed, std::vector<Stem> mapped)
      : c_(config), rng_(seed * 31 + 5), stems(std::move(mapped)) {
    for (Stem& s : stems) {
      s.x_m += c_.map_sigma_m * normal();
      s.y_m += c_.map_sigma_m * normal();
      s.radius_m += c_.map_radius_sigma_m * normal();
    }
    scale = 1 + c_.way_scale_sigma * normal();
    turn_scale = 1 + c_.turn_scale_sigma * normal();
    bias = c_.gyro_bias_sigma_radps * normal();
  }
  double normal() { return normal_(rng_); }

  /// Told `way` and `turn`, the body does something else; so much for it, with what a gyro would tell.
  MotionIncrement move(double way_m, double turn_rad, double dt_s, bool gyro) {
    const double length = std::abs(way_m);
    const double yaw_noise = std::sqrt(c_.yaw_rad_per_sqrt_m * c_.yaw_rad_per_sqrt_m * length +
                                       c_.yaw_per_sqrt_rad * c_.yaw_per_sqrt_rad * std::abs(turn_rad)) *
                             normal();
    const double turn = turn_scale * turn_rad + yaw_noise;
    const double along = scale * way_m + c_.along_per_sqrt_m * std::sqrt(length) * normal();
    const double across =
        std::hypot(c_.across_per_sqrt_m * std::sqrt(length), c_.across_per_rad * turn) * normal();
    const double heading = pose.z() + turn / 2;
    pose.x() += along * std::cos(heading) - across * std::sin(heading);
    pose.y() += along * std::sin(heading) + across * std::cos(heading);
    pose.z() += turn;
    MotionIncrement m{dt_s, way_m, turn_rad, {}, 0, 0};
    if (gyro)
      m.gyro_turn_rad = turn + bias * dt_s + c_.gyro_noise_rad_per_sqrt_s * std::sqrt(dt_s) * normal();
    const double keep = std::exp(-length / c_.scale_length_m),
                 keep_bias = std::exp(-dt_s / c_.gyro_bias_time_s);
    scale = 1 + (scale - 1) * keep + c_.way_scale_sigma * std::sqrt(1 - keep * keep) * normal();
    turn_scale = 1 + (turn_scale - 1) * keep + c_.turn_scale_sigma * std::sqrt(1 - keep * keep) * normal();
    bias = bias * keep_bias + c_.gyro_bias_sigma_radps * std::sqrt(1 - keep_bias * keep_bias) * normal();
    return m;
  }
  /// What a detector says of stem `i`: depth and radius of a circle seen from one side go together.
  StemObservation observe(std::size_t i, double along_m = 0.012, double across_m = 0.006,
                          double radius_m = 0.01) {
    const Stem& s = stems[i];
    const double c = std::cos(pose.z()), n = std::sin(pose.z());
    const double dx = s.x_m - pose.x(), dy = s.y_m - pose.y();
    const double x = c * dx + n * dy, y = -n * dx + c * dy, d = std::hypot(x, y);
    Eigen::Matrix3d P;  // along, across, radius
    P << along_m * along_m, 0, 0.8 * along_m * radius_m, 0, across_m * across_m, 0, 0.8 * along_m * radius_m,
        0, radius_m * radius_m;
    Eigen::Matrix3d R;
    R << x / d, -y / d, 0, y / d, x / d, 0, 0, 0, 1;
    P = (R * P * R.transpose()).eval();
    const Eigen::Vector3d noise = P.llt().matrixL() * Eigen::Vector3d(normal(), normal(), normal());
    StemObservation o;
    o.x_m = x + noise.x(), o.y_m = y + noise.y(), o.radius_m = s.radius_m + noise.z();
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) o.covariance[a][b] = P(a, b);
    return o;
  }
  [[nodiscard]] double range(std::size_t i) const {
    return std::hypot(stems[i].x_m - pose.x(), stems[i].y_m - pose.y());
  }

 private:
  PoseFilterConfig c_;
  std::mt19937 rng_;
  std::normal_distribution<double> normal_{0, 1};

 public:
  std::vector<Stem> stems;
  Eigen::Vector3d pose = Eigen::Vector3d::Zero();
  double scale = 1, turn_scale = 1, bias = 0;
};

struct Consistency {
  double pose = 0, all = 0;
  int inside = 0, of = 0;  ///< single values within their 95 % intervals
};
void add(Consistency& c, const PoseFilter& filter, const Truth& truth) {
  PoseFilter::State e;
  e << filter.state().head<3>() - truth.pose, filter.state()[3] - truth.scale,
      filter.state()[4] - truth.turn_scale, filter.state()[5] - truth.bias;
  e[2] = wrapped_rad(e[2]);
  const auto& P = filter.covariance();
  c.pose += e.head<3>().dot(P.topLeftCorner<3, 3>().inverse() * e.head<3>());
  c.all += e.dot(P.inverse() * e);
  for (int i = 0; i < 6; ++i, ++c.of) c.inside += std::abs(e[i]) < 1.959964 * std::sqrt(P(i, i)) ? 1 : 0;
}
void judge(const char* what, const Consistency& c, int seeds = kSeeds) {
  std::printf("%-34s NEES of the pose %5.1f of %d, of all six %5.1f of %d, %d of %d within 95 %%\n", what,
              c.pose, 3 * seeds, c.all, 6 * seeds, c.inside, c.of);
  EXPECT_GT(c.pose, test::chi_squared_low(3 * seeds)) << what;
  EXPECT_LT(c.pose, test::chi_squared_high(3 * seeds)) << what;
  EXPECT_GT(c.all, test::chi_squared_low(6 * seeds)) << what;
  EXPECT_LT(c.all, test::chi_squared_high(6 * seeds)) << what;
}

/// 60 s in a circle through a forest; `every`: steps of 0.1 s between scans.
Consistency drive(const PoseFilterConfig& config, bool gyro, int every) {
  Consistency c;
  for (unsigned seed = 0; seed < kSeeds; ++seed) {
    auto mapped = test::DiscForest::random(20, 0.05, seed + 1).stems;
    const auto map = StemMap::from(mapped);
    Truth truth(config, seed, mapped);
    PoseFilter filter(config, map->size());
    PoseGaussian start;
    start.covariance = Eigen::Vector3d(0.04, 0.04, 0.0025).asDiagonal();
    start.mean = Eigen::Vector3d(0.2 * truth.normal(), 0.2 * truth.normal(), 0.05 * truth.normal());
    filter.reset(start);
    for (int k = 0; k < 600; ++k) {
      filter.predict(truth.move(0.05, k % 100 < 50 ? 0.03 : -0.01, 0.1, gyro));
      if (k % every != 0) continue;
      std::vector<StemObservation> stems;
      std::vector<StemMatch> matches;
      for (std::uint32_t i = 0; i < map->size() && stems.size() < 30; ++i)
        if (truth.range(i) < 9) {
          matches.push_back({static_cast<std::uint32_t>(stems.size()), i});
          stems.push_back(truth.observe(i));
        }
      (void)filter.update(stems, matches, *map);
    }
    add(c, filter, truth);
  }
  return c;
}

TEST(PoseFilter, IsAsSureAsItIsRight) {
  PoseFilterConfig config;
  judge("odometry, scans at 5 Hz", drive(config, false, 2));
  judge("odometry and gyro, scans at 5 Hz", drive(config, true, 2));
  judge("odometry and gyro, no scan", drive(config, true, 10000));
  judge("odometry, a scan in 10 s", drive(config, false, 100));
}

TEST(PoseFilter, IsNeverSurerThanItsMapHoweverLongItStands) {
  PoseFilterConfig config;
  config.map_radius_sigma_m = 0.002;
  Consistency c;
  double sigma = 0;
  const std::vector<Stem> mapped{{5, 0, 0.2}, {4, 4, 0.2}, {0, 6, 0.2}, {-3, 5, 0.2}, {2, -5, 0.2}};
  const auto map = StemMap::from(mapped);
  const std::vector<StemMatch> matches{{0, 0}, {1, 1}, {2, 2}, {3, 3}, {4, 4}};
  for (unsigned seed = 0; seed < kSeeds; ++seed) {
    Truth truth(config, seed, mapped);
    PoseFilter filter(config, map->size());
    PoseGaussian start;
    start.covariance = Eigen::Vector3d(0.01, 0.01, 0.0025).asDiagonal();
    start.mean = Eigen::Vector3d(0.1 * truth.normal(), 0.1 * truth.normal(), 0.05 * truth.normal());
    filter.reset(start);
    for (int k = 0; k < 400; ++k) {
      filter.predict(truth.move(0, 0, 0.066, false));
      std::vector<StemObservation> stems;
      for (std::size_t i = 0; i < mapped.size(); ++i) stems.push_back(truth.observe(i));
      (void)filter.update(stems, matches, *map);
    }
    sigma = std::sqrt(filter.covariance()(0, 0));
    add(c, filter, truth);
  }
  judge("standing for 400 scans", c);
  // Five stems: the mean of five errors of the map is what remains at the least.
  EXPECT_GT(sigma, config.map_sigma_m / std::sqrt(5.0));
}

TEST(PoseFilter, KnowsThatOneStemTellsNoHeading) {
  PoseFilterConfig config;
  config.map_sigma_m = 1e-3;
  const auto map = StemMap::from({{5, 0, 0.2}});
  Truth truth(config, 1, {{5, 0, 0.2}});
  PoseFilter filter(config, 1);
  PoseGaussian start;
  start.covariance = Eigen::Vector3d(0.09, 0.09, 0.04).asDiagonal();
  filter.reset(start);
  const StemMatch match{0, 0};
  for (int k = 0; k < 200; ++k) {
    const StemObservation o = truth.observe(0, 1e-3, 1e-3, 1e-3);
    (void)filter.update({&o, 1}, {&match, 1}, *map);
  }
  const auto& P = filter.covariance();
  // Turned about the stem by ψ, the base moves across by 5 m·ψ: prior of both, 1/σ² = 1/0.2² + 5²/0.3².
  EXPECT_NEAR(std::sqrt(P(2, 2)), 1 / std::sqrt(1 / 0.04 + 25 / 0.09), 0.002);
  EXPECT_LT(std::sqrt(P(0, 0)), 0.01);  // along the line of sight it is known
  EXPECT_GT(std::sqrt(P(1, 1)), 0.25);  // and across it is not
  EXPECT_LT(P(1, 2) / std::sqrt(P(1, 1) * P(2, 2)), -0.99);
}

TEST(PoseFilter, WeighsDownAStemThatIsNotWhereTheMapHasIt) {
  PoseFilterConfig config;
  config.map_sigma_m = 0.01;
  std::vector<Stem> mapped = test::DiscForest::random(8, 0.05, 3).stems;
  const auto map = StemMap::from(mapped);
  Truth truth(config, 2, mapped);
  truth.stems[0].x_m += 0.3;
  PoseGaussian start;
  start.covariance = Eigen::Vector3d(4e-4, 4e-4, 1e-4).asDiagonal();
  std::vector<StemObservation> stems;
  std::vector<StemMatch> matches;
  for (std::uint32_t i = 0; i < map->size(); ++i)
    matches.push_back({i, i}), stems.push_back(truth.observe(i));
  double error_m[2];
  for (const bool robust : {false, true}) {
    config.huber = robust ? 2.8 : 1e9;
    PoseFilter filter(config, map->size());
    filter.reset(start);
    const UpdateReport report = filter.update(stems, matches, *map);
    EXPECT_EQ(report.down_weighted, robust ? 1u : 0u);
    EXPECT_GT(report.chi_squared, 60);
    error_m[robust] = (filter.state().head<2>() - truth.pose.head<2>()).norm();
  }
  std::printf("a stem 30 cm off: pose %.1f mm off with weights, %.1f without\n", 1e3 * error_m[1],
              1e3 * error_m[0]);
  EXPECT_LT(error_m[1], 0.5 * error_m[0]);
}

TEST(PoseFilter, LearnsTheGyrosBiasByStandingAndTheScalesByDriving) {
  PoseFilterConfig config;
  std::vector<Stem> mapped = test::DiscForest::random(20, 0.05, 3).stems;
  Truth truth(config, 4, mapped);
  truth.bias = 0.03;
  PoseFilter filter(config, mapped.size());
  const double before = std::sqrt(filter.covariance()(5, 5));
  for (int k = 0; k < 100; ++k) filter.predict(truth.move(0, 0, 0.1, true));
  EXPECT_LT(std::sqrt(filter.covariance()(5, 5)), before / 10);
  EXPECT_NEAR(filter.state()[PoseFilter::kGyroBias], truth.bias, 4 * std::sqrt(filter.covariance()(5, 5)));
  // Nothing was driven: the way's scale is as unknown as before.
  EXPECT_NEAR(std::sqrt(filter.covariance()(3, 3)), config.way_scale_sigma, 1e-9);
}

}  // namespace
}  // namespace rigor::forest

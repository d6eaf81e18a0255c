#include "calibration/pair/plane_extrinsics.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

#include "calibration/core/chi_squared.h"

namespace rigor::calibration {
namespace {

Eigen::Isometry3d pose(const Eigen::Vector3d& t, const Eigen::Vector3d& r) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = t;
  if (r.norm() > 0) T.linear() = Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
  return T;
}

/// A camera (x right, y down, z forward) and a LiDAR (x forward) 20 cm beside it.
Eigen::Isometry3d truth() {
  Eigen::Matrix3d axes;
  axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  Eigen::Isometry3d T = pose({0.2, -0.11, 0.05}, {0.02, -0.015, 0.03});
  T.linear() = T.linear() * axes;
  return T;
}

struct World {
  double sigma_m = 0.01;
  double plane_angle_sigma = 0.002, plane_distance_sigma = 0.002;
  int views = 15, rays = 60;
};

/// Boards of 0.8 x 0.6 m at 2 to 5 m, tilted by `tilt` in directions that go around (`turns` of them).
std::vector<PlaneObservation> seen(std::uint32_t seed, const World& w, double tilt = 0.5,
                                   int directions = 7) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<PlaneObservation> views;
  for (int v = 0; v < w.views; ++v) {
    const double phi = 2 * M_PI * (v % directions) / directions;
    const Eigen::Isometry3d board = pose({unit(random) - 0.5, 0.6 * unit(random) - 0.3, 2 + 3 * unit(random)},
                                         tilt * Eigen::Vector3d(std::cos(phi), std::sin(phi), 0));
    PlaneObservation s;
    s.name = "view " + std::to_string(v);
    // What the camera says of the plane is off by its own error.
    s.plane_covariance = Eigen::Vector3d(std::pow(w.plane_angle_sigma, 2), std::pow(w.plane_angle_sigma, 2),
                                         std::pow(w.plane_distance_sigma, 2))
                             .asDiagonal();
    s.T_camera_board =
        board * pose({0, 0, w.plane_distance_sigma * normal(random)},
                     {w.plane_angle_sigma * normal(random), w.plane_angle_sigma * normal(random), 0});
    for (int i = 0; i < w.rays; ++i) {
      const Eigen::Vector3d on = board * Eigen::Vector3d(0.8 * unit(random), 0.6 * unit(random), 0);
      const Eigen::Vector3d p = truth().inverse() * on;
      // Across the plane, as the fit takes it.
      const Eigen::Vector3d n = truth().linear().transpose() * board.linear().col(2);
      s.points_m.push_back(p + w.sigma_m * normal(random) * n);
    }
    views.push_back(s);
  }
  return views;
}

Eigen::Matrix<double, 6, 1> error_of(const PlaneExtrinsics& fit) {
  const Eigen::AngleAxisd turn(truth().linear());
  Eigen::Matrix<double, 6, 1> e;
  const Eigen::Vector3d r = turn.axis() * turn.angle();
  for (int i = 0; i < 3; ++i) {
    e[i] = fit.result.parameters[static_cast<std::size_t>(i)].value - truth().translation()[i];
    e[i + 3] = fit.result.parameters[static_cast<std::size_t>(i + 3)].value - r[i];
  }
  return e;
}

TEST(PlaneExtrinsics, OverAHundredSeedsTheTruthIsWhereTheCovarianceSays) {
  double chi2 = 0;
  int inside = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto fit = fit_plane_extrinsics(seen(seed, {}));
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_TRUE(fit->result.weak.empty());
    const auto e = error_of(*fit);
    chi2 += e.dot(fit->result.covariance.ldlt().solve(e));
    for (int i = 0; i < 6; ++i)
      inside += std::abs(e[i]) <= 1.959964 * fit->result.parameters[static_cast<std::size_t>(i)].sigma;
  }
  // 600 degrees of freedom: the quantiles at 0.0005 and 0.9995 by Wilson and Hilferty.
  const auto quantile = [](double z) {
    const double k = 600, c = 2 / (9 * k);
    return k * std::pow(1 - c + z * std::sqrt(c), 3);
  };
  EXPECT_GT(chi2, quantile(-3.2905));
  EXPECT_LT(chi2, quantile(3.2905));
  // Of 600 intervals 570 are expected; errors of one fit hang together, so the limit is that of 100 fits:
  // 0.95 ± 3.29 sqrt(0.95 · 0.05 / 100) at the worst.
  EXPECT_GT(inside / 600.0, 0.95 - 3.29 * std::sqrt(0.95 * 0.05 / 100));
}

TEST(PlaneExtrinsics, WhatIsWrongWithAllDistancesOfTheCameraIsInTheUncertainty) {
  constexpr int kFits = 10;
  constexpr double kScale = 2e-4;
  World w;
  w.sigma_m = 0.003, w.plane_angle_sigma = w.plane_distance_sigma = 0.0005;
  double chi2 = 0, unaware = 0;
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  for (std::uint32_t seed = 0; seed < kFits; ++seed) {
    auto views = seen(seed, w);
    const double scale = 1 + kScale * normal(random);
    for (auto& v : views) v.T_camera_board.translation() *= scale;
    const auto fit = fit_plane_extrinsics(views, {.camera_scale_sigma = kScale});
    ASSERT_TRUE(fit) << fit.error().text();
    const auto e = error_of(*fit);
    chi2 += e.dot(fit->result.covariance.ldlt().solve(e));
    for (std::size_t i = 0; i < 6; ++i)
      EXPECT_NEAR(fit->result.parameters[i].sigma,
                  std::sqrt(fit->result.covariance(Eigen::Index(i), Eigen::Index(i))), 1e-12);
    if (seed >= 5) continue;
    const auto plain = fit_plane_extrinsics(views);
    ASSERT_TRUE(plain);
    unaware += error_of(*plain).dot(plain->result.covariance.ldlt().solve(error_of(*plain)));
  }
  std::printf("chi-squared %.1f of %d; without the factor %.1f of 30\n", chi2, 6 * kFits, unaware);
  EXPECT_LT(chi2, chi_squared_quantile(0.9995, 6 * kFits));
  EXPECT_GT(chi2, chi_squared_quantile(0.0005, 6 * kFits));
  EXPECT_GT(unaware, chi_squared_quantile(0.99, 30));
}

/// Boards that turn and drift while a scanner takes 0.1 s to measure them; pictures at 25 Hz, now and then
/// with the pattern seen the other way up.
std::vector<PlaneObservation> seen_moving(std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> unit(0, 1);
  constexpr double kSigmaAngle = 0.001, kSigmaDistance = 0.001, kSigmaPoint = 0.006;
  const Eigen::Vector3d middle(0.4, 0.3, 0);
  const Eigen::Isometry3d half = Eigen::Translation3d(middle) *
                                 Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()) *
                                 Eigen::Translation3d(-middle);
  std::vector<PlaneObservation> views;
  for (int v = 0; v < 20; ++v) {
    const double phi = 2 * M_PI * (v % 7) / 7;
    const Eigen::Isometry3d board = pose({unit(random) - 0.5, 0.6 * unit(random) - 0.3, 2 + 3 * unit(random)},
                                         0.5 * Eigen::Vector3d(std::cos(phi), std::sin(phi), 0));
    // As a turntable does: all one way, some 10 degrees a second.
    const Eigen::Vector3d turn(0.04 * normal(random), 0.17 + 0.02 * normal(random), 0.05 * normal(random));
    const Eigen::Vector3d drift(0.02, 0.01 * normal(random), 0.04);
    const auto at = [&](double t) { return Eigen::Isometry3d(board * pose(t * drift, t * turn)); };
    const auto picture = [&](double t) {
      return BoardAt{t,
                     at(t) * pose({0, 0, kSigmaDistance * normal(random)},
                                  {kSigmaAngle * normal(random), kSigmaAngle * normal(random), 0}),
                     Eigen::Vector3d(kSigmaAngle * kSigmaAngle, kSigmaAngle * kSigmaAngle,
                                     kSigmaDistance * kSigmaDistance)
                         .asDiagonal()};
    };
    std::vector<BoardAt> pictures;
    for (int k = -3; k <= 3; ++k) pictures.push_back(picture(0.04 * k));
    PlaneObservation s;
    s.name = "view " + std::to_string(v);
    s.T_camera_board = pictures[3].T_camera_board;
    s.plane_covariance = pictures[3].plane_covariance;
    if (v % 3 == 0) pictures[1].T_camera_board = pictures[1].T_camera_board * half;
    set_rate(s, 0, pictures, middle);
    const double begin = 0.08 * unit(random);
    for (int i = 0; i < 60; ++i) {
      const double t = begin + 0.02 * unit(random);
      const Eigen::Isometry3d now = at(t);
      const Eigen::Vector3d on = now * Eigen::Vector3d(0.8 * unit(random), 0.6 * unit(random), 0);
      const Eigen::Vector3d n = truth().linear().transpose() * now.linear().col(2);
      s.points_m.push_back(truth().inverse() * on + kSigmaPoint * normal(random) * n);
      s.t_s.push_back(t);
    }
    views.push_back(s);
  }
  return views;
}

TEST(PlaneExtrinsics, BoardsThatMoveWhileTheyAreScannedAreTakenWhereTheyWere) {
  double chi2 = 0, chi2_still = 0;
  int inside = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    auto views = seen_moving(seed);
    const auto fit = fit_plane_extrinsics(views);
    ASSERT_TRUE(fit) << fit.error().text();
    const auto e = error_of(*fit);
    chi2 += e.dot(fit->result.covariance.ldlt().solve(e));
    for (int i = 0; i < 6; ++i)
      inside += std::abs(e[i]) <= 1.959964 * fit->result.parameters[static_cast<std::size_t>(i)].sigma;
    if (seed >= 5) continue;
    for (auto& v : views) v.t_s.clear();
    const auto still = fit_plane_extrinsics(views);
    ASSERT_TRUE(still);
    const auto f = error_of(*still);
    chi2_still += f.dot(still->result.covariance.ldlt().solve(f));
  }
  // As above; the sixty points of a view that are left out at 4 sigma change nothing that shows here.
  const auto quantile = [](double z) {
    const double k = 600, c = 2 / (9 * k);
    return k * std::pow(1 - c + z * std::sqrt(c), 3);
  };
  EXPECT_GT(chi2, quantile(-3.2905));
  EXPECT_LT(chi2, quantile(3.2905));
  EXPECT_GT(inside / 600.0, 0.95 - 3.29 * std::sqrt(0.95 * 0.05 / 100));
  // Taken as standing still they deceive: 30 degrees of freedom, 0.9995.
  EXPECT_GT(chi2_still, 62);
}

TEST(PlaneExtrinsics, ARateIsWhatThePosesSayAndNothingOfOnePose) {
  PlaneObservation s;
  s.T_camera_board = pose({0, 0, 2}, {0.2, 0, 0});
  const Eigen::Matrix3d sure = 1e-8 * Eigen::Matrix3d::Identity();
  set_rate(s, 5, {{5, s.T_camera_board, sure}}, {0.4, 0.3, 0});
  EXPECT_EQ(s.rate.norm(), 0);
  std::vector<BoardAt> poses;
  for (int k = -2; k <= 2; ++k)
    poses.push_back({5 + 0.1 * k, s.T_camera_board * pose({0, 0, 0.01 * k}, {0, 0.02 * k, 0}), sure});
  set_rate(s, 5, poses, {0.4, 0.3, 0});
  EXPECT_NEAR(s.rate[1], 0.2, 1e-9);
  EXPECT_NEAR(s.rate[5], 0.1, 1e-6);
  // Slope of five: sigma^2 / sum of (t - mean)^2 = 1e-8 / 0.1.
  EXPECT_NEAR(s.plane_rate_covariance(0, 0), 1e-7, 1e-9);
  // A motion that is no straight line is said to be less sure.
  poses[0].T_camera_board = poses[0].T_camera_board * pose({0, 0, 0.01}, {0, 0, 0});
  set_rate(s, 5, poses, {0.4, 0.3, 0});
  EXPECT_GT(s.plane_rate_covariance(2, 2), 1e-5);
}

TEST(PlaneExtrinsics, PlanesThatAreWorseThanTheyClaimAreTakenAsTheyAre) {
  double chi2 = 0;
  World w;
  w.views = 40, w.sigma_m = 0.004;
  for (std::uint32_t seed = 0; seed < 5; ++seed) {
    auto views = seen(seed, w);
    for (auto& v : views) v.plane_covariance /= 25;
    const auto fit = fit_plane_extrinsics(views);
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_NEAR(fit->plane_scale, 5, 2);
    EXPECT_FALSE(fit->result.warnings.empty());
    const auto e = error_of(*fit);
    chi2 += e.dot(fit->result.covariance.ldlt().solve(e));
  }
  // 30 degrees of freedom at 0.0005 and 0.9995, and a scale that is itself known to a tenth; taken at their
  // word the planes give some 700.
  EXPECT_GT(chi2, 8);
  EXPECT_LT(chi2, 75);
}

TEST(PlaneExtrinsics, NoiseThatWasStatedTooSmallIsNamedAndEnlargesTheUncertainties) {
  double chi2 = 0;
  constexpr int kFits = 20;
  World w;
  for (std::uint32_t seed = 0; seed < kFits; ++seed) {
    const auto fit = fit_plane_extrinsics(seen(seed, w), {.sigma_point_m = w.sigma_m / 1.4});
    ASSERT_TRUE(fit) << fit.error().text();
    bool named = false;
    for (const auto& text : fit->result.warnings)
      named = named || text.find("the uncertainties were enlarged") != std::string::npos;
    EXPECT_TRUE(named) << seed;
    const auto e = error_of(*fit);
    chi2 += e.dot(fit->result.covariance.ldlt().solve(e));
  }
  // Not smaller than they should be: the quantile at 0.9995 of 120 degrees of freedom. At most 1.4 times too
  // large, where the planes' own errors, which were stated well, make them.
  EXPECT_LT(chi2, chi_squared_quantile(0.9995, 6 * kFits));
  EXPECT_GT(chi2, chi_squared_quantile(0.0005, 6 * kFits) / (1.4 * 1.4));
}

TEST(PlaneExtrinsics, TheStartComesFromTheNormals) {
  const auto T = extrinsics_from_normals(seen(3, {}));
  EXPECT_LT((T.translation() - truth().translation()).norm(), 0.05);
  EXPECT_LT(Eigen::AngleAxisd(T.linear().transpose() * truth().linear()).angle(), 0.02);
}

TEST(PlaneExtrinsics, ParallelBoardsLeaveDirectionsFreeThatAreNamed) {
  World w;
  const auto fit = fit_plane_extrinsics(seen(1, w, 0.0), {.start = truth()});
  ASSERT_TRUE(fit) << fit.error().text();
  // All boards face the camera: shifts along x and y of the camera, and a turn about its axis.
  ASSERT_EQ(fit->result.weak.size(), 3u);
  EXPECT_NE(fit->result.weak[0].cure.find("turn the board"), std::string::npos);
  EXPECT_GT(fit->result.find("x_m")->sigma, 0.1);
  EXPECT_LT(fit->result.find("z_m")->sigma, 0.1);
}

TEST(PlaneExtrinsics, BoardsTiltedAboutOneAxisLeaveTheShiftAlongItFree) {
  World w;
  w.plane_angle_sigma = 1e-5;
  const auto fit = fit_plane_extrinsics(seen(2, w, 0.5, 2), {.start = truth()});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_EQ(fit->result.weak.size(), 1u);
  EXPECT_EQ(fit->result.weak[0].parts.front().name, "x_m");
}

TEST(PlaneExtrinsics, ThirtyPercentOfThePointsBesideTheBoardAreNamedAndLeftOut) {
  World w;
  auto views = seen(4, w);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> far(0.1, 1);
  int wrong = 0;
  for (auto& v : views)
    for (std::size_t i = 0; i < v.points_m.size(); ++i)
      if (i % 10 < 3) v.points_m[i] *= 1 + far(random), ++wrong;
  const auto fit = fit_plane_extrinsics(views, {.sigma_point_m = w.sigma_m});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_GE(static_cast<int>(fit->result.rejected.size()), wrong);
  EXPECT_LE(static_cast<int>(fit->result.rejected.size()), wrong + 5);
  EXPECT_NE(fit->result.rejected[0].what.find("view "), std::string::npos);
  const auto e = error_of(*fit);
  for (int i = 0; i < 6; ++i)
    EXPECT_LT(std::abs(e[i]), 4 * fit->result.parameters[static_cast<std::size_t>(i)].sigma);
}

TEST(PlaneExtrinsics, NothingAndTooLittleAreSaid) {
  EXPECT_FALSE(fit_plane_extrinsics({}));
  auto views = seen(1, {});
  views[2].points_m.resize(2);
  const auto few = fit_plane_extrinsics(views);
  ASSERT_FALSE(few);
  EXPECT_NE(few.error().text().find("view 2"), std::string::npos);
  views = seen(1, {});
  views[4].points_m[7].x() = std::nan("");
  EXPECT_FALSE(fit_plane_extrinsics(views));
  views = seen(1, {});
  views[3].t_s = {0.1};
  const auto instants = fit_plane_extrinsics(views);
  ASSERT_FALSE(instants);
  EXPECT_NE(instants.error().text().find("an instant for each of 60"), std::string::npos);
}

TEST(PointsOnBoard, TheBoardsOwnAndNotTheWallBehind) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 0.005);
  const Eigen::Isometry3d board = pose({-0.4, -0.3, 3}, {0, 0.4, 0});
  std::vector<Eigen::Vector3d> cloud;
  for (double y = -1; y < 1; y += 0.04)
    for (double x = -1; x < 1; x += 0.02) {
      const Eigen::Vector3d ray = Eigen::Vector3d(x, y, 3).normalized();
      const Eigen::Vector3d n = board.linear().col(2);
      const double r = n.dot(board.translation()) / n.dot(ray);
      const Eigen::Vector3d on = board.inverse() * (r * ray);
      const bool hit = on.x() >= 0 && on.x() <= 0.8 && on.y() >= 0 && on.y() <= 0.6;
      cloud.push_back(truth().inverse() * (((hit ? r : 3.6 / ray.z()) + noise(random)) * ray));
    }
  // The rough mount is 3 cm and 1 degree off.
  const auto on =
      points_on_board(cloud, board, pose({0.03, 0, 0}, {0, 0.017, 0}) * truth(), {0.8, 0.6}, 0.15, 0.15);
  ASSERT_GT(on.size(), 200u);
  for (const auto i : on) EXPECT_LT(std::abs((board.inverse() * truth() * cloud[i]).z()), 0.03);
  EXPECT_TRUE(
      points_on_board(cloud, board, pose({2, 0, 0}, {0, 0, 0}) * truth(), {0.8, 0.6}, 0.15, 0.15).empty());
}

}  // namespace
}  // namespace rigor::calibration

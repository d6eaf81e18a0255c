#include "calibration/pair/plane_extrinsics.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

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
std::vector<PlaneSighting> seen(std::uint32_t seed, const World& w, double tilt = 0.5, int directions = 7) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<PlaneSighting> views;
  for (int v = 0; v < w.views; ++v) {
    const double phi = 2 * M_PI * (v % directions) / directions;
    const Eigen::Isometry3d board = pose({unit(random) - 0.5, 0.6 * unit(random) - 0.3, 2 + 3 * unit(random)},
                                         tilt * Eigen::Vector3d(std::cos(phi), std::sin(phi), 0));
    PlaneSighting s;
    s.name = "view " + std::to_string(v);
    // What the camera says of the plane is off by its own error.
    s.plane_covariance = Eigen::Vector3d(std::pow(w.plane_angle_sigma, 2), std::pow(w.plane_angle_sigma, 2),
                                         std::pow(w.plane_distance_sigma, 2))
                             .asDiagonal();
    s.T_first_board =
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
  for (const auto& p : on) EXPECT_LT(std::abs((board.inverse() * truth() * p).z()), 0.03);
  EXPECT_TRUE(
      points_on_board(cloud, board, pose({2, 0, 0}, {0, 0, 0}) * truth(), {0.8, 0.6}, 0.15, 0.15).empty());
}

}  // namespace
}  // namespace rigor::calibration

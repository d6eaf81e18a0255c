// Stems against the truth of a forest of discs: completeness, bias, stated covariance, and what is no stem.
#include "apps/forest-localization/stem_detector.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <cstdio>

#include "tests/apps/forest-localization/disc_forest.h"

namespace rigor::forest {
namespace {

using test::DiscForest;
using test::kPi;
using test::Scanner;

Eigen::Matrix3d covariance(const StemObservation& o) {
  Eigen::Matrix3d P;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) P(i, j) = o.covariance[i][j];
  return P;
}
StemDetectorConfig smooth() {
  StemDetectorConfig c;
  c.surface_sigma_m = 1e-4;  // discs have no bark
  return c;
}

struct Statistics {
  int trials = 0, found = 0;
  Eigen::Vector3d bias = Eigen::Vector3d::Zero();  ///< along, across the line of sight, radius
  Eigen::Vector3d square = Eigen::Vector3d::Zero();
  double nees = 0;
  int inside = 0;  ///< radius within its 95 % interval
};
/// One stem at `range_m`, seen in every direction; `scene` adds to it.
template <class F>
Statistics measure(double range_m, double radius_m, int trials, unsigned seed, F&& scene) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> bearing(-2, 2);
  StemDetector detector(smooth());
  Statistics out;
  for (int k = 0; k < trials; ++k) {
    const double phi = bearing(rng);
    DiscForest forest;
    forest.stems.push_back({range_m * std::cos(phi), range_m * std::sin(phi), radius_m});
    scene(forest, phi);
    ++out.trials;
    for (const StemObservation& o : detector.detect(forest.scan({}, Scanner{}, rng))) {
      const Eigen::Vector3d e(o.x_m - forest.stems[0].x_m, o.y_m - forest.stems[0].y_m,
                              o.radius_m - radius_m);
      if (e.head<2>().norm() > 0.3) continue;
      ++out.found;
      const Eigen::Vector3d along(std::cos(phi) * e.x() + std::sin(phi) * e.y(),
                                  -std::sin(phi) * e.x() + std::cos(phi) * e.y(), e.z());
      out.bias += along;
      out.square += along.cwiseProduct(along);
      out.nees += e.dot(covariance(o).inverse() * e);
      out.inside += std::abs(e.z()) < 1.96 * std::sqrt(o.covariance[2][2]) ? 1 : 0;
      break;
    }
  }
  out.bias /= std::max(out.found, 1);
  out.square /= std::max(out.found, 1);
  return out;
}
void print(const char* what, double range_m, double radius_m, const Statistics& s) {
  std::printf(
      "%-8s %4.0f m, diameter %2.0f cm: found %5.1f %%, bias along %+5.1f across %+5.1f diameter %+5.1f mm, "
      "rms %4.1f %4.1f %5.1f mm, NEES/3 %4.2f, radius in 95 %%: %4.1f %%\n",
      what, range_m, 200 * radius_m, 100.0 * s.found / s.trials, 1e3 * s.bias.x(), 1e3 * s.bias.y(),
      2e3 * s.bias.z(), 1e3 * std::sqrt(s.square.x()), 1e3 * std::sqrt(s.square.y()),
      2e3 * std::sqrt(s.square.z()), s.nees / (3 * std::max(s.found, 1)),
      100.0 * s.inside / std::max(s.found, 1));
}

TEST(StemDetector, IsCompleteUnbiasedAndAsSureAsItSaysAtEveryRange) {
  for (const double radius_m : {0.1, 0.2})
    for (const double range_m : {2.0, 4.0, 7.0, 10.0, 13.0}) {
      const Statistics s = measure(range_m, radius_m, 600, 7, [](DiscForest&, double) {});
      print("alone", range_m, radius_m, s);
      // Four beams at the least: five steps of width are always enough.
      const double steps = 2 * radius_m / range_m / Scanner{}.step_rad;
      if (steps > 5) {
        EXPECT_GE(s.found, 0.99 * s.trials) << range_m;
      }
      if (s.found < 0.9 * s.trials) continue;
      const double n = s.found;
      // An edge between two beams is uniform and no Gaussian, and what grazes is weighted down; so this is no
      // test of a hypothesis: the covariance is to describe the errors to 15 %, and a bias, which there is
      // (the radius comes out smaller by up to half of its sigma), is not to stand out of them.
      for (int i = 0; i < 3; ++i)
        EXPECT_LT(std::abs(s.bias[i]), std::sqrt(s.square[i]) * std::max(4 / std::sqrt(n), 0.5)) << range_m;
      EXPECT_LT(s.nees, 1.15 * 3 * n) << range_m;
      EXPECT_GT(s.nees, 0.8 * 3 * n) << range_m;
      EXPECT_GT(s.inside, 0.87 * n) << range_m;
    }
}

TEST(StemDetector, SeesAStemThatAnotherHidesInPartAndSaysSo) {
  std::mt19937 rng(3);
  for (const double range_m : {4.0, 6.0}) {
    const Statistics s = measure(range_m, 0.2, 400, 11, [&](DiscForest& forest, double phi) {
      // In front, and covering the left 40 % of it.
      const double at = phi + (0.2 * 0.2 + 0.1) / range_m + 0.05 / range_m;
      forest.stems.push_back({0.6 * range_m * std::cos(at), 0.6 * range_m * std::sin(at), 0.075});
    });
    print("hidden", range_m, 0.2, s);
    EXPECT_GT(s.found, 0.9 * s.trials);
    EXPECT_LT(s.nees, 1.15 * 3 * s.found);
  }
  DiscForest forest;
  forest.stems = {{5, 0, 0.2}, {3, 0.13, 0.075}};
  StemDetector detector(smooth());
  bool marked = false;
  for (const StemObservation& o : detector.detect(forest.scan({}, Scanner{}, rng)))
    if (o.x_m > 4) marked = o.hidden_left && !o.hidden_right;
  EXPECT_TRUE(marked);
}

TEST(StemDetector, TakesNoWallsBoxesOrBushesForStems) {
  std::mt19937 rng(5);
  StemDetector detector(smooth());
  std::uniform_real_distribution<double> unit(0, 1);
  int walls = 0, boxes = 0, bushes = 0, scans = 0;
  for (int k = 0; k < 100; ++k, ++scans) {
    DiscForest room;
    const double d = 3 + 5 * unit(rng);
    room.walls = {{d, -d, d, d}, {d, d, -d, d}, {-d, -d, d, -d}};
    walls += static_cast<int>(detector.detect(room.scan({0, 0, unit(rng) * 6}, Scanner{}, rng)).size());
    DiscForest box;
    const double x = 2 + 4 * unit(rng), w = 0.3;
    box.walls = {{x, -w, x, w}, {x, w, x + 2 * w, w}, {x, -w, x + 2 * w, -w}};
    boxes += static_cast<int>(detector.detect(box.scan({}, Scanner{}, rng)).size());
    // A bush: each beam through it ends on a leaf of its own, 1.5 m deep.
    std::vector<LidarPoint> bush;
    for (double bearing = -0.2; bearing < 0.2; bearing += Scanner{}.step_rad) {
      const double r = 4 + 1.5 * unit(rng);
      LidarPoint p{};
      p.x_m = static_cast<float>(r * std::cos(bearing));
      p.y_m = static_cast<float>(r * std::sin(bearing));
      bush.push_back(p);
    }
    bushes += static_cast<int>(detector.detect(bush).size());
  }
  std::printf("taken for stems in %d scans: walls %d, boxes of 0.6 m %d, bushes %d (of 69 beams each)\n",
              scans, walls, boxes, bushes);
  EXPECT_EQ(walls, 0);
  EXPECT_EQ(boxes, 0);
  EXPECT_LT(bushes, scans);  // a bush has runs of beams that lie like a stem by chance
}

TEST(StemDetector, MovesWhatWasSeenWhileItMovedToTheInstantOfCapture) {
  std::mt19937 rng(9);
  DiscForest forest;
  forest.stems = {{0, 4, 0.2}, {0, -4, 0.2}, {4, 0.5, 0.2}};
  const test::Twist twist{1.5, 0.6};
  StemDetector detector(smooth());
  double still = 0, moving = 0;
  for (int k = 0; k < 50; ++k) {
    const auto scan = forest.scan({}, Scanner{}, rng, twist);
    for (const bool told : {false, true}) {
      double& worst = told ? moving : still;
      const auto stems = detector.detect(scan, told ? ScanMotion{1.5, 0, 0.6} : ScanMotion{});
      ASSERT_EQ(stems.size(), 3u);
      for (const StemObservation& o : stems) {
        double nearest = 1e9;
        for (const Stem& s : forest.stems)
          nearest = std::min(nearest, std::hypot(s.x_m - o.x_m, s.y_m - o.y_m));
        worst += nearest / 150;
      }
    }
  }
  std::printf("mean error at 1.5 m/s: %.1f mm, without compensation %.1f mm\n", 1e3 * moving, 1e3 * still);
  EXPECT_LT(moving, 0.02);
  EXPECT_GT(still, 0.03);
}

TEST(StemDetector, LivesWithWhatIsNoReturnAndWithTooMuch) {
  std::mt19937 rng(1);
  StemDetector detector(smooth());
  EXPECT_TRUE(detector.detect({}).empty());
  DiscForest forest;
  forest.stems = {{4, 0, 0.2}, {3, 3, 0.15}};
  auto scan = forest.scan({}, Scanner{}, rng);
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  const std::size_t clean = detector.detect(scan).size();
  EXPECT_EQ(clean, 2u);
  for (const float bad : {nan, inf, -inf, 0.0f}) {
    LidarPoint p{};
    p.x_m = p.y_m = bad;
    scan.insert(scan.begin() + 3, p);
    scan.push_back(p);
  }
  EXPECT_EQ(detector.detect(scan).size(), clean);
  // In any order.
  std::shuffle(scan.begin(), scan.end(), rng);
  EXPECT_EQ(detector.detect(scan).size(), clean);
  // More beams than there is room for, and more stems.
  Scanner fine;
  fine.step_rad = kPi / 20000;
  EXPECT_LE(detector.detect(forest.scan({}, fine, rng)).size(), StemDetector::kMaxStems);
  std::vector<LidarPoint> flood(StemDetector::kMaxBeams + 1000, forest.scan({}, Scanner{}, rng)[0]);
  (void)detector.detect(flood);
  EXPECT_GE(detector.counters().left_out, 1000u);
  const DiscForest dense = DiscForest::random(12, 0.4, 2, {{}}, 1.5);
  const auto stems = detector.detect(dense.scan({}, Scanner{}, rng));
  EXPECT_GT(stems.size(), 20u);
  for (std::size_t i = 1; i < stems.size(); ++i)
    EXPECT_LT(std::atan2(stems[i - 1].y_m, stems[i - 1].x_m), std::atan2(stems[i].y_m, stems[i].x_m));
}

}  // namespace
}  // namespace rigor::forest

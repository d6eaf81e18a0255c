// The map and its files, matching, finding a constellation again, steering, and the application's complaints.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>

#include "apps/forest-localization/geodetic.h"
#include "apps/forest-localization/localizer.h"
#include "apps/forest-localization/path_follower.h"
#include "tests/apps/forest-localization/closed_loop.h"

namespace rigor::forest {
namespace {

using test::DiscForest;
using test::kPi;
using test::Scanner;

class Folder : public ::testing::Test {
 protected:
  Folder() { std::filesystem::create_directories(dir); }
  ~Folder() override { std::filesystem::remove_all(dir); }
  std::filesystem::path write(const std::string& name, const std::string& text) {
    std::ofstream(dir / name) << text;
    return dir / name;
  }
  std::filesystem::path dir =
      std::filesystem::temp_directory_path() / ("forest-parts-" + std::to_string(getpid()));
};
using StemMapFile = Folder;
using ForestApplication = Folder;

TEST_F(StemMapFile, IsReadFromBothFormats) {
  for (const auto& file :
       {write("a.csv",
              "# stand\ndiameter_m, x_m,y_m,species,fell\n0.4,1,2,oak,true\r\n0.2,-3,4.5,beech,false\n"),
        write("a.yaml",
              "stems:\n  - { x_m: 1, y_m: 2, diameter_m: 0.4, fell: true }\n"
              "  - { x_m: -3, y_m: 4.5, diameter_m: 0.2 }\n")}) {
    const auto map = StemMap::load(file);
    ASSERT_TRUE(map) << map.error().text();
    ASSERT_EQ(map->size(), 2u);
    EXPECT_EQ((*map)[0].x_m, 1);
    EXPECT_EQ((*map)[0].radius_m, 0.2);
    EXPECT_TRUE((*map)[0].fell);
    EXPECT_EQ((*map)[1].y_m, 4.5);
    EXPECT_FALSE((*map)[1].fell);
  }
}

TEST_F(StemMapFile, SaysWhereAndWhatIsWrong) {
  const auto message = [&](const std::string& name, const std::string& text) {
    const auto map = StemMap::load(write(name, text));
    return map ? std::string("read") : map.error().text();
  };
  EXPECT_NE(message("b.csv", "x,y\n1,2\n").find("b.csv:1: expected a header"), std::string::npos);
  EXPECT_NE(
      message("c.csv", "x_m,y_m,diameter_m\n1,2,0.3\n1,two,0.3\n").find("c.csv:3: y_m: expected a number"),
      std::string::npos);
  EXPECT_NE(message("d.csv", "x_m,y_m,diameter_m\n1,2\n").find("d.csv:2: expected 3 fields"),
            std::string::npos);
  EXPECT_NE(message("e.csv", "x_m,y_m,diameter_m\n1,2,-0.3\n").find("stem 1: expected"), std::string::npos);
  EXPECT_NE(message("f.csv", "x_m,y_m,diameter_m,fell\n1,2,0.3,yes\n").find("fell: expected true or false"),
            std::string::npos);
  EXPECT_NE(message("g.yaml", "stems:\n  - { x_m: 1, y_m: 2, diameter_m: 0 }\n").find("g.yaml:2"),
            std::string::npos);
  EXPECT_NE(message("h.csv", "x_m,y_m,diameter_m\n").find("1 to 20000 stems"), std::string::npos);
  EXPECT_EQ(StemMap::load(dir / "none.csv").error().code, ErrorCode::not_found);
}

TEST(StemMap, FindsWhatABruteSearchFinds) {
  const DiscForest forest = DiscForest::random(30, 0.05, 4);
  const auto map = StemMap::from(forest.stems);
  std::mt19937 rng(2);
  std::uniform_real_distribution<double> place(-40, 40), limit(0.2, 6);
  for (int k = 0; k < 500; ++k) {
    const double x = place(rng), y = place(rng), r = limit(rng);
    std::uint32_t best = StemMap::kNone;
    std::size_t within = 0, found = 0;
    for (std::uint32_t i = 0; i < forest.stems.size(); ++i) {
      const double d = std::hypot(forest.stems[i].x_m - x, forest.stems[i].y_m - y);
      if (d > r) continue;
      ++within;
      if (best == StemMap::kNone || d < std::hypot(forest.stems[best].x_m - x, forest.stems[best].y_m - y))
        best = i;
    }
    map->near(x, y, r, [&](std::uint32_t) { ++found; });
    EXPECT_EQ(found, within);
    EXPECT_EQ(map->nearest(x, y, r), best);
  }
  for (const StemPair& p : map->pairs_between(4.9, 5.1)) {
    EXPECT_GE(p.distance_m, 4.9f);
    EXPECT_LE(p.distance_m, 5.1f);
  }
}

TEST(StemMatcher, TakesThePairingThatFitsTogetherWhereTheNearestDoesNot) {
  // A row with steps of 1 m, seen from 0.6 m farther along it than believed: each stem is nearer to its
  // neighbour's place. A stem beside the row tells which.
  std::vector<Stem> stems;
  for (int i = -3; i <= 3; ++i) stems.push_back({5, 1.0 * i, 0.15});
  stems.push_back({3, 2.3, 0.15});
  const auto map = StemMap::from(stems);
  const double shift = 0.6;
  std::vector<StemObservation> seen;
  for (const std::uint32_t i : {2u, 3u, 4u, 7u}) {
    StemObservation o;
    o.x_m = stems[i].x_m, o.y_m = stems[i].y_m - shift, o.radius_m = 0.15;
    for (int k = 0; k < 3; ++k) o.covariance[k][k] = 1e-4;
    seen.push_back(o);
  }
  PoseGaussian prior;
  prior.covariance = Eigen::Vector3d(0.01, 0.16, 1e-4).asDiagonal();
  StemMatcher matcher({});
  const auto matches = matcher.match(seen, prior, *map);
  ASSERT_EQ(matches.size(), 4u);
  const std::uint32_t expected[] = {2, 3, 4, 7};
  for (const StemMatch& m : matches) EXPECT_EQ(m.stem, expected[m.observation]);
  EXPECT_FALSE(matcher.exhausted());
  // What stands nowhere in the map is left alone.
  seen[1].x_m -= 1.5;
  EXPECT_EQ(matcher.match(seen, prior, *map).size(), 3u);
  EXPECT_TRUE(matcher.match({}, prior, *map).empty());
}

struct Search {
  int found = 0, right = 0, failed = 0;
  std::uint64_t most = 0;
  double nees = 0;
};
/// Scans of one forest at random places, looked up in a map.
Search search(const DiscForest& forest, const std::vector<Stem>& mapped, int trials, bool hinted) {
  const auto map = StemMap::from(mapped);
  std::mt19937 rng(12);
  std::uniform_real_distribution<double> place(-18, 18), turn(-kPi, kPi);
  StemDetector detector({});
  Relocalizer relocalizer({});
  Search out;
  for (int k = 0; k < trials; ++k) {
    PlanarPose pose{place(rng), place(rng), turn(rng)};
    while (std::any_of(forest.stems.begin(), forest.stems.end(), [&](const Stem& s) {
      return std::hypot(s.x_m - pose.x_m, s.y_m - pose.y_m) < s.radius_m + 0.4;
    }))
      pose = {place(rng), place(rng), turn(rng)};
    const auto stems = detector.detect(forest.scan(pose, Scanner{}, rng));
    std::optional<PositionHint> hint;
    if (hinted) hint = PositionHint{pose.x_m + 1, pose.y_m - 1, 1.5};
    relocalizer.begin(stems, *map, hint);
    while (relocalizer.state() == Relocalizer::State::working) relocalizer.work(100);
    out.most = std::max(out.most, relocalizer.tried());
    if (relocalizer.state() != Relocalizer::State::found) {
      ++out.failed;
      continue;
    }
    ++out.found;
    const PoseGaussian& p = relocalizer.pose();
    const Eigen::Vector3d e(p.mean.x() - pose.x_m, p.mean.y() - pose.y_m,
                            wrapped_rad(p.mean.z() - pose.yaw_rad));
    if (e.head<2>().norm() < 0.15 && std::abs(e.z()) < 0.03) ++out.right;
  }
  return out;
}

TEST(Relocalizer, FindsItsPlaceInAStandFromOneScanAndNeverAWrongOne) {
  const DiscForest forest = DiscForest::random(30, 0.06, 21);
  std::vector<Stem> mapped = forest.stems;
  std::mt19937 rng(4);
  std::normal_distribution<double> noise(0, 0.03);
  for (Stem& s : mapped) s.x_m += noise(rng), s.y_m += noise(rng);
  const Search s = search(forest, mapped, 100, false);
  const Search h = search(forest, mapped, 100, true);
  std::printf("found %d of 100, right %d, at most %llu poses tried; near a fix found %d, right %d\n", s.found,
              s.right, static_cast<unsigned long long>(s.most), h.found, h.right);
  EXPECT_GE(s.found, 90);
  EXPECT_EQ(s.right, s.found);
  EXPECT_GE(h.found, s.found - 3);
  EXPECT_EQ(h.right, h.found);
}

TEST(Relocalizer, FindsNothingInAnotherStandNorAmongRowsThatLookAlike) {
  const DiscForest here = DiscForest::random(30, 0.06, 21), elsewhere = DiscForest::random(30, 0.06, 77);
  const Search s = search(here, elsewhere.stems, 40, false);
  std::printf("in a map of another stand: found %d of 40\n", s.found);
  EXPECT_EQ(s.found, 0);
  DiscForest rows;
  for (int i = -12; i <= 12; ++i)
    for (int j = -12; j <= 12; ++j) rows.stems.push_back({2.5 * i, 2.5 * j, 0.15});
  EXPECT_EQ(search(rows, rows.stems, 10, false).found, 0);
}

TEST(Localizer, TakesASlipBetweenTwoScansForWhatItIs) {
  const DiscForest forest = DiscForest::random(20, 0.06, 21, {{}});
  const auto map = StemMap::from(forest.stems);
  PoseGaussian start;
  start.covariance = Eigen::Vector3d(1e-4, 1e-4, 1e-4).asDiagonal();
  Localizer localizer({}, *map, start);
  StemDetector detector({});
  std::mt19937 rng(3);
  const auto scan = [&](int k, const PlanarPose& pose) {
    const BenchTime t = BenchTime(0) + milliseconds(66) * k;
    localizer.odometry(t, 0, 0);  // the wheels stand, as far as they know
    localizer.scan(t, detector.detect(forest.scan(pose, Scanner{}, rng)));
    return localizer.filter().state();
  };
  for (int k = 1; k < 10; ++k) scan(k, {});
  EXPECT_EQ(localizer.counters().slips, 0u);
  const PlanarPose moved_to{0.35, -0.2, 0.15};
  const auto state = scan(10, moved_to);
  EXPECT_EQ(localizer.counters().slips, 1u);
  EXPECT_NEAR(state[0], 0.35, 0.03);
  EXPECT_NEAR(state[1], -0.2, 0.03);
  EXPECT_NEAR(state[2], 0.15, 0.01);
  EXPECT_EQ(localizer.state(), LocalizerState::tracking);
}

/// Stems of a scan, the nearest `seen` of them, among `ghosts` that stand elsewhere each time: ferns.
std::span<const StemObservation> among_ghosts(std::span<const StemObservation> stems, std::size_t seen,
                                              std::size_t ghosts, std::mt19937& rng,
                                              std::vector<StemObservation>& out) {
  out.assign(stems.begin(), stems.end());
  std::sort(out.begin(), out.end(),
            [](const auto& a, const auto& b) { return std::hypot(a.x_m, a.y_m) < std::hypot(b.x_m, b.y_m); });
  out.resize(std::min(out.size(), seen));
  std::uniform_real_distribution<double> place(-7, 7), radius(0.03, 0.2);
  for (std::size_t i = 0; i < ghosts; ++i) {
    StemObservation ghost = stems.front();
    ghost.x_m = place(rng), ghost.y_m = place(rng), ghost.radius_m = radius(rng);
    out.push_back(ghost);
  }
  return out;
}

TEST(Localizer, KeepsItsPlaceAmongFernsThatLookLikeStems) {
  const DiscForest forest = DiscForest::random(20, 0.06, 21, {{}});
  const auto map = StemMap::from(forest.stems);
  PoseGaussian start;
  start.covariance = Eigen::Vector3d(1e-4, 1e-4, 1e-4).asDiagonal();
  Localizer localizer({}, *map, start);
  StemDetector detector({});
  std::mt19937 rng(3);
  std::vector<StemObservation> seen;
  int k = 0;
  double way_m = 0;
  const auto scan = [&](const PlanarPose& pose, std::size_t stems) {
    const BenchTime t = BenchTime(0) + milliseconds(66) * ++k;
    localizer.odometry(t, way_m, 0);
    localizer.scan(t, among_ghosts(detector.detect(forest.scan(pose, Scanner{}, rng)), stems, 18, rng, seen));
  };
  for (int i = 0; i < 60; ++i) scan({}, 7);
  EXPECT_EQ(localizer.state(), LocalizerState::tracking);
  EXPECT_EQ(localizer.counters().lost, 0u) << localizer.counters().poor_scans << " scans were called poor";
  EXPECT_LT(std::hypot(localizer.filter().state()[0], localizer.filter().state()[1]), 0.02);
  // Where only three of the map are in sight, it still knows.
  for (int i = 0; i < 60; ++i) scan({}, 3);
  EXPECT_EQ(localizer.state(), LocalizerState::tracking);
  EXPECT_LT(localizer.counters().poor_scans, 12u);
  EXPECT_LT(std::hypot(localizer.filter().state()[0], localizer.filter().state()[1]), 0.03);
  // A place without any is passed by odometry.
  for (int i = 0; i < 30; ++i) way_m += 0.05, scan({0.05 * (i + 1), 0, 0}, 0);
  EXPECT_EQ(localizer.state(), LocalizerState::tracking);
  EXPECT_GE(localizer.counters().poor_scans, 20u);
  for (int i = 0; i < 10; ++i) scan({1.5, 0, 0}, 5);
  EXPECT_NEAR(localizer.filter().state()[0], 1.5, 0.05);
  EXPECT_NEAR(localizer.filter().state()[1], 0, 0.05);
  // And ghosts alone are no place: carried away, it notices before long.
  for (int i = 0; i < 200; ++i) way_m += 0.05, scan({7.3, -5.1, 1}, 0);
  EXPECT_GE(localizer.counters().lost, 1u);
  EXPECT_EQ(localizer.state(), LocalizerState::searching);
}

TEST(Localizer, EndsASearchWhereDeadReckoningWasRight) {
  const DiscForest forest = DiscForest::random(20, 0.06, 21, {{}});
  const auto map = StemMap::from(forest.stems);
  PoseGaussian start;
  start.covariance = Eigen::Vector3d(1e-4, 1e-4, 1e-4).asDiagonal();
  Localizer localizer({}, *map, start);
  StemDetector detector({});
  std::mt19937 rng(3);
  std::vector<StemObservation> seen;
  int k = 0;
  double way_m = 0;
  const auto scan = [&](double x_m, std::size_t stems) {
    const BenchTime t = BenchTime(0) + milliseconds(66) * ++k;
    localizer.odometry(t, way_m, 0);
    localizer.scan(
        t, among_ghosts(detector.detect(forest.scan({x_m, 0, 0}, Scanner{}, rng)), stems, 12, rng, seen));
  };
  for (int i = 0; i < 10; ++i) scan(0, 7);
  // The wheels turn for metres where nothing of the map is in sight, and come back.
  for (int i = 0; i < 70; ++i) way_m += 0.1, scan(0.1 * (i + 1), 0);
  ASSERT_EQ(localizer.state(), LocalizerState::searching);
  for (int i = 0; i < 10; ++i) scan(7, 6);
  EXPECT_EQ(localizer.state(), LocalizerState::tracking);
  EXPECT_NEAR(localizer.filter().state()[0], 7, 0.05);
  EXPECT_NEAR(localizer.filter().state()[1], 0, 0.05);
  EXPECT_EQ(localizer.counters().found, 1u);
}

// ---- steering ----

/// Drives a body exactly as told; how far it was off its way at the worst after `from_m`.
double worst_off(PathFollower& follower, PlanarPose& pose, double max_s, double from_m) {
  double worst = 0;
  for (int k = 0; k < static_cast<int>(max_s * 20); ++k) {
    const DriveCommand c = follower.step({pose.x_m, pose.y_m, pose.yaw_rad}, 0.05, true);
    EXPECT_LE(std::abs(c.v_mps), 0.5 + 1e-12);
    EXPECT_LE(std::abs(c.w_radps), 0.8 + 1e-12);
    if (follower.progress_m() > from_m) worst = std::max(worst, std::abs(follower.cross_track_m()));
    pose = test::after(pose, {c.v_mps, c.w_radps}, 0.05);
    if (follower.done() && c.v_mps == 0) break;
  }
  return worst;
}

TEST(PathFollower, GoesOntoItsWayAndStopsAtTheEnd) {
  PathFollower follower({}, 10);
  const WayPoint way[] = {{0, 0}, {10, 0}};
  ASSERT_TRUE(follower.set_path(way, 2));
  PlanarPose pose{0, 0.8, 0.3};
  EXPECT_LT(worst_off(follower, pose, 60, 5), 0.02);
  EXPECT_TRUE(follower.done());
  EXPECT_NEAR(pose.x_m, 10, 0.16);
  EXPECT_NEAR(pose.y_m, 0, 0.05);
}
TEST(PathFollower, TurnsOnTheSpotWhereTheWayLiesBehind) {
  PathFollower follower({}, 10);
  const WayPoint way[] = {{0, 0}, {-5, 0}};
  ASSERT_TRUE(follower.set_path(way, 2));
  PlanarPose pose;
  for (int k = 0; k < 20; ++k) {
    const DriveCommand c = follower.step({pose.x_m, pose.y_m, pose.yaw_rad}, 0.05, true);
    EXPECT_EQ(c.v_mps, 0);
    EXPECT_NE(c.w_radps, 0);
    pose = test::after(pose, {c.v_mps, c.w_radps}, 0.05);
  }
  worst_off(follower, pose, 60, 0);
  EXPECT_NEAR(pose.x_m, -5, 0.16);
}
TEST(PathFollower, KeepsToItsOwnBranchWhereTheWayCrossesItself) {
  std::vector<WayPoint> eight;
  for (int i = 0; i <= 200; ++i) {
    const double a = 2 * kPi * i / 200;
    eight.push_back({6 * std::sin(a), 3 * std::sin(2 * a)});
  }
  PathFollower follower({}, eight.size());
  ASSERT_TRUE(follower.set_path(eight.data(), eight.size()));
  PlanarPose pose{0, 0, kPi / 4};
  EXPECT_LT(worst_off(follower, pose, 200, 2), 0.2);
  EXPECT_TRUE(follower.done());
  EXPECT_GT(follower.progress_m(), 0.98 * follower.length_m());
  EXPECT_NEAR(std::hypot(pose.x_m, pose.y_m), 0, 0.3);
}
TEST(PathFollower, GoesToTheEndOfALaneBeforeItComesBackBesideIt) {
  PathFollower follower({}, 10);
  const WayPoint way[] = {{0, 0}, {10, 0}, {10, 0.1}, {0, 0.1}};
  ASSERT_TRUE(follower.set_path(way, 4));
  PlanarPose pose{0, 0.3, 0};
  double farthest = 0;
  for (int k = 0; k < 2000 && !follower.done(); ++k) {
    const DriveCommand c = follower.step({pose.x_m, pose.y_m, pose.yaw_rad}, 0.05, true);
    pose = test::after(pose, {c.v_mps, c.w_radps}, 0.05);
    farthest = std::max(farthest, pose.x_m);
  }
  EXPECT_TRUE(follower.done());
  EXPECT_GT(farthest, 9);
  EXPECT_LT(pose.x_m, 0.5);
}
TEST(PathFollower, BrakesWhereItMayNotDriveAndRefusesWaysThatAreTooLong) {
  PathFollower follower({}, 2);
  const WayPoint way[] = {{0, 0}, {10, 0}, {20, 0}};
  EXPECT_FALSE(follower.set_path(way, 3));
  EXPECT_FALSE(follower.set_path(way, 0));
  ASSERT_TRUE(follower.set_path(way, 2));
  DriveCommand c;
  for (int k = 0; k < 60; ++k) c = follower.step({0.1 * k, 0, 0}, 0.05, true);
  EXPECT_NEAR(c.v_mps, 0.5, 1e-9);
  for (int k = 0; k < 30; ++k) c = follower.step({6, 0, 0}, 0.05, false);
  EXPECT_EQ(c.v_mps, 0);
  EXPECT_EQ(c.w_radps, 0);
  EXPECT_EQ(follower.step({std::nan(""), 0, 0}, 0.05, true).v_mps, 0);
}

TEST(Geodetic, GivesTheLengthOfADegreeOnTheEllipsoid) {
  // A degree of latitude at 45 degrees is 111 131.8 m, one of longitude at the equator 111 319.5 m.
  const auto north = east_north_m({45, 7, 0}, {45.001, 7, 0});
  EXPECT_NEAR(north[1], 111.1318, 1e-3);
  EXPECT_NEAR(north[0], 0, 1e-6);
  EXPECT_NEAR(east_north_m({0, 7, 0}, {0, 7.001, 0})[0], 111.3195, 1e-3);
}

// ---- the application ----

TEST_F(ForestApplication, SaysWhatItMissesAndWhere) {
  const auto way = test::way_200();
  const DiscForest forest = DiscForest::random(20, 0.05, 1);
  const std::string keys = test::write_inputs(dir, forest, way, {});
  test::FakeChannel scanner(SampleKind::point_cloud, {}, {}, 1), odometry(SampleKind::odometry, {}, {}, 1),
      imu(SampleKind::imu, {}, {}, 1);
  test::FakeSink drive({"v", "w"}), estimate({"x", "y"});
  CommandPort drive_port("drive", drive, {}), estimate_port("estimate", estimate, {});
  ApplicationPorts ports;
  ports.inputs["scanner"] = {"scanner", &scanner.description, &scanner.port};
  ports.inputs["odometry"] = {"odometry", &odometry.description, &odometry.port};
  ports.inputs["imu"] = {"imu", &imu.description, &imu.port};
  ports.outputs["drive"] = &drive_port;
  ports.outputs["estimate"] = &estimate_port;
  const auto message = [&](std::string text, const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
    const auto document = ConfigDocument::parse(text, "rig.yaml");
    EXPECT_TRUE(document) << (document ? "" : document.error().text());
    const Status s = make_forest_localization()->configure(*document, ports, milliseconds(1));
    return s ? std::string("configured") : s.error().text();
  };
  EXPECT_EQ(message(keys, "channel: imu", "channel: imu"), "configured");
  EXPECT_NE(
      message(keys, "channel: scanner", "channel: scaner").find("(imu, odometry, scanner), got \"scaner\""),
      std::string::npos);
  EXPECT_NE(message(keys, "channel: scanner", "channel: imu").find("of kind point_cloud"), std::string::npos);
  EXPECT_NE(message(keys, "sink: drive", "sink: estimate").find("values v [m/s] and w [rad/s]"),
            std::string::npos);
  EXPECT_NE(message(keys, "sink: estimate", "sink: drive").find("got \"v\""), std::string::npos);
  EXPECT_NE(message(keys, "stems.csv", "none.csv").find("none.csv: expected a stem map"), std::string::npos);
  EXPECT_NE(message(keys, "way.csv", "none.csv").find("expected a path"), std::string::npos);
  EXPECT_NE(message(keys, "step_deg", "stepdeg").find("step_deg"), std::string::npos);
  EXPECT_NE(message(keys, "drive: {", "guide: marked\ndrive: {").find("fell: true"), std::string::npos);
}

TEST_F(ForestApplication, GoesToTheStemsThatAreMarkedForFelling) {
  test::LoopOptions options;
  options.extra = "guide: marked\nmarked: { stand_off_m: 2, dwell_s: 1 }\n";
  options.max_s = 400;
  const test::LoopResult r = test::run_loop(options);
  std::printf("marked stems: drove %.1f m, stood %zu times before one\n", r.driven_m, r.stops_at_marked);
  EXPECT_EQ(r.stops_at_marked, 3u);
}

}  // namespace
}  // namespace rigor::forest

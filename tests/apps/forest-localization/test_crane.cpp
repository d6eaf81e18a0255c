// The crane of the application against the machine it works with, tilted scanners, and the whole of it: along
// a strip road to the marked stems, each of which falls. The machine is the platform's model; stand and
// scanners are the test's own.
#include "apps/forest-localization/crane.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>

#include "apps/forest-localization/level_scan.h"
#include "sim/platform/harvester.h"
#include "sim/world/pose.h"
#include "tests/apps/forest-localization/closed_loop.h"

namespace rigor::forest {
namespace {

using test::FakeChannel;
using test::FakeSink;
using test::kPi;
constexpr double kDeg = kPi / 180;

/// The crane of HarvesterConfig's own numbers; the base is the middle of the rear axle.
CraneGeometry geometry(double base_x_m = 0) {
  const HarvesterConfig c;
  CraneGeometry g;
  g.foot_x_m = c.foot_m.x() - base_x_m, g.foot_y_m = c.foot_m.y(), g.foot_z_m = c.foot_m.z();
  g.boom_m = c.boom_m, g.stick_m = c.stick_m, g.head_m = c.head_m;
  using H = HarvesterConfig;
  g.least = {c.axis[H::kSlew].min, c.axis[H::kBoom].min, c.axis[H::kStick].min, c.axis[H::kTelescope].min};
  g.greatest = {c.axis[H::kSlew].max, c.axis[H::kBoom].max, c.axis[H::kStick].max, c.axis[H::kTelescope].max};
  return g;
}

std::size_t signal(const Platform& p, const std::string& name) {
  for (std::size_t i = 0; i < p.signals().size(); ++i)
    if (p.signals()[i].name == name) return i;
  ADD_FAILURE() << name;
  return 0;
}

TEST(Crane, AnglesBringTheMachinesHeadToThePlace) {
  const CraneGeometry g = geometry();
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> bearing(-100 * kDeg, 100 * kDeg), range(3.2, 9), height(0.2, 1.5);
  int reached = 0;
  for (int i = 0; i < 60; ++i) {
    const double b = bearing(rng), r = range(rng);
    const CranePlace at{g.foot_x_m + r * std::cos(b), g.foot_y_m + r * std::sin(b), height(rng)};
    const auto angles = angles_for(g, at);
    if (!angles) continue;
    ++reached;
    const CranePlace back = place_of_head(g, *angles);
    EXPECT_NEAR(back.x_m, at.x_m, 1e-9);
    EXPECT_NEAR(back.y_m, at.y_m, 1e-9);
    EXPECT_NEAR(back.z_m, at.z_m, 1e-9);
    Harvester machine(HarvesterConfig{}, {}, Ground(), {});
    machine.start(BenchTime(0));
    for (const auto& [name, value] : {std::pair{"slew_to", angles->slew_rad / kDeg},
                                      {"boom_to", angles->boom_rad / kDeg},
                                      {"stick_to", angles->stick_rad / kDeg},
                                      {"telescope_to", angles->telescope_m}})
      EXPECT_TRUE(machine.write(signal(machine, name), value, BenchTime(0)));
    const Eigen::Vector3d head = machine.T_world_head(BenchTime(0) + seconds(30)).translation();
    EXPECT_LT((head - Eigen::Vector3d(at.x_m, at.y_m, at.z_m)).norm(), 1e-6);
  }
  EXPECT_GT(reached, 50);
}

TEST(Crane, KeepsWithinEndStopsAndSaysWhatIsOutOfReach) {
  const CraneGeometry g = geometry();
  for (double r = 0.2; r < 14; r += 0.1)
    for (double bearing = -170; bearing <= 170; bearing += 10) {
      const auto a =
          angles_for(g, {g.foot_x_m + r * std::cos(bearing * kDeg), r * std::sin(bearing * kDeg), 0.4});
      const bool beyond = std::abs(bearing * kDeg) > g.greatest.slew_rad ||
                          r > g.boom_m + g.stick_m + g.greatest.telescope_m || r < 1;
      EXPECT_FALSE(beyond && a) << r << " m at " << bearing;
      EXPECT_TRUE(a || beyond || r <= 3.5 || r >= 9) << r << " m at " << bearing;
      if (!a) continue;
      EXPECT_GE(a->boom_rad, g.least.boom_rad);
      EXPECT_LE(a->boom_rad, g.greatest.boom_rad);
      EXPECT_GE(a->stick_rad, g.least.stick_rad);
      EXPECT_LE(a->stick_rad, g.greatest.stick_rad);
      EXPECT_LE(a->telescope_m, g.greatest.telescope_m + 1e-9);
    }
}

TEST(Crane, GivesUpWhatItDoesNotGetToAndSaysThatNothingWasCut) {
  CraneWorkConfig c;
  c.crane = geometry();
  CraneWork work(c);
  CraneTold told;
  told.angles = c.rest;
  ASSERT_TRUE(work.begin(c.crane.foot_x_m + 5, 2, told, BenchTime(0)));
  EXPECT_FALSE(work.begin(c.crane.foot_x_m + 5, 1, told, BenchTime(0))) << "busy";
  bool fell = false;
  for (int k = 0; work.busy() && k < 2000; ++k)  // it never moves
    fell = work.step(told, BenchTime(0) + milliseconds(50 * k)).fell > 0 || fell;
  EXPECT_FALSE(work.busy());
  EXPECT_FALSE(fell);
  EXPECT_EQ(work.cut(), 0u);
  EXPECT_EQ(work.failed(), 1u);
}

/// A tilted scanner over level ground among upright stems, in closed form.
struct TiltedScanner {
  Eigen::Isometry3d T_base_sensor = Eigen::Isometry3d::Identity();
  TiltedScanner(double x, double y, double z, double pitch_deg, double yaw_deg) {
    T_base_sensor.translation() = Eigen::Vector3d(x, y, z);
    T_base_sensor.linear() = (Eigen::AngleAxisd(yaw_deg * kDeg, Eigen::Vector3d::UnitZ()) *
                              Eigen::AngleAxisd(pitch_deg * kDeg, Eigen::Vector3d::UnitY()))
                                 .toRotationMatrix();
  }
  std::vector<LidarPoint> scan(const Eigen::Isometry3d& T_world_base, const std::vector<forest::Stem>& stems,
                               std::mt19937& rng, double sigma_m = 0.0116) const {
    std::normal_distribution<double> noise(0, sigma_m);
    const Eigen::Isometry3d T = T_world_base * T_base_sensor;
    std::vector<LidarPoint> points;
    for (int i = 0; i <= 810; ++i) {
      const double bearing = (i / 3.0 - 135) * kDeg;
      const Eigen::Vector3d beam(std::cos(bearing), std::sin(bearing), 0), u = T.linear() * beam;
      double range = u.z() < 0 ? -T.translation().z() / u.z() : 1e9;
      const double flat2 = u.head<2>().squaredNorm();
      for (const forest::Stem& s : stems) {
        const Eigen::Vector2d to(s.x_m - T.translation().x(), s.y_m - T.translation().y());
        const double along = to.dot(u.head<2>());
        if (along <= 0) continue;
        const double d = along * along - flat2 * (to.squaredNorm() - s.radius_m * s.radius_m);
        if (d > 0) range = std::min(range, (along - std::sqrt(d)) / flat2);
      }
      LidarPoint p{};
      const double r = range < 25 ? range + noise(rng) : std::numeric_limits<double>::quiet_NaN();
      p.x_m = static_cast<float>(r * beam.x()), p.y_m = static_cast<float>(r * beam.y());
      points.push_back(p);
    }
    return points;
  }
};

TEST(LevelScan, MakesCirclesOfStemsAndLeavesOutGroundAndCrane) {
  const TiltedScanner scanner(2.8, 0.85, 2.6, 12, 45);
  ScannerMount mount;
  mount.T_base_sensor = {2.8, 0.85, 45 * kDeg};
  mount.height_m = 2.6, mount.pitch_rad = 12 * kDeg, mount.lowest_m = 0.7;
  LevelScan level(mount, {});
  const std::vector<forest::Stem> stems{{7, 4, 0.2}, {9, -1, 0.15}, {0, 7, 0.18}};
  std::mt19937 rng(1);
  const auto points = scanner.scan(Eigen::Isometry3d::Identity(), stems, rng, 0);
  const auto count = [&](const IgnoredStrip* strip) {
    std::array<int, 3> hits{};
    for (const LidarPoint& p : level.level(points, strip)) {
      if (!std::isfinite(p.x_m)) continue;
      const double c = std::cos(45 * kDeg), s = std::sin(45 * kDeg);
      const double x = 2.8 + c * p.x_m - s * p.y_m, y = 0.85 + s * p.x_m + c * p.y_m;
      double least = 1e9;
      std::size_t which = 0;
      for (std::size_t i = 0; i < stems.size(); ++i) {
        const double off = std::abs(std::hypot(x - stems[i].x_m, y - stems[i].y_m) - stems[i].radius_m);
        if (off < least) least = off, which = i;
      }
      EXPECT_LT(least, 1e-5) << "neither ground nor anything else, and on the circle";
      ++hits[which];
    }
    return hits;
  };
  const auto all = count(nullptr);
  for (const int n : all) EXPECT_GE(n, 4);
  const IgnoredStrip strip{3.6, 0, 6.8, 3.8, 0.6};  // the crane over the first stem
  const auto fewer = count(&strip);
  EXPECT_EQ(fewer[0], 0);
  EXPECT_EQ(fewer[1], all[1]);
  EXPECT_EQ(fewer[2], all[2]);
}

constexpr const char* kKeys = R"(
scanners:
  - { channel: left, T_base_sensor: { position_m: [2.8, 0.85], height_m: 2.6, pitch_deg: 12, yaw_deg: 45 }, lowest_m: 0.7,
      step_deg: 0.33333333, range_sigma_mm: 11.6 }
  - { channel: right, T_base_sensor: { position_m: [2.8, -0.85], height_m: 2.6, pitch_deg: 12, yaw_deg: -45 }, lowest_m: 0.7,
      step_deg: 0.33333333, range_sigma_mm: 11.6 }
odometry: { channel: machine, wheel_radius_m: 0.7, wheelbase_m: 4.0 }
start: { position_m: [-6, 0], yaw_deg: 0, sigma_m: 0.3, sigma_deg: 5 }
guide: marked
marked: { along_path: true }
drive: { sink: drive, rate_hz: 20, speed_mps: 1, lookahead_m: 2.5, steering: { wheelbase_m: 4.0, max_deg: 35 } }
crane: { sinks: [crane, head], channels: [machine, head_state], foot_m: [3.6, 0, 2.0], boom_m: 4.2, stick_m: 3.6, head_m: 0.9,
  slew_deg: [-110, 110], boom_deg: [-10, 74], stick_deg: [-137, -12], telescope_m: [0, 2.4],
  rest: { slew_deg: 0, boom_deg: 60, stick_deg: -130, telescope_m: 0 } }
estimate: { sink: estimate, rate_hz: 20 }
)";

/// The machine in its stand, and the application at its ports.
class HarvesterLoop {
 public:
  explicit HarvesterLoop(const std::vector<forest::Stem>& stand) : stand_(stand) {
    std::vector<rigor::Stem> stems;
    for (std::size_t i = 0; i < stand.size(); ++i) stems.push_back({i, stand[i].x_m, stand[i].y_m, 0});
    machine_.emplace(HarvesterConfig{}, PlatformStart{.x_m = -4, .y_m = 0}, Ground(), stems);
    machine_->start(BenchTime(0));
    machine_channel_.description.names = {"wheel_angle", "steer", "slew", "boom", "stick", "telescope"};
    head_channel_.description.names = {"felled"};
    ApplicationPorts ports;
    for (auto& [name, channel] : {std::pair<const char*, FakeChannel*>{"left", &left_},
                                  {"right", &right_},
                                  {"machine", &machine_channel_},
                                  {"head_state", &head_channel_}})
      ports.inputs[name] = {name, &channel->description, &channel->port};
    for (CommandPort* p : {&drive_port_, &crane_port_, &head_port_, &estimate_port_})
      ports.outputs[p->name()] = p;
    const auto dir = std::filesystem::temp_directory_path() / ("crane-" + std::to_string(getpid()));
    std::filesystem::create_directories(dir);
    std::ofstream map(dir / "stems.csv");
    map << "x_m,y_m,diameter_m,fell\n";
    for (const forest::Stem& s : stand)
      map << s.x_m << "," << s.y_m << "," << 2 * s.radius_m << "," << (s.fell ? "true" : "false") << "\n";
    map.close();
    std::ofstream way(dir / "way.csv");
    way << "x_m,y_m\n-6,0\n30,0\n";
    way.close();
    application_ = make_forest_localization();
    auto document =
        ConfigDocument::parse(std::string(kKeys) + "map: { file: " + (dir / "stems.csv").string() +
                              ", sigma_m: 0.01 }\npath: { file: " + (dir / "way.csv").string() + " }\n");
    EXPECT_TRUE(document.has_value());
    const Status s = application_->configure(*document, ports, milliseconds(10));
    EXPECT_TRUE(s.has_value()) << (s ? "" : s.error().text());
    std::filesystem::remove_all(dir);
    good_ = s.has_value();
  }

  /// Until it is at the end of its way, or for so long.
  void run(double most_s) {
    std::mt19937 rng(5);
    std::size_t seen = 0;
    for (std::uint64_t k = 0; good_ && !done && static_cast<double>(k) * 0.01 < most_s; ++k) {
      const BenchTime t = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(k);
      if (k % 2 == 0) {
        tell(machine_channel_, t);
        tell(head_channel_, t);
      }
      const Eigen::Isometry3d T_world_base = base(t);
      // A scanner and, half a period later, the other.
      if (k % 8 == 0) push(left_, scanner_left_, T_world_base, t, rng);
      if (k % 8 == 4) push(right_, scanner_right_, T_world_base, t, rng);
      for (FakeChannel* c : {&left_, &right_, &machine_channel_, &head_channel_}) c->port.advance(t, true);
      test::watching = true;
      application_->step(k, t);
      test::watching = false;
      allocations += test::allocations;
      test::allocations = 0;
      for (FakeSink* sink : {&drive_, &crane_, &head_}) {
        if (sink->count == taken_[sink]) continue;
        taken_[sink] = sink->count;
        for (std::size_t i = 0; i < sink->describe().names.size(); ++i)
          EXPECT_TRUE(machine_->write(signal(*machine_, sink->describe().names[i]), sink->last.value[i],
                                      t + milliseconds(10)));
      }
      if (estimate_.count != seen && t > BenchTime(0) + seconds(1)) {
        seen = estimate_.count;
        const auto& v = estimate_.last.value;
        error_m.push_back(
            std::hypot(v[0] - T_world_base.translation().x(), v[1] - T_world_base.translation().y()));
        cut = static_cast<int>(v[3]);
        out_of_reach = static_cast<int>(v[4]);
        done = v[2] == 1 && T_world_base.translation().x() > 29;
      }
      const auto fellings = machine_->fellings();
      while (standing_at_cut.size() < fellings.size())
        standing_at_cut.push_back({fellings[standing_at_cut.size()].node, T_world_base});
    }
  }
  [[nodiscard]] std::span<const Felling> fellings() const { return machine_->fellings(); }

  std::vector<double> error_m;
  /// Which stem fell, and where the base was then.
  std::vector<std::pair<std::uint64_t, Eigen::Isometry3d>> standing_at_cut;
  int cut = 0, out_of_reach = 0;
  bool done = false;
  std::size_t allocations = 0;

 private:
  [[nodiscard]] Eigen::Isometry3d base(BenchTime t) const {
    return isometry_of(machine_->motion_at(t).body.T_world_body) * Eigen::Translation3d(-2, 0, 0);
  }
  void tell(FakeChannel& channel, BenchTime t) {
    RegisterBlock block;
    for (const std::string& name : channel.description.names)
      block.value[block.count++] = machine_->read(signal(*machine_, name), t);
    channel.push(t, block);
  }
  void push(FakeChannel& channel, const TiltedScanner& scanner, const Eigen::Isometry3d& T_world_base,
            BenchTime t, std::mt19937& rng) {
    std::vector<forest::Stem> standing;
    for (std::size_t i = 0; i < stand_.size(); ++i) {
      const auto cut_down = fellings();
      if (std::none_of(cut_down.begin(), cut_down.end(), [&](const Felling& f) { return f.node == i; }))
        standing.push_back(stand_[i]);
    }
    const auto points = scanner.scan(T_world_base, standing, rng);
    channel.push(t, PointCloudInfo{static_cast<std::uint32_t>(points.size())}, points);
  }

  std::vector<forest::Stem> stand_;
  std::optional<Harvester> machine_;
  TiltedScanner scanner_left_{2.8, 0.85, 2.6, 12, 45}, scanner_right_{2.8, -0.85, 2.6, 12, -45};
  FakeChannel left_{SampleKind::point_cloud, milliseconds(80), milliseconds(100), 900 * sizeof(LidarPoint)};
  FakeChannel right_{SampleKind::point_cloud, milliseconds(80), milliseconds(100), 900 * sizeof(LidarPoint)};
  FakeChannel machine_channel_{SampleKind::register_block, milliseconds(20), milliseconds(5), 1};
  FakeChannel head_channel_{SampleKind::register_block, milliseconds(20), milliseconds(20), 1};
  FakeSink drive_{{"v", "steer_to"}}, crane_{{"slew_to", "boom_to", "stick_to", "telescope_to"}},
      head_{{"rotate_to", "grip_to", "fell"}}, estimate_{{"x", "y", "done", "cut", "out_of_reach"}};
  CommandPort drive_port_{"drive", drive_, milliseconds(10)}, crane_port_{"crane", crane_, milliseconds(10)},
      head_port_{"head", head_, milliseconds(10)}, estimate_port_{"estimate", estimate_, milliseconds(0)};
  std::map<FakeSink*, std::uint64_t> taken_;
  std::unique_ptr<Application> application_;
  bool good_ = false;
};

TEST(HarvesterLoop, GoesToEachMarkedStemWithinTheCranesReachAndCutsIt) {
  std::mt19937 rng(8);
  std::uniform_real_distribution<double> x(-12, 40), y(-14, 14), radius(0.1, 0.2);
  std::vector<forest::Stem> stand{
      {6, 5, 0.15, true}, {13, -4.5, 0.12, true}, {20, 5.5, 0.14, true}, {16, 13, 0.15, true}};
  while (stand.size() < 70) {
    const forest::Stem s{x(rng), y(rng), radius(rng)};
    if (std::abs(s.y_m) < 2.3 || std::any_of(stand.begin(), stand.end(), [&](const forest::Stem& o) {
          return std::hypot(o.x_m - s.x_m, o.y_m - s.y_m) < 1.8;
        }))
      continue;
    stand.push_back(s);
  }
  HarvesterLoop loop(stand);
  loop.run(300);
  EXPECT_TRUE(loop.done);
  EXPECT_EQ(loop.cut, 3);
  EXPECT_EQ(loop.out_of_reach, 1) << "the one 13 m beside the road";
  ASSERT_EQ(loop.standing_at_cut.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    const auto& [node, T_world_base] = loop.standing_at_cut[i];
    EXPECT_EQ(node, i) << "in the order of the way, and nothing else";
    const Eigen::Vector3d p = T_world_base.inverse() * Eigen::Vector3d(stand[node].x_m, stand[node].y_m, 0);
    EXPECT_TRUE(angles_for(geometry(-2), {p.x(), p.y(), 0.4})) << p.transpose();
    // It falls away from the machine.
    const Eigen::Vector3d along = T_world_base.linear() * (p - Eigen::Vector3d(3.6, 0, 0));
    EXPECT_NEAR(std::remainder(loop.fellings()[i].yaw_rad - std::atan2(along.y(), along.x()), 2 * kPi), 0,
                0.05);
  }
  std::sort(loop.error_m.begin(), loop.error_m.end());
  const auto quantile = [&](double q) {
    return loop.error_m[static_cast<std::size_t>(q * static_cast<double>(loop.error_m.size() - 1))];
  };
  std::printf("three stems: error median %.1f, p95 %.1f, worst %.1f mm\n", 1e3 * quantile(0.5),
              1e3 * quantile(0.95), 1e3 * quantile(1));
  EXPECT_LT(quantile(0.95), 0.05);
  EXPECT_EQ(loop.allocations, 0u);
}

}  // namespace
}  // namespace rigor::forest

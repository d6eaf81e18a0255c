// The skid-steer robot against closed forms, its limits, and its past.
#include "sim/platform/skid_steer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/platform/platform_yaml.h"
#include "sim/world/pose.h"
#include "tests/paths.h"

namespace rigor {
namespace {

constexpr double kPi = std::numbers::pi;

/// z = level + x·slope_x + y·slope_y.
class Plane final : public render::GroundHeights {
 public:
  Plane(double slope_x, double slope_y) : slope_x_(slope_x), slope_y_(slope_y) {}
  double height_at(double x, double y) const override {
    return std::abs(x) > 1000 ? std::nan("") : 3 + slope_x_ * x + slope_y_ * y;
  }
  Eigen::Vector3d normal_at(double, double) const override {
    return Eigen::Vector3d(-slope_x_, -slope_y_, 1).normalized();
  }

 private:
  double slope_x_, slope_y_;
};
Ground plane(double slope_x, double slope_y) { return Ground(std::make_shared<Plane>(slope_x, slope_y)); }

/// Waves, so that everything changes all the time.
class Waves final : public render::GroundHeights {
 public:
  double height_at(double x, double y) const override { return 0.3 * std::sin(0.7 * x) * std::cos(0.5 * y); }
  Eigen::Vector3d normal_at(double, double) const override { return Eigen::Vector3d::UnitZ(); }
};

/// Neither slip nor droop: the wheels roll as gears do.
SkidSteerConfig ideal() {
  SkidSteerConfig c;
  c.slip = c.slip_per_slope = c.droop_s = c.sideslip = c.icr_x_per_slope_m = 0;
  c.time_constant_s = 0.05;
  c.max_speed_mps = 10;
  c.acceleration_mps2 = c.braking_mps2 = 2;
  return c;
}

std::size_t signal(const Platform& p, const std::string& name) {
  for (std::size_t i = 0; i < p.signals().size(); ++i)
    if (p.signals()[i].name == name) return i;
  ADD_FAILURE() << "no signal " << name;
  return 0;
}
void tell(Platform& p, const std::string& name, double value, BenchTime t) {
  EXPECT_TRUE(p.write(signal(p, name), value, t)) << name;
}
double ask(Platform& p, const std::string& name, BenchTime t) { return p.read(signal(p, name), t); }
BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }
Eigen::Vector3d position(const BodyState& b) {
  const auto& p = b.T_world_body.position_m;
  return {p[0], p[1], p[2]};
}
Eigen::Matrix3d rotation(const Pose& pose) { return isometry_of(pose).linear(); }

TEST(SkidSteer, DrivesStraightAsItsRampAndTimeConstantSay) {
  SkidSteer robot(ideal(), {.x_m = 1, .y_m = 2, .yaw_rad = kPi / 3}, Ground(0.5));
  robot.start(at(0));
  tell(robot, "v", 1, at(0));
  // The ramp reaches 1 m/s after 0.5 s; the lag of 50 ms behind it is the same for ever: 1·(t − 0.25 − 0.05).
  const double t = 10, way = t - 0.25 - 0.05;
  const BodyState b = robot.motion_at(at(t)).body;
  EXPECT_NEAR(position(b).x(), 1 + way * std::cos(kPi / 3), 2e-3);
  EXPECT_NEAR(position(b).y(), 2 + way * std::sin(kPi / 3), 2e-3);
  EXPECT_DOUBLE_EQ(position(b).z(), 0.5);
  EXPECT_NEAR(std::hypot(b.velocity_mps[0], b.velocity_mps[1]), 1, 1e-9);
  EXPECT_NEAR(ask(robot, "left_angle", at(t)), way / 0.2, 1e-2);
  EXPECT_EQ(ask(robot, "left_angle", at(t)), ask(robot, "right_angle", at(t)));
}

TEST(SkidSteer, TurnsAboutTheInstantaneousCentreOfRotation) {
  SkidSteerConfig c = ideal();
  c.icr_ratio = 1.7;
  c.icr_x_m = 0.15;
  SkidSteer robot(c, {}, Ground());
  robot.start(at(0));
  tell(robot, "left", 3, at(0));
  tell(robot, "right", 5, at(0));
  // Radius of the way of the middle between the centres of the sides: v / w.
  const double left = 3 * 0.2, right = 5 * 0.2, w = (right - left) / (c.track_m * c.icr_ratio);
  const double radius = (right + left) / 2 / w;
  const BodyState b = robot.motion_at(at(20)).body;
  EXPECT_NEAR(b.turn_rate_radps[2], w, 1e-9);
  // The centre: at −x, radius in the robot's axes. It stays where it is.
  const auto centre = [&](double t) {
    const BodyState s = robot.motion_at(at(t)).body;
    return Eigen::Vector3d(position(s) + rotation(s.T_world_body) * Eigen::Vector3d(c.icr_x_m, radius, 0));
  };
  for (const double t : {5.0, 9.0, 13.7, 31.0}) EXPECT_LT((centre(t) - centre(4)).norm(), 1e-4) << t;
  // And a full turn takes 2π/w.
  const double turn_s = 2 * kPi / w;
  EXPECT_LT((position(robot.motion_at(at(5 + turn_s)).body) - position(robot.motion_at(at(5)).body)).norm(),
            1e-4);
}

TEST(SkidSteer, ControllerTurnsAsToldWhereTheSoilIsAsItBelieves) {
  SkidSteerConfig c = ideal();
  c.icr_ratio = 1.5;
  for (const double believed : {1.5, 1.0}) {
    c.effective_track_m = c.track_m * believed;
    SkidSteer robot(c, {}, Ground());
    robot.start(at(0));
    tell(robot, "v", 0.5, at(0));
    tell(robot, "w", 0.4, at(0));
    EXPECT_NEAR(robot.motion_at(at(10)).body.turn_rate_radps[2], 0.4 * believed / 1.5, 1e-9);
  }
}

TEST(SkidSteer, StandsOnASlopeAsThePlaneUnderItsWheelsDoes) {
  const double slope_x = 0.2, slope_y = -0.1;
  for (const double yaw : {0.0, 0.7, 2.5}) {
    SkidSteer robot(ideal(), {.x_m = 10, .y_m = 5, .yaw_rad = yaw}, plane(slope_x, slope_y));
    robot.start(at(0));
    tell(robot, "v", 0.8, at(0));
    for (const double t : {0.0, 3.0, 8.123}) {
      const BodyState b = robot.motion_at(at(t)).body;
      const Eigen::Vector3d up = rotation(b.T_world_body).col(2);
      EXPECT_LT((up - Eigen::Vector3d(-slope_x, -slope_y, 1).normalized()).norm(), 1e-9) << t;
      const Eigen::Vector3d p = position(b);
      EXPECT_NEAR(p.z(), 3 + slope_x * p.x() + slope_y * p.y(), 1e-6) << t;
    }
    // It goes along the plane at its speed, not through it and not beside its heading.
    const BodyState b = robot.motion_at(at(8)).body;
    const Eigen::Vector3d v(b.velocity_mps[0], b.velocity_mps[1], b.velocity_mps[2]);
    EXPECT_LT((v - 0.8 * rotation(b.T_world_body).col(0)).norm(), 1e-6);
  }
}

TEST(SkidSteer, LosesSpeedUphillAndSlipsMore) {
  SkidSteerConfig c = ideal();
  c.droop_s = 0.05;
  c.slip_per_slope = 0.4;
  c.slip = 0.02;
  const double slope = 0.25, sine = slope / std::hypot(1, slope);
  for (const double way : {0.0, kPi}) {  // uphill, downhill
    SkidSteer robot(c, {.yaw_rad = way}, plane(slope, 0));
    robot.start(at(0));
    tell(robot, "v", 0.6, at(0));
    const double s = way == 0 ? sine : -sine;
    const double rim = 0.6 - 0.05 * 9.80665 * s;
    EXPECT_NEAR(ask(robot, "left_rate", at(8)) * c.wheel_radius_m, rim, 1e-6);
    EXPECT_NEAR(ask(robot, "velocity_mps", at(8)), rim * (1 - 0.02 - 0.4 * s), 1e-6);
  }
}

TEST(SkidSteer, KeepsItsLimits) {
  SkidSteerConfig c = ideal();
  c.max_speed_mps = 1.2;
  c.max_turn_radps = 1.0;
  SkidSteer robot(c, {}, Ground());
  robot.start(at(0));
  tell(robot, "v", 5, at(0));
  double last = 0;
  for (int k = 1; k <= 1000; ++k) {
    const double rim = ask(robot, "left_rate", at(0.002 * k)) * c.wheel_radius_m;
    EXPECT_LE(rim, 1.2 + 1e-12);
    EXPECT_LE(rim - last, c.acceleration_mps2 * 0.002 * (1 + 1e-9));
    last = rim;
  }
  EXPECT_NEAR(last, 1.2, 1e-6);
  EXPECT_EQ(static_cast<int>(ask(robot, "status", at(2))) & 4, 4);
  // Both sides give way alike, so that the curve is kept.
  tell(robot, "w", 1.0, at(2));
  const double left = ask(robot, "left_rate", at(6)), right = ask(robot, "right_rate", at(6));
  const double side = 1.0 * c.track_m * c.icr_ratio / 2;
  EXPECT_NEAR(right * c.wheel_radius_m, 1.2, 1e-9);
  EXPECT_NEAR(left / right, (1.2 - side) / (1.2 + side), 1e-9);
  // Less than the dead band is nothing.
  tell(robot, "w", 0, at(6));
  tell(robot, "v", 0.009, at(6));
  EXPECT_EQ(ask(robot, "left_rate", at(10)), 0);
  EXPECT_EQ(static_cast<int>(ask(robot, "status", at(10))), 1);
}

TEST(SkidSteer, StopsWithAFaultWhereItTipsOrLeavesTheTerrain) {
  SkidSteerConfig c = ideal();
  c.tip_pitch_rad = 0.2;
  SkidSteer tilted(c, {}, plane(0.25, 0));
  tilted.start(at(0));
  tell(tilted, "v", 1, at(0));
  EXPECT_EQ(ask(tilted, "fault", at(2)), 1);
  EXPECT_EQ(static_cast<int>(ask(tilted, "status", at(2))) & 9, 8);
  EXPECT_NEAR(ask(tilted, "velocity_mps", at(2)), 0, 1e-6);

  SkidSteer lost(ideal(), {.x_m = 998}, plane(0, 0));
  lost.start(at(0));
  tell(lost, "v", 1, at(0));
  EXPECT_EQ(ask(lost, "fault", at(6)), 2);
  const double x = ask(lost, "x_m", at(6));
  EXPECT_LT(x, 1000.5);
  EXPECT_EQ(ask(lost, "x_m", at(9)), x);
  EXPECT_NEAR(ask(lost, "z_m", at(9)), 3, 1e-9);
  // Told `enable` 0 and back, it is driven out again.
  tell(lost, "v", -1, at(9));
  tell(lost, "enable", 0, at(9));
  tell(lost, "enable", 1, at(9.1));
  EXPECT_LT(ask(lost, "x_m", at(12)), x - 0.2);
}

TEST(SkidSteer, StandsStillWithoutCommandsForTooLong) {
  SkidSteerConfig c = ideal();
  c.command_timeout_s = 0.5;
  SkidSteer robot(c, {}, Ground());
  robot.start(at(0));
  for (int k = 0; k < 10; ++k) tell(robot, "v", 0.5, at(0.3 * k));
  EXPECT_NEAR(ask(robot, "velocity_mps", at(3.1)), 0.5, 1e-3);
  EXPECT_NEAR(ask(robot, "velocity_mps", at(5)), 0, 1e-6);
}

TEST(SkidSteer, SlipsInEventsOfItsSeed) {
  SkidSteerConfig c = ideal();
  c.slip_events_per_s = 0.3;
  std::array<double, 3> end{};
  for (const int i : {0, 1, 2}) {
    SkidSteer robot(c, {.seed = i == 2 ? 8u : 7u}, Ground());
    robot.start(at(0));
    tell(robot, "v", 0.5, at(0));
    end[static_cast<std::size_t>(i)] = ask(robot, "x_m", at(60));
    // Wheels and ground disagree.
    EXPECT_GT(ask(robot, "left_angle", at(60)) * c.wheel_radius_m - end[static_cast<std::size_t>(i)], 0.1);
  }
  EXPECT_EQ(end[0], end[1]);
  EXPECT_NE(end[0], end[2]);
}

TEST(SkidSteer, SaysOfEachInstantTheSameBeforeAndAfterwards) {
  SkidSteerConfig c;
  c.slip_events_per_s = 0.2;
  SkidSteer live(c, {.seed = 3}, Ground(std::make_shared<Waves>())),
      late(c, {.seed = 3}, Ground(std::make_shared<Waves>()));
  live.start(at(0));
  late.start(at(0));
  struct Moment {
    BenchTime t;
    PlatformMotion m;
  };
  std::vector<Moment> seen;
  for (int k = 0; k < 1500; ++k) {
    const BenchTime t = at(0.0107 * k);
    if (k % 7 == 0)
      for (SkidSteer* robot : {&live, &late}) {
        tell(*robot, "v", 0.6 + 0.4 * std::sin(0.3 * k), t);
        tell(*robot, "w", 0.7 * std::cos(0.11 * k), t);
      }
    seen.push_back({t, live.motion_at(t)});
    (void)ask(live, "x_m", t);  // how often it is asked changes nothing
  }
  const auto equal = [](const PlatformMotion& a, const PlatformMotion& b) {
    return a.body.T_world_body.position_m == b.body.T_world_body.position_m &&
           a.body.T_world_body.orientation_wxyz == b.body.T_world_body.orientation_wxyz &&
           a.body.velocity_mps == b.body.velocity_mps && a.joint[0].position_rad == b.joint[0].position_rad;
  };
  for (auto m = seen.rbegin(); m != seen.rend(); ++m) {
    EXPECT_TRUE(equal(live.motion_at(m->t), m->m)) << m->t.ns();
    EXPECT_TRUE(equal(late.motion_at(m->t), m->m)) << m->t.ns();
  }
}

TEST(SkidSteer, CommandsTakeEffectAtTheirInstantWhenTheyAreToldLater) {
  SkidSteer early(ideal(), {}, Ground()), late(ideal(), {}, Ground());
  early.start(at(0));
  late.start(at(0));
  tell(early, "v", 0.5, at(0.5));
  (void)ask(early, "x_m", at(1));
  // As a sink's thread that got to it a little late: the model is told the command's own instant.
  (void)ask(late, "x_m", at(0.4999));
  tell(late, "v", 0.5, at(0.5));
  EXPECT_EQ(ask(early, "x_m", at(3)), ask(late, "x_m", at(3)));
}

TEST(SkidSteer, VelocityAccelerationAndTurnRateBelongToItsWay) {
  SkidSteer robot(SkidSteerConfig{}, {.yaw_rad = 0.3}, Ground(std::make_shared<Waves>()));
  robot.start(at(0));
  tell(robot, "v", 0.9, at(0));
  tell(robot, "w", 0.5, at(1));
  const double h = 1e-5;
  for (int k = 1; k < 300; ++k) {
    const double t = 0.0237 * k + 1e-3 / 3;  // within a step
    const BodyState b = robot.motion_at(at(t)).body;
    const BodyState before = robot.motion_at(at(t - h)).body, after = robot.motion_at(at(t + h)).body;
    const Eigen::Vector3d v = (position(after) - position(before)) / (2 * h);
    EXPECT_LT((v - Eigen::Vector3d(b.velocity_mps.data())).norm(), 1e-8) << t;
    const Eigen::Vector3d a =
        (Eigen::Vector3d(after.velocity_mps.data()) - Eigen::Vector3d(before.velocity_mps.data())) / (2 * h);
    EXPECT_LT((a - Eigen::Vector3d(b.acceleration_mps2.data())).norm(), 1e-6) << t;
    const Eigen::AngleAxisd turn(rotation(before.T_world_body).transpose() * rotation(after.T_world_body));
    EXPECT_LT((turn.axis() * turn.angle() / (2 * h) - Eigen::Vector3d(b.turn_rate_radps.data())).norm(), 1e-6)
        << t;
    const Eigen::Vector3d turn_acceleration =
        (Eigen::Vector3d(after.turn_rate_radps.data()) - Eigen::Vector3d(before.turn_rate_radps.data())) /
        (2 * h);
    EXPECT_LT((turn_acceleration - Eigen::Vector3d(b.turn_acceleration_radps2.data())).norm(), 1e-3) << t;
  }
}

TEST(SkidSteer, IsKnownByItsRegisters) {
  SkidSteer robot(ideal(), {.x_m = -2}, Ground());
  robot.start(at(0));
  // v is the second commanded signal: holding registers 2 and 3, in mm/s.
  const std::array<std::uint16_t, 2> half{0, 500};
  ASSERT_TRUE(robot.write(RegisterTable::holding_registers, 2, half, at(0)));
  EXPECT_EQ(ask(robot, "v", at(0)), 0.5);
  std::array<std::uint16_t, 2> words{};
  ASSERT_TRUE(robot.read(RegisterTable::holding_registers, 2, words, at(1)));
  EXPECT_EQ(words, half);
  // x_m is the eighth told: input registers 14 and 15, in 0.1 mm.
  ASSERT_TRUE(robot.read(RegisterTable::input_registers, 14, words, at(1)));
  const auto raw = static_cast<std::int32_t>(std::uint32_t{words[0]} << 16 | words[1]);
  EXPECT_NEAR(raw * 1e-4, ask(robot, "x_m", at(1)), 0.51e-4);
  EXPECT_FALSE(robot.read(RegisterTable::input_registers, 30, words, at(1)));
  EXPECT_FALSE(robot.write(RegisterTable::holding_registers, 9, half, at(1)));
}

TEST(SkidSteer, PlatformModelIsRead) {
  const auto platform_model = load_skid_steer(rigor::test::source_dir() + "/configs/platforms/seekurjr.yaml");
  ASSERT_TRUE(platform_model) << platform_model.error().text();
  EXPECT_EQ(platform_model->length_m, 1.2);
  EXPECT_NEAR(platform_model->max_turn_radps, 80 * kPi / 180, 1e-12);
  EXPECT_EQ(platform_model->time_constant_s, 0.08);
}

}  // namespace
}  // namespace rigor

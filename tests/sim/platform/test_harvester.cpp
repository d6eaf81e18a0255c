// The harvester's base, crane and felling head.
#include "sim/platform/harvester.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/platform/platform_yaml.h"
#include "sim/world/pose.h"
#include "tests/paths.h"

namespace rigor {
namespace {

constexpr double kPi = std::numbers::pi, kDeg = kPi / 180;
using C = HarvesterConfig;

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

TEST(Harvester, DrivesACircleOfItsSteeringAngle) {
  C c;
  c.slip = 0;
  Harvester machine(c, {.x_m = 3}, Ground(), {});
  machine.start(at(0));
  tell(machine, "v", 1.5, at(0));
  tell(machine, "steer_to", 20, at(0));
  const double radius = c.wheelbase_m / std::tan(20 * kDeg);  // of the rear axle's middle
  const auto centre = [&](double t) {
    return Eigen::Vector3d(isometry_of(machine.motion_at(at(t)).body.T_world_body) *
                           Eigen::Vector3d(-c.wheelbase_m / 2, radius, 0));
  };
  EXPECT_NEAR(machine.motion_at(at(20)).body.turn_rate_radps[2], 1.5 / radius, 1e-9);
  for (const double t : {9.0, 17.0, 60.0}) EXPECT_LT((centre(t) - centre(8)).norm(), 1e-4) << t;
  EXPECT_NEAR(ask(machine, "wheel_rate", at(20)), 1.5 / c.wheel_radius_m, 1e-9);
}

TEST(Harvester, CraneReachesWhereItsJointsSay) {
  C c;
  Harvester machine(c, {.x_m = 10, .y_m = -4, .yaw_rad = 0.5}, Ground(2), {});
  machine.start(at(0));
  const double slew = 40 * kDeg, boom = 30 * kDeg, stick = -70 * kDeg, telescope = 1.2, rotate = -25 * kDeg;
  tell(machine, "slew_to", 40, at(0));
  tell(machine, "boom_to", 30, at(0));
  tell(machine, "stick_to", -70, at(0));
  tell(machine, "telescope_to", telescope, at(0));
  tell(machine, "rotate_to", -25, at(0));
  const BenchTime t = at(30);
  EXPECT_NEAR(ask(machine, "stick", t), -70, 1e-9);
  EXPECT_EQ(static_cast<int>(ask(machine, "status", t)), 1);
  const double out = c.boom_m * std::cos(boom) + (c.stick_m + telescope) * std::cos(boom + stick);
  const double up = c.boom_m * std::sin(boom) + (c.stick_m + telescope) * std::sin(boom + stick) - c.head_m;
  const Eigen::Vector3d in_machine =
      c.foot_m + Eigen::Vector3d(out * std::cos(slew), out * std::sin(slew), up);
  const Eigen::Vector3d expected =
      Eigen::Vector3d(10, -4, 2) + Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitZ()) * in_machine;
  const Eigen::Isometry3d head = machine.T_world_head(t);
  EXPECT_LT((head.translation() - expected).norm(), 1e-9);
  EXPECT_NEAR(std::atan2(head.linear()(1, 0), head.linear()(0, 0)), 0.5 + slew + rotate, 1e-9);
  EXPECT_NEAR(ask(machine, "head_z_m", t), expected.z(), 1e-9);
}

/// What is drawn and what sensors ride on is where the kinematics say.
TEST(Harvester, PartsMeetTheHeadsPose) {
  Harvester machine(C{}, {.x_m = 1, .y_m = 2, .yaw_rad = -0.8}, Ground(), {});
  machine.start(at(0));
  for (const auto& [name, value] : {std::pair{"slew_to", -60.0},
                                    {"boom_to", 10.0},
                                    {"stick_to", -40.0},
                                    {"telescope_to", 2.0},
                                    {"rotate_to", 70.0}})
    tell(machine, name, value, at(0));
  for (const double t : {0.0, 0.7, 1.9, 20.0}) {
    const PlatformMotion m = machine.motion_at(at(t));
    const auto parts = machine.parts();
    std::vector<Eigen::Isometry3d> pose;
    const Eigen::Isometry3d body = isometry_of(m.body.T_world_body);
    bool found = false;
    for (const PlatformPart& part : parts) {
      Eigen::Isometry3d T =
          (part.parent < 0 ? body : pose[static_cast<std::size_t>(part.parent)]) * part.T_parent_part;
      const double joint = part.joint < 0 ? 0 : m.joint[static_cast<std::size_t>(part.joint)].position_rad;
      if (part.moves == PlatformPart::Moves::turns) T.rotate(Eigen::AngleAxisd(joint, part.axis));
      if (part.moves == PlatformPart::Moves::slides) T.translate(part.axis * joint);
      pose.push_back(T);
      if (part.name != "head") continue;
      found = true;
      EXPECT_LT((T.matrix() - machine.T_world_head(at(t)).matrix()).norm(), 1e-9) << t;
    }
    EXPECT_TRUE(found);
  }
}

TEST(Harvester, CraneKeepsEndStopsRatesAndAccelerations) {
  C c;
  Harvester machine(c, {}, Ground(), {});
  machine.start(at(0));
  tell(machine, "slew_to", 500, at(0));
  const CraneAxis& slew = c.axis[C::kSlew];
  double last_rate = 0, last = ask(machine, "slew", at(0)) * kDeg;
  for (int k = 1; k < 900; ++k) {
    const double now = ask(machine, "slew", at(0.01 * k)) * kDeg, rate = (now - last) / 0.01;
    EXPECT_LE(now, slew.max + 1e-12);
    EXPECT_LE(std::abs(rate), slew.rate * (1 + 1e-9));
    EXPECT_LE(std::abs(rate - last_rate), slew.acceleration * 0.01 * (1 + 1e-6));
    last = now;
    last_rate = rate;
  }
  EXPECT_NEAR(last, slew.max, 1e-12);
  EXPECT_EQ(static_cast<int>(ask(machine, "status", at(9))) & 4, 4);
  // Trapezoid: way over rate, and one ramp.
  const double takes_s = slew.max / slew.rate + slew.rate / slew.acceleration;
  Harvester again(c, {}, Ground(), {});
  again.start(at(0));
  tell(again, "slew_to", slew.max / kDeg, at(0));
  EXPECT_GT(slew.max - ask(again, "slew", at(takes_s - 0.05)) * kDeg, 1e-5);
  EXPECT_NEAR(ask(again, "slew", at(takes_s + 0.001)) * kDeg, slew.max, 1e-12);
  // Told to stop on its way, it brakes and stays; enabled again it goes on.
  tell(again, "slew_to", 0, at(10));
  tell(again, "enable", 0, at(12));
  const double held = ask(again, "slew", at(14));
  EXPECT_GT(held, 1);
  EXPECT_EQ(ask(again, "slew", at(16)), held);
  tell(again, "enable", 1, at(16));
  EXPECT_NEAR(ask(again, "slew", at(30)), 0, 1e-9);
}

TEST(Harvester, FellsTheNearestStemWithinReachAndEachOnce) {
  C c;
  Harvester probe(c, {}, Ground(), {});
  const Eigen::Vector3d head = probe.T_world_head(at(0)).translation();
  const std::vector<Stem> stems{{11, head.x() + 0.4, head.y(), 0},
                                {12, head.x(), head.y() - 0.3, 0},
                                {13, head.x() - 0.1, head.y() + 0.1, head.z() - 5},  // far below the head
                                {14, head.x() + 3, head.y(), 0}};
  Harvester machine(c, {}, Ground(), stems);
  machine.start(at(0));
  // A register can say no NaN: zeros, and a count of zero, until there is something to tell.
  for (const char* value : {"felled", "felled_x_m", "felled_y_m", "felled_yaw_deg"})
    EXPECT_EQ(ask(machine, value, at(0.5)), 0) << value;
  const auto fell = [&](double t) {
    tell(machine, "fell", 1, at(t));
    tell(machine, "fell", 1, at(t + 0.1));  // no rise, no cut
    tell(machine, "fell", 0, at(t + 0.2));
  };
  fell(1);
  ASSERT_EQ(machine.fellings().size(), 1u);
  EXPECT_EQ(machine.fellings()[0].node, 12u);
  EXPECT_EQ(machine.fellings()[0].t, at(1));
  EXPECT_EQ(static_cast<int>(ask(machine, "status", at(1.5))) & 48, 16);
  fell(2);
  ASSERT_EQ(machine.fellings().size(), 2u);
  EXPECT_EQ(machine.fellings()[1].node, 11u);
  fell(3);
  EXPECT_EQ(machine.fellings().size(), 2u);
  EXPECT_EQ(static_cast<int>(ask(machine, "status", at(3.5))) & 48, 32);
  EXPECT_EQ(ask(machine, "felled", at(3.5)), 2);
  EXPECT_NEAR(ask(machine, "felled_x_m", at(3.5)), head.x(), 1e-9);
  EXPECT_NEAR(ask(machine, "felled_y_m", at(3.5)), head.y(), 1e-9);
  machine.start(at(10));
  EXPECT_TRUE(machine.fellings().empty());
}

TEST(Harvester, SaysOfEachInstantTheSameAfterwards) {
  Harvester machine(C{}, {}, Ground(), {});
  machine.start(at(0));
  std::vector<Eigen::Matrix4d> seen;
  for (int k = 0; k < 600; ++k) {
    const BenchTime t = at(0.0131 * k);
    if (k % 40 == 0) {
      tell(machine, "slew_to", 60 * std::sin(k), t);
      tell(machine, "boom_to", 40 + 20 * std::cos(k), t);
      tell(machine, "v", 0.5, t);
    }
    seen.push_back(machine.T_world_head(t).matrix());
  }
  for (int k = 599; k >= 0; --k)
    EXPECT_EQ(machine.T_world_head(at(0.0131 * k)).matrix(), seen[static_cast<std::size_t>(k)]) << k;
}

TEST(Harvester, PlatformModelIsRead) {
  const auto platform_model = load_harvester(rigor::test::source_dir() + "/configs/platforms/harvester.yaml");
  ASSERT_TRUE(platform_model) << platform_model.error().text();
  EXPECT_NEAR(platform_model->axis[C::kSlew].max, 110 * kDeg, 1e-12);
  EXPECT_EQ(platform_model->axis[C::kTelescope].max, 2.4);
  EXPECT_EQ(platform_model->cabin_x_m, -0.2);
}

}  // namespace
}  // namespace rigor

#include "sensor-hal/channel/typed_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sensor-hal/channel/stream_source.h"

namespace rigor {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kPi = std::numbers::pi;

std::vector<std::string> names_of(SampleKind kind) {
  std::vector<std::string> names;
  for (const ValueName& v : values_of_kind(kind)) names.emplace_back(v.name);
  return names;
}
RegisterBlock block_of(const std::vector<double>& values) {
  RegisterBlock b;
  b.count = static_cast<std::uint32_t>(values.size());
  std::copy(values.begin(), values.end(), b.value.begin());
  return b;
}
/// What a device tells of `sample`, taken back.
Sample there_and_back(const Sample& sample, SampleKind kind) {
  std::vector<double> values(values_of_kind(kind).size());
  values_of_sample(sample, values);
  auto typed = TypedValues::make(kind, names_of(kind), {});
  EXPECT_TRUE(typed);
  Sample out;
  EXPECT_TRUE(typed->convert(block_of(values), BenchTime(0), out));
  return out;
}

TEST(TypedValues, ComeBackAsTheyWereTold) {
  Sample s;
  ImuSample imu;
  imu.specific_force_mps2 = {1, -2, 9.8};
  imu.angular_rate_radps = {0.1, 0.2, -0.3};
  imu.temperature_c = 31;
  s.info = imu;
  const Sample m = there_and_back(s, SampleKind::imu);
  ASSERT_TRUE(m.as<ImuSample>());
  EXPECT_EQ(m.as<ImuSample>()->specific_force_mps2, imu.specific_force_mps2);
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_NEAR(m.as<ImuSample>()->angular_rate_radps[i], imu.angular_rate_radps[i], 1e-15);
  EXPECT_EQ(m.as<ImuSample>()->temperature_c, 31);

  NavFix fix;
  fix.status = FixStatus::rtk_float;
  fix.satellites = 9;
  fix.latitude_deg = 50.1, fix.longitude_deg = 6.2, fix.height_m = 300;
  fix.covariance_enu_m2 = {4, 0, 0, 0, 4, 0, 0, 0, 9};
  s.info = fix;
  const Sample f = there_and_back(s, SampleKind::nav_fix);
  ASSERT_TRUE(f.as<NavFix>());
  EXPECT_EQ(f.as<NavFix>()->status, FixStatus::rtk_float);
  EXPECT_EQ(f.as<NavFix>()->satellites, 9);
  EXPECT_EQ(f.as<NavFix>()->latitude_deg, 50.1);
  EXPECT_EQ(f.as<NavFix>()->longitude_deg, 6.2);
  EXPECT_EQ(f.as<NavFix>()->height_m, 300);
  EXPECT_EQ(f.as<NavFix>()->covariance_enu_m2, fix.covariance_enu_m2);

  Pose pose;
  pose.position_m = {1, 2, 3};
  pose.orientation_wxyz = {0.5, -0.5, 0.1, 0.7};  // made unit below
  double n = 0;
  for (const double q : pose.orientation_wxyz) n += q * q;
  for (double& q : pose.orientation_wxyz) q /= std::sqrt(n);
  s.info = pose;
  const Sample p = there_and_back(s, SampleKind::pose);
  ASSERT_TRUE(p.as<Pose>());
  EXPECT_EQ(p.as<Pose>()->position_m, pose.position_m);
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_NEAR(p.as<Pose>()->orientation_wxyz[i], pose.orientation_wxyz[i], 1e-14) << i;

  Odometry odometry;
  odometry.T_odom_base.position_m = {4, 5, 0};
  odometry.T_odom_base.orientation_wxyz = {std::cos(1), 0, 0, std::sin(1)};
  odometry.velocity_mps[0] = 0.6;
  odometry.turn_rate_radps[2] = 0.2;
  odometry.wheel_angle_rad = {7, 8};
  odometry.wheel_rate_radps = {3, 3.5};
  s.info = odometry;
  const Sample o = there_and_back(s, SampleKind::odometry);
  ASSERT_TRUE(o.as<Odometry>());
  EXPECT_EQ(o.as<Odometry>()->T_odom_base.position_m, odometry.T_odom_base.position_m);
  EXPECT_NEAR(o.as<Odometry>()->T_odom_base.orientation_wxyz[3], std::sin(1), 1e-15);
  EXPECT_EQ(o.as<Odometry>()->velocity_mps[0], 0.6);
  EXPECT_NEAR(o.as<Odometry>()->turn_rate_radps[2], 0.2, 1e-15);
  EXPECT_EQ(o.as<Odometry>()->wheel_angle_rad, odometry.wheel_angle_rad);
  EXPECT_EQ(o.as<Odometry>()->wheel_rate_radps, odometry.wheel_rate_radps);
}

TEST(TypedValues, AReceiverWithoutAFixTellsThatItHasNone) {
  Sample s;
  s.info = NavFix{};
  EXPECT_EQ(there_and_back(s, SampleKind::nav_fix).as<NavFix>()->status, FixStatus::none);
}

TEST(TypedValues, WheelAnglesAddUpToACircle) {
  // Half a circle of 2 m to the left in 40 steps: chords at the heading in their middle end on it exactly.
  const double radius_m = 2, track_m = 1.12, wheel_m = 0.2;
  auto typed = TypedValues::make(SampleKind::odometry, {"left_angle", "right_angle"}, {wheel_m, track_m});
  ASSERT_TRUE(typed);
  Sample out;
  for (int k = 0; k <= 40; ++k) {
    const double turn = kPi * k / 40;
    // An offset of the counters at the beginning is no way.
    const auto angle = [&](double side) { return 100 + turn * (radius_m + side * track_m / 2) / wheel_m; };
    ASSERT_TRUE(typed->convert(block_of({angle(-1), angle(+1)}), BenchTime(0) + milliseconds(20 * k), out));
  }
  const auto* o = out.as<Odometry>();
  ASSERT_TRUE(o);
  EXPECT_NEAR(o->T_odom_base.position_m[0], 0, 1e-12);
  EXPECT_NEAR(o->T_odom_base.position_m[1], 2 * radius_m, 1e-12);
  EXPECT_NEAR(std::abs(o->T_odom_base.orientation_wxyz[3]), 1, 1e-12);
  EXPECT_NEAR(o->turn_rate_radps[2], kPi / 40 / 0.02, 1e-9);
  EXPECT_NEAR(o->velocity_mps[0], radius_m * kPi / 40 / 0.02, 1e-9);
  typed->reset();
  ASSERT_TRUE(typed->convert(block_of({0, 0}), BenchTime(0), out));
  EXPECT_EQ(out.as<Odometry>()->T_odom_base.position_m[1], 0);
}

TEST(TypedValues, SayWhatIsMissing) {
  using testing::HasSubstr;
  EXPECT_THAT(TypedValues::make(SampleKind::imu, {"rate_x_degps", "rate_y_degps"}, {}).error().message,
              HasSubstr("force_x_mps2, force_y_mps2, force_z_mps2, rate_z_degps"));
  EXPECT_THAT(TypedValues::make(SampleKind::odometry, {"left_angle", "right_angle"}, {}).error().message,
              HasSubstr("`wheel_radius_m` and `track_m`"));
  EXPECT_THAT(TypedValues::make(SampleKind::odometry, {"speed"}, {}).error().message, HasSubstr("got speed"));
  EXPECT_FALSE(TypedValues::make(SampleKind::image, {"x_m"}, {}));
}

/// A bus whose device is the test.
class Bus final : public StreamSource {
 public:
  void tell(const std::vector<double>& values, std::uint32_t validity = kValid) {
    auto slot = take_slot();
    slot->stamp = {};
    slot->stamp.sequence = next_++;
    slot->stamp.t_capture = BenchTime(0) + milliseconds(static_cast<std::int64_t>(10 * next_));
    slot->stamp.validity = validity;
    slot->info = block_of(values);
    hand_over(std::move(slot));
  }
  SampleKind kind = SampleKind::none;  ///< that it was configured with

 protected:
  Status do_configure(const ChannelConfig& c) override {
    kind = c.kind;
    description_.kind = c.kind;
    description_.names = {"x_m", "y_m", "yaw_deg"};
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    open_stream(4, 0, context.virtual_time);
    return {};
  }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override {
    close_stream();
    return {};
  }

 private:
  std::uint64_t next_ = 0;
};

TEST(TypedSource, GivesTheSamplesOfItsSourceAsWhatTheyMean) {
  auto inner = std::make_unique<Bus>();
  Bus& bus = *inner;
  TypedSource source(std::move(inner));
  ChannelConfig config;
  config.name = "odometry";
  config.kind = SampleKind::odometry;
  config.params = *ConfigDocument::parse("{}", "rig.yaml");
  ASSERT_TRUE(source.configure(config));
  EXPECT_EQ(bus.kind, SampleKind::register_block);
  EXPECT_EQ(source.describe().kind, SampleKind::odometry);
  EXPECT_TRUE(source.describe().names.empty());
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  bus.tell({1, 2, 90});
  bus.tell({1, kNaN, 90});
  bus.tell({2, 3, 180}, kClockUnsure);
  const SampleLease first = source.poll(BenchTime(1));
  ASSERT_TRUE(first && first->as<Odometry>());
  EXPECT_EQ(first->as<Odometry>()->T_odom_base.position_m[1], 2);
  EXPECT_EQ(first->stamp.validity, kValid);
  EXPECT_EQ(first->stamp.t_capture, BenchTime(0) + milliseconds(10));
  const SampleLease second = source.poll(BenchTime(1));
  EXPECT_EQ(second->stamp.validity, kIncomplete);
  EXPECT_EQ(second->as<Odometry>()->T_odom_base.position_m[1], 2) << "the last that was known";
  EXPECT_EQ(source.poll(BenchTime(1))->stamp.validity, kClockUnsure);
  EXPECT_FALSE(source.poll(BenchTime(1)));
  EXPECT_EQ(source.health().received, 3u);
  EXPECT_EQ(source.health().incomplete, 1u);
  EXPECT_TRUE(source.stop());
}

}  // namespace
}  // namespace rigor

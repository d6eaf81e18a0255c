// What the `sensors` of an emulator in a rig give on a bus.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>

#include "bench/devices/device_sensors.h"

namespace rigor {
namespace {

/// A body that goes east at 2 m/s.
class Going final : public MotionSource {
 public:
  WorldMotion motion_at(BenchTime t) const noexcept override {
    WorldMotion m;
    m.body_count = 1;
    m.body[0].t_ref = t;
    m.body[0].T_world_body.position_m = {2e-9 * static_cast<double>(t.ns()), 0, 0};
    return m;
  }
};

/// Tells where the body is and how often it was asked, and by which index.
class Recording final : public SampleProvider {
 public:
  explicit Recording(SampleKind kind) : kind_(kind) {}
  Geometry geometry() const override { return {kind_, 0, 0, 0, "x"}; }
  Status capture(const Request& r, Sample& sample) override {
    ++captures;
    index.push_back(r.index);
    if (kind_ == SampleKind::odometry) {
      Odometry o;
      o.T_odom_base.position_m[0] = r.motion.body[0].T_world_body.position_m[0];
      sample.info = o;
    } else {
      ImuSample m;
      m.angular_rate_radps[2] = static_cast<double>(r.index);
      sample.info = m;
    }
    return {};
  }
  int captures = 0;
  std::vector<std::uint64_t> index;

 private:
  SampleKind kind_;
};

struct Device {
  std::shared_ptr<DeviceSensors> sensors;
  std::vector<std::shared_ptr<Recording>> providers;
};
Result<Device> make(const std::string& text) {
  const auto n = ConfigDocument::parse(text, "rig.yaml");
  EXPECT_TRUE(n);
  Device device;
  auto made = DeviceSensors::make(*n, "node", std::make_shared<Going>(),
                                  [&](SampleKind kind, const ConfigNode&, const std::string&,
                                      Duration) -> Result<std::shared_ptr<SampleProvider>> {
                                    device.providers.push_back(std::make_shared<Recording>(kind));
                                    return std::shared_ptr<SampleProvider>(device.providers.back());
                                  });
  if (!made) return tl::unexpected<Error>(made.error());
  device.sensors = *made;
  return device;
}
BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }
const char* const kBoth =
    "{sensors: {wheels: {kind: odometry, rate_hz: 50}, unit: {kind: imu, rate_hz: 100}}}";

TEST(DeviceSensors, AreMeasuredWhenTheyAreReadAndOnceForAllTheirValues) {
  auto d = make(kBoth);
  ASSERT_TRUE(d);
  const auto& signals = d->sensors->signals();
  ASSERT_EQ(signals.size(), 9u + 7u);
  EXPECT_EQ(signals[0].name, "x_m");
  EXPECT_EQ(signals[14].name, "rate_z_degps");
  EXPECT_EQ(d->sensors->read(std::size_t{0}, at(10)), 20);
  (void)d->sensors->read(std::size_t{2}, at(10));
  EXPECT_EQ(d->providers[0]->captures, 1);
  EXPECT_EQ(d->sensors->read(std::size_t{0}, at(10.5)), 21);
  EXPECT_EQ(d->providers[1]->captures, 0);
  EXPECT_TRUE(std::isnan(d->sensors->read(std::size_t{16}, at(11))));
}

TEST(DeviceSensors, GoOnInStepsOfTheirOwnRateFromTheFirstReadingOn) {
  auto d = make(kBoth);
  ASSERT_TRUE(d);
  for (const double t : {7.0, 7.0104, 7.0196, 7.5}) (void)d->sensors->read(std::size_t{14}, at(t));
  EXPECT_THAT(d->providers[1]->index, testing::ElementsAre(0u, 1u, 2u, 50u));
}

TEST(DeviceSensors, AreInputRegistersOfFourForAValue) {
  auto d = make(kBoth);
  ASSERT_TRUE(d);
  std::array<std::uint16_t, 8> words{};
  ASSERT_TRUE(d->sensors->read(RegisterTable::input_registers, 0, words, at(3)));
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < 4; ++i) bits = bits << 16 | words[i];
  EXPECT_EQ(std::bit_cast<double>(bits), 6);
  EXPECT_TRUE(d->sensors->read(RegisterTable::input_registers, 16 * 4 - 8, words, at(3)));
  EXPECT_FALSE(d->sensors->read(RegisterTable::input_registers, 16 * 4 - 7, words, at(3)));
  EXPECT_FALSE(d->sensors->read(RegisterTable::holding_registers, 0, words, at(3)));
  EXPECT_FALSE(d->sensors->write(RegisterTable::holding_registers, 0, words, at(3)));
}

TEST(DeviceSensors, ErrorsGiveThePlace) {
  using testing::HasSubstr;
  EXPECT_THAT(make("{sensors: {a: {kind: imu, rate_hz: 100}, b: {kind: imu, rate_hz: 100}}}").error().text(),
              HasSubstr("an emulator of its own"));
  EXPECT_THAT(make("{sensors: {a: {kind: image, rate_hz: 100}}}").error().text(),
              HasSubstr("sensors.a.kind: expected one of imu, nav_fix, odometry"));
  EXPECT_THAT(make("{sensors: {a: {kind: imu, rate_hz: 100, x: 1}}}").error().text(),
              HasSubstr("x: unknown key"));
  EXPECT_THAT(make("{platform: robot, sensors: {a: {kind: imu, rate_hz: 100}}}").error().text(),
              HasSubstr("either `sensors` or `platform`"));
  EXPECT_THAT(make("{sensors: {}}").error().text(), HasSubstr("at least one sensor"));
}

}  // namespace
}  // namespace rigor

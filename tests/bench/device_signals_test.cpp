// What the `signals` of an emulator in a rig give.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "bench/sensing/device_signals.h"

namespace rigor {
namespace {

class Turning final : public MotionSource {
 public:
  WorldMotion motion_at(BenchTime t) const noexcept override {
    WorldMotion m;
    m.count = 2;
    m.joint[1] = {BenchTime(0), 0.5, 2};
    (void)t;
    return m;
  }
};

std::shared_ptr<SignalModel> read(const std::string& text, std::shared_ptr<SignalModel> base = {}) {
  const auto n = ConfigDocument::parse(text, "rig.yaml");
  EXPECT_TRUE(n);
  return read_device_signals(*n, std::move(base), std::make_shared<Turning>(),
                             [](const ConfigNode& node, std::string_view key) -> std::size_t {
                               if (node.text(key) != "table")
                                 throw node.error(key, "expected the joint `table`");
                               return 1;
                             });
}
std::string refused(const std::string& text) {
  try {
    (void)read(text);
  } catch (const ConfigError& e) {
    return e.what();
  }
  return "was accepted";
}
BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }

TEST(DeviceSignals, FollowTheirLaws) {
  const auto m = read(
      "{signals: {a: {constant: 24, unit: V}, b: {sine: {amplitude: 2, period_s: 4, offset: 10}}, c: {joint: "
      "table}, "
      "d: {joint: table, quantity: rate, unit: rad}, e: {commanded: 5}}}");
  ASSERT_EQ(m->signals().size(), 5u);
  EXPECT_EQ(m->signals()[0].unit, "V");
  EXPECT_EQ(m->read(0, at(3)), 24);
  EXPECT_NEAR(m->read(1, at(1)), 12, 1e-12);
  EXPECT_NEAR(m->read(1, at(4'000'003)), 8, 1e-6) << "years later as exact";
  EXPECT_NEAR(m->read(2, at(0.25)), 57.29577951308232, 1e-9);
  EXPECT_EQ(m->signals()[2].unit, "deg");
  EXPECT_EQ(m->read(3, at(0.25)), 2);
  EXPECT_EQ(m->signals()[3].unit, "rad/s");
  EXPECT_FALSE(m->write(0, 1, at(4)));
  EXPECT_TRUE(m->signals()[4].commanded);
  EXPECT_TRUE(m->write(4, -1, at(4)));
  EXPECT_EQ(m->read(4, at(5)), -1);
  EXPECT_EQ(read("{}"), nullptr);
}

TEST(DeviceSignals, StandBehindThoseOfTheModel) {
  const auto base = read("{signals: {a: {commanded: 1}}}");
  const auto n = ConfigDocument::parse("{signals: {b: {constant: 2}}}", "rig.yaml");
  const auto m = read_device_signals(*n, base, {}, {});
  ASSERT_EQ(m->signals().size(), 2u);
  EXPECT_TRUE(m->write(0, 7, at(0)));
  EXPECT_EQ(base->read(0, at(0)), 7);
  EXPECT_EQ(m->read(1, at(0)), 2);
}

TEST(DeviceSignals, ErrorsGiveThePlace) {
  using testing::HasSubstr;
  EXPECT_THAT(refused("{signals: {a: {}}}"),
              HasSubstr("expected one of constant, commanded, sine, joint, recording"));
  EXPECT_THAT(refused("{signals: {a: {joint: arm}}}"), HasSubstr("expected the joint `table`"));
  EXPECT_THAT(refused("{signals: {a: {constant: 1, x: 2}}}"), HasSubstr("x: unknown key"));
  EXPECT_THAT(refused("{signals: {a: {sine: {amplitude: 1, period_s: 0}}}}"), HasSubstr("period_s"));
  EXPECT_THAT(refused("{signals: {a: {recording: none.mcap, channel: c, value: v}}}"),
              HasSubstr("none.mcap"));
}

}  // namespace
}  // namespace rigor

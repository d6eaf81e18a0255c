#include "sensor-hal/rig/rig.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace rigor {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

Result<RigConfig> parse(std::string_view text) {
  auto root = ConfigDocument::parse(text, "rig.yaml");
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_rig(*root, "rig.yaml");
}
std::string error_of(std::string_view text) {
  const auto rig = parse(text);
  if (rig) return "no error";
  EXPECT_EQ(rig.error().exit_status(), 2);
  return rig.error().text();
}

TEST(Rig, ReadsAChannelAndItsTiming) {
  const auto rig = parse(
      "loop: { rate_hz: 1000 }\n"
      "channels:\n"
      "  right: { kind: image, backend: simulated, rate_hz: 25, latency_ms: 60, on_late: drop }\n");
  ASSERT_TRUE(rig) << rig.error().text();
  ASSERT_EQ(rig->channels.size(), 1u);
  const ChannelEntry& c = rig->channels[0];
  EXPECT_EQ(c.kind, SampleKind::image);
  EXPECT_EQ(c.period, milliseconds(40));
  EXPECT_EQ(c.latency, milliseconds(60));
  EXPECT_EQ(c.timing.on_late, LatePolicy::drop);
  EXPECT_EQ(c.source.backend, "simulated");
  EXPECT_EQ(c.source.emulated_by, "right");
}

TEST(Rig, ReadsBothSidesOfAPairAndItsSwitches) {
  const auto rig = parse(
      "channels:\n"
      "  left:\n"
      "    kind: image\n"
      "    rate_hz: 25\n"
      "    pair:\n"
      "      real: { backend: aravis, emulated_by: cam }\n"
      "      simulated: { backend: simulated }\n"
      "      switches: [ { at_s: 1.5, active: simulated }, { at_s: 2, active: real } ]\n");
  ASSERT_TRUE(rig) << rig.error().text();
  const ChannelEntry& c = rig->channels[0];
  EXPECT_TRUE(c.is_pair);
  EXPECT_EQ(c.source.emulated_by, "cam");
  EXPECT_EQ(c.simulated.backend, "simulated");
  ASSERT_EQ(c.switches.size(), 2u);
  EXPECT_EQ(c.switches[0].after_start, milliseconds(1500));
  EXPECT_FALSE(c.switches[0].to_real);
}

TEST(Rig, TakesAnyRateThatIsAFractionOfWholeNumbers) {
  const auto rig = parse(
      "loop: { rate_hz: 960 }\n"
      "channels:\n"
      "  a: { kind: image, backend: simulated, rate_hz: 30 }\n"
      "  b: { kind: image, backend: simulated, rate_hz: 29.97 }\n"
      "  c: { kind: image, backend: simulated, rate_hz: 60000/1001 }\n"
      "  d: { kind: image, backend: simulated, rate_hz: 23.976 }\n");
  ASSERT_TRUE(rig) << rig.error().text();
  EXPECT_TRUE(rig->loop.period.same_as(Period::of_rate(960)));
  ASSERT_EQ(rig->channels.size(), 4u);
  EXPECT_TRUE(rig->channels[0].period.same_as(Period::of_rate(30)));
  EXPECT_TRUE(rig->channels[1].period.same_as(Period::of_rate(2997, 100)));
  EXPECT_TRUE(rig->channels[2].period.same_as(Period::of_rate(60000, 1001)));
  EXPECT_TRUE(rig->channels[3].period.same_as(Period::of_rate(23976, 1000)));
  EXPECT_EQ(rig->channels[0].timing.period, nanoseconds(33'333'333));
}

TEST(Rig, RefusesRatesThatAreNoneOrAboveTheLoops) {
  const auto channel = [](const std::string& rate) {
    return error_of("channels:\n  c: { kind: image, backend: simulated, rate_hz: " + rate + " }\n");
  };
  EXPECT_THAT(channel("2000"), StartsWith("rig.yaml:2:"));
  EXPECT_THAT(channel("2000"),
              HasSubstr("channels.c.rate_hz: expected a rate of at most the loop's 1000 Hz, got "
                        "2000; raise `loop.rate_hz`"));
  EXPECT_THAT(channel("1e-300"), HasSubstr("rate_hz: expected a number from 1e-06 to 1e+06, got 1e-300"));
  EXPECT_THAT(channel("0"), HasSubstr("rate_hz: expected a number from 1e-06 to 1e+06, got 0"));
  EXPECT_THAT(channel(".inf"), HasSubstr("rate_hz: expected a finite number"));
  EXPECT_THAT(channel("[30]"), HasSubstr("rate_hz: expected a number"));
  EXPECT_THAT(channel("30/0"),
              HasSubstr("rate_hz: expected a rate whose denominator is not 0, got 30/0; write"));
  EXPECT_THAT(channel("a/b"),
              HasSubstr("rate_hz: expected a rate as a number or a fraction of whole numbers, got "
                        "a/b; write 30, 29.97 or 60000/1001"));
  EXPECT_THAT(channel("33.3333333333333333333"), HasSubstr("rate_hz: expected a rate of at most 18 digits"));
  EXPECT_THAT(channel("1/9000000"), HasSubstr("rate_hz: expected a rate from 1e-06 to 1e+06, got 1/9000000"));
  EXPECT_THAT(error_of("loop: { rate_hz: 1/2 }\n"),
              HasSubstr("loop.rate_hz: expected a rate from 1 to 20000, got 1/2"));
}

TEST(Rig, RefusesNegativeRatesUnknownKindsAndUnknownKeys) {
  EXPECT_THAT(error_of("channels:\n  c: { kind: image, backend: x, rate_hz: -5 }\n"),
              HasSubstr("rate_hz: expected"));
  EXPECT_THAT(error_of("channels:\n  c: { kind: imag, backend: x, rate_hz: 5 }\n"), HasSubstr("image"));
  EXPECT_THAT(error_of("chanels: {}\n"), HasSubstr("did you mean channels"));
  EXPECT_THAT(error_of("loop: { rate_hz: fast }\n"), HasSubstr("loop.rate_hz: expected a number"));
}

TEST(Rig, RefusesTwoChannelsWithOneName) {
  EXPECT_THAT(error_of("channels:\n  c: { kind: image, backend: x, rate_hz: 5 }\n  c: { kind: image, "
                       "backend: x, rate_hz: 5 }\n"),
              StartsWith("rig.yaml:3:"));
}

TEST(Rig, RefusesASinkNamedLikeAChannelAndAJointWithoutItsChannel) {
  EXPECT_THAT(
      error_of("channels:\n  c: { kind: registers, backend: x, rate_hz: 5 }\nsinks:\n  c: { backend: x }\n"),
      HasSubstr("expected a name of its own"));
  EXPECT_THAT(error_of("simulation: { joints: { t: { channel: nothing, position: p } } }\n"),
              HasSubstr("expected a channel of kind registers"));
}

TEST(Rig, RefusesAPairThatAlsoNamesABackend) {
  EXPECT_THAT(error_of("channels:\n  c:\n    kind: image\n    rate_hz: 5\n    backend: aravis\n    pair: { "
                       "real: { backend: a }, simulated: { backend: b } }\n"),
              HasSubstr("either `backend` or `pair`"));
}

}  // namespace
}  // namespace rigor

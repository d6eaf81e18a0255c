// `--set path.to.key=value`.
#include "tests/sensor-hal/config/config_test.h"

namespace rigor {
namespace {

ConfigOverride set(std::string_view text) {
  auto o = ConfigOverride::parse(text);
  EXPECT_TRUE(o.has_value()) << (o ? "" : o.error().text());
  return o ? *o : ConfigOverride{};
}

TEST(ConfigOverride, ReplacesAddsAndMakesMapsOnTheWay) {
  const auto n = parsed("loop: {rate_hz: 1000, name: a}\n", {set("loop.rate_hz=500"), set("loop.spin_us=20"),
                                                             set("report.dir=out dir"), set("loop.name=")});
  EXPECT_EQ(n.map("loop").number("rate_hz"), 500);
  EXPECT_EQ(n.map("loop").integer("spin_us"), 20);
  EXPECT_EQ(n.map("loop").text("name"), "");
  EXPECT_EQ(n.map("report").text("dir"), "out dir");
}

TEST(ConfigOverride, TheLastOneWins) {
  EXPECT_EQ(parsed("a: 1\n", {set("a=2"), set("a=3")}).integer("a"), 3);
}

TEST(ConfigOverride, ValuesAreYaml) {
  const auto n =
      parsed("a: 1\n", {set("v=[1, 2]"), set("m={x: true}"), set("t=\"5\""), set("e=a=b"), set("a={}")});
  EXPECT_EQ(n.numbers("v", 2), (std::vector<double>{1, 2}));
  EXPECT_TRUE(n.map("m").flag("x"));
  EXPECT_NE(complaint([&] { (void)n.integer("t"); }), "(accepted)");
  EXPECT_EQ(n.text("e"), "a=b");
  EXPECT_TRUE(n.map("a").keys().empty());
}

TEST(ConfigOverride, ItemsOfListsAreNamedByTheirIndex) {
  const std::string rig = "channels:\n  - {name: left}\n  - {name: right}\n";
  const auto n = parsed(rig, {set("channels.1.name=other"), set("channels.0={name: whole}")});
  EXPECT_EQ(n.list("channels")[0].text("name"), "whole");
  EXPECT_EQ(n.list("channels")[1].text("name"), "other");
  EXPECT_EQ(
      refusal(rig, {set("channels.2.name=x")}),
      "--set channels.2.name=x: channels: expected the index of one of its 2 items, counted from 0, got '2'");
  EXPECT_EQ(refusal(rig, {set("channels.left.name=x")}),
            "--set channels.left.name=x: channels: expected the index of one of its 2 items, counted from 0, "
            "got 'left'");
}

TEST(ConfigOverride, DoesNotGoThroughAScalar) {
  EXPECT_EQ(refusal("loop: {rate_hz: 1000}\n", {set("loop.rate_hz.x=1")}),
            "--set loop.rate_hz.x=1: loop.rate_hz: expected a map or a list to set 'x' in, got 1000");
}

TEST(ConfigOverride, IsThePlaceOfWhatItSet) {
  const auto n = parsed("loop: {rate_hz: 1000}\n", {set("loop.rate_hz=fast"), set("loop.spn_us=1")});
  EXPECT_EQ(complaint([&] { (void)n.map("loop").number("rate_hz"); }),
            "--set: loop.rate_hz: expected a number, got fast");
  (void)n.map("loop").integer_or("spin_us", 0);
  EXPECT_EQ(complaint([&] { n.map("loop").finish(); }),
            "--set: loop.spn_us: unknown key; did you mean spin_us?");
}

TEST(ConfigOverride, ChangesOneUserOfAnAliasAlone) {
  const auto n = parsed("a: &cam {rate_hz: 25}\nb: *cam\n", {set("b.rate_hz=50")});
  EXPECT_EQ(n.map("a").integer("rate_hz"), 25);
  EXPECT_EQ(n.map("b").integer("rate_hz"), 50);
}

TEST(ConfigOverride, ThatIsNoneIsRefused) {
  for (const auto* text : {"", "loop", "=1", ".a=1", "a.=1", "a..b=1"}) {
    const auto o = ConfigOverride::parse(text);
    ASSERT_FALSE(o.has_value()) << text;
    EXPECT_EQ(o.error().exit_status(), 2);
    EXPECT_EQ(o.error().where, std::string("--set ") + text);
  }
  EXPECT_EQ(
      refusal("a: 1\n", {set("a=[1")}),
      "--set a=[1: expected a YAML value after the =, got '[1'; quote text that has special characters");
  EXPECT_NE(refusal("a: 1\n", {set("a=1\nb: 2")}), "(accepted)");
  EXPECT_NE(refusal("a: 1\n", {ConfigOverride{"b\xFC", "1"}}), "(accepted)");
  EXPECT_NE(refusal("a: 1\n", {ConfigOverride{"b\x01", "1"}}), "(accepted)");
}

}  // namespace
}  // namespace rigor

// Numbers that are finite, and still none that a rig, a sensor or a world has.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "sensor-hal/config/json_text.h"
#include "sensor-hal/config/sample_size.h"
#include "sensor-hal/config/unit_limits.h"
#include "tests/sensor-hal/config/config_test.h"

namespace rigor {
namespace {

TEST(ConfigLimits, TheUnitOfAKeyBoundsWhatItsReaderLeavesOpen) {
  const auto n = parsed("position_m: [1e300, 0, 0]\nwait_ms: 1e13\ngain: 1e300\nwidth_px: 10000000\n");
  EXPECT_EQ(complaint([&] { (void)n.numbers("position_m", 3); }),
            "rig.yaml:1:14: position_m.0: expected a number from -1e+08 to 1e+08, got 1e300");
  EXPECT_EQ(complaint([&] { (void)n.number("wait_ms", {.min = 0}); }),
            "rig.yaml:2:10: wait_ms: expected a number from 0 to 4e+12, got 1e13");
  EXPECT_EQ(complaint([&] { (void)n.number("gain"); }),
            "rig.yaml:3:7: gain: expected a number from -1e+15 to 1e+15, got 1e300");
  EXPECT_EQ(complaint([&] { (void)n.integer("width_px", {.min = 1}); }),
            "rig.yaml:4:11: width_px: expected a whole number from 1 to 1e+06, got 10000000");
}

TEST(ConfigLimits, AReaderThatGivesABoundIsTakenAtItsWord) {
  const auto n = parsed("far_m: 3e9\nseed: 9007199254740993\n");
  EXPECT_EQ(n.number("far_m", {.min = 0, .max = 1e10}), 3e9);
  EXPECT_EQ(n.integer("seed"), 9007199254740993);  // without a unit: all of 64 bits
}

TEST(ConfigLimits, ItemsOfListsHaveTheUnitOfTheirKey) {
  const auto n = parsed("ways:\n  length_m:\n    - 5\n    - 1e9\n");
  const auto items = n.map("ways").list("length_m");
  EXPECT_EQ(items[0].as_number(), 5);
  EXPECT_NE(complaint([&] { (void)items[1].as_number(); }).find("from -1e+08 to 1e+08"), std::string::npos);
}

TEST(ConfigLimits, SecondsInAnyPrefixFitInNanoseconds) {
  for (const auto& [key, to_s] :
       {std::pair{"t_s", 1.0}, {"t_ms", 1e-3}, {"t_us", 1e-6}, {"t_ns", 1e-9}, {"t_h", 3600.0}})
    EXPECT_LT(config::unit_limit(key) * to_s, 9.2e9) << key;
}

TEST(ConfigLimits, PicturesAndBuffersAreRefusedBySize) {
  const auto n = parsed("width_px: 60000\nheight_px: 60000\nslots: 4096\n");
  EXPECT_EQ(
      complaint([&] { check_picture_size(n, 60000, 60000); }),
      "rig.yaml:1:11: width_px: expected a picture of at most 268435456 pixels (16384 x 16384), got 60000 x "
      "60000");
  EXPECT_EQ(complaint([&] { check_picture_size(n, 16384, 16384); }), "(accepted)");
  EXPECT_NE(complaint([&] {
              check_buffer_memory(n, "slots", 4096, std::uint64_t{1} << 34);
            }).find("rig.yaml:3:8: slots: expected buffers that fit in this machine's memory"),
            std::string::npos);
  EXPECT_EQ(complaint([&] { check_buffer_memory(n, "slots", 4, 1 << 20); }), "(accepted)");
}

TEST(ConfigLimits, NestingIsBounded) {
  const auto nested = [](std::size_t n) { return "a: " + std::string(n, '[') + std::string(n, ']'); };
  EXPECT_EQ(refusal(nested(63)), "(accepted)");
  EXPECT_EQ(refusal(nested(64)),
            "rig.yaml:1:67: expected maps and lists nested at most 64 levels deep with every alias written "
            "out, got "
            "more; flatten them");
}

/// Each alias stands in a list of 60 levels and becomes the anchor of the next: 60 · 64 levels in few lines.
TEST(ConfigLimits, NestingByAliasesIsBounded) {
  std::string yaml = "a0: &a0 [1]\n";
  for (int i = 1; i <= 64; ++i)
    yaml += fmt::format("a{0}: &a{0} {1}*a{2}{3}\n", i, std::string(60, '['), i - 1, std::string(60, ']'));
  EXPECT_NE(refusal(yaml).find("rig.yaml:3:69: expected maps and lists nested at most 64 levels"),
            std::string::npos)
      << refusal(yaml);
}

TEST(ConfigLimits, NestingByOverridesIsBounded) {
  const auto with = [](const std::string& set) { return refusal("a: 1", {*ConfigOverride::parse(set)}); };
  std::string path = "b";
  for (int i = 1; i < 64; ++i) path += ".b";
  EXPECT_EQ(with(path + "=1"), "(accepted)");
  EXPECT_NE(with(path + "=[1]").find("nest at most 64 levels deep together, got 65"), std::string::npos);
  for (int i = 0; i < 20'000; ++i) path += ".b";
  EXPECT_NE(with(path + "=1").find("nest at most 64 levels"), std::string::npos);
}

TEST(JsonText, RefusesWhatNestsTooDeeplyIsTooLongOrIsNone) {
  const auto said = [](const std::string& text, std::size_t most = kMaxJsonBytes) {
    const auto value = parse_json(text, "request", most);
    return value ? value->dump() : value.error().text();
  };
  const auto nested = [](std::size_t n) { return std::string(n, '[') + std::string(n, ']'); };
  EXPECT_EQ(said(nested(64)), nested(64));
  EXPECT_EQ(said(nested(65)), "request: expected JSON nested at most 64 levels deep, got more; flatten it");
  EXPECT_EQ(said(nested(1'000'000)), said(nested(65)));
  EXPECT_EQ(said(std::string(1'000'000, '{')), said(nested(65)));
  // Brackets within text are text, also behind an escaped quote.
  const std::string text = "[\"\\\"" + std::string(100, '[') + "\\\\\",1]";
  EXPECT_EQ(said(text), text);
  EXPECT_EQ(said("[1, 2]", 5), "request: expected at most 5 bytes of JSON, got 6");
  EXPECT_EQ(said("no\x1b[2J json"), "request: expected JSON, got \"no?[2J json\"");
  EXPECT_EQ(said(""), "request: expected JSON, got nothing");
}

}  // namespace
}  // namespace rigor

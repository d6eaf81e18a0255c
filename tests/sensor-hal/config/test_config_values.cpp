// Values, and the sentence for each way in which one can be wrong.
#include <cmath>

#include "tests/sensor-hal/config/config_test.h"

namespace rigor {
namespace {

TEST(ConfigValues, AreReadByNameAndType) {
  const auto n = parsed(
      "name: bench\n"
      "serial: 007\n"
      "rate_hz: 1e3\n"
      "gain: -.5\n"
      "mask: 0x1F\n"
      "mode: 0o17\n"
      "plus: +3\n"
      "on: true\n"
      "off: false\n"
      "offset_m: [1, 2.5, -3]\n"
      "loop: {period_us: 1000}\n"
      "channels:\n"
      "  - name: left\n"
      "  - name: right\n");
  EXPECT_EQ(n.text("name"), "bench");
  EXPECT_EQ(n.text("serial"), "007");
  EXPECT_EQ(n.number("rate_hz"), 1000.0);
  EXPECT_EQ(n.number("gain"), -0.5);
  EXPECT_EQ(n.integer("mask"), 31);
  EXPECT_EQ(n.number("mask"), 31.0);
  EXPECT_EQ(n.integer("mode"), 15);
  EXPECT_EQ(n.integer("plus"), 3);
  EXPECT_TRUE(n.flag("on"));
  EXPECT_FALSE(n.flag("off"));
  EXPECT_EQ(n.numbers("offset_m", 3), (std::vector<double>{1, 2.5, -3}));
  EXPECT_EQ(n.map("loop").integer("period_us"), 1000);
  const auto channels = n.list("channels");
  ASSERT_EQ(channels.size(), 2u);
  EXPECT_EQ(channels[1].text("name"), "right");
  EXPECT_EQ(channels[1].path(), "channels.1");
  EXPECT_EQ(channels[1].place(), "rig.yaml:14:5");
  EXPECT_NO_THROW(n.finish());
  EXPECT_EQ(n.keys().front(), "name");
  EXPECT_EQ(n.keys().back(), "channels");
}

TEST(ConfigValues, HaveDefaultsWhereAKeyIsMissing) {
  const auto n = parsed("a: 1\n");
  EXPECT_EQ(n.text_or("t", "x"), "x");
  EXPECT_EQ(n.number_or("d", 2.5), 2.5);
  EXPECT_EQ(n.integer_or("i", 7), 7);
  EXPECT_TRUE(n.flag_or("f", true));
  EXPECT_EQ(n.choice_or("c", {"p", "q"}, "q"), "q");
  EXPECT_EQ(n.numbers_or("v", {1, 2}), (std::vector<double>{1, 2}));
  EXPECT_TRUE(n.list_or_empty("l").empty());
  const auto absent = n.map_or_absent("m");
  EXPECT_FALSE(absent.present());
  EXPECT_EQ(absent.number_or("x", 4), 4);
  EXPECT_EQ(complaint([&] { (void)absent.number("x"); }),
            "rig.yaml:1:1: m.x: expected a number, got nothing: the key is missing");
  EXPECT_NO_THROW(absent.finish());
}

TEST(ConfigValues, ADefaultMadeNodeReadsAsAnEmptyMap) {
  const ConfigNode n;
  EXPECT_FALSE(n.present());
  EXPECT_FALSE(n.has("x"));
  EXPECT_EQ(n.integer_or("x", 3), 3);
  EXPECT_EQ(n.map_or_absent("m").text_or("x", "y"), "y");
  EXPECT_TRUE(n.keys().empty());
  EXPECT_EQ(n.dump(), "");
  EXPECT_NO_THROW(n.finish());
  EXPECT_EQ(complaint([&] { (void)n.text("x"); }), "x: expected text, got nothing: the key is missing");
  EXPECT_EQ(complaint([&] { (void)n.as_text(); }), "expected text, got nothing");
}

struct WrongValue {
  const char* text;
  const char* kind;  ///< which reader of key `k`
  const char* message;
};
class WrongValues : public testing::TestWithParam<WrongValue> {};

TEST_P(WrongValues, AreRefusedWithTheirPlace) {
  const auto n = parsed(GetParam().text);
  const std::string kind = GetParam().kind;
  const auto message = complaint([&] {
    if (kind == "text") (void)n.text("k");
    if (kind == "number") (void)n.number("k");
    if (kind == "number_or") (void)n.number_or("k", 1);
    if (kind == "rate") (void)n.number("k", {.min = 0, .max = 20000, .exclusive_min = true});
    if (kind == "integer") (void)n.integer("k");
    if (kind == "small") (void)n.integer("k", {.min = 1, .max = 8});
    if (kind == "positive") (void)n.integer("k", {.min = 0});
    if (kind == "negative") (void)n.number("k", {.max = -1});
    if (kind == "flag") (void)n.flag("k");
    if (kind == "map") (void)n.map("k");
    if (kind == "list") (void)n.list("k");
    if (kind == "numbers") (void)n.numbers("k", 3);
    if (kind == "choice") (void)n.choice("k", {"wall", "virtual"});
  });
  EXPECT_EQ(message, GetParam().message);
}

INSTANTIATE_TEST_SUITE_P(
    Config, WrongValues,
    testing::Values(
        WrongValue{"a: 1", "text", "rig.yaml:1:1: k: expected text, got nothing: the key is missing"},
        WrongValue{"kk: 1", "text", "rig.yaml:1:1: k: expected text, got nothing: the key is missing"},
        WrongValue{"k: [a]", "text", "rig.yaml:1:4: k: expected text, got a list of 1"},
        WrongValue{"k:\n  x: 1", "text", "rig.yaml:2:3: k: expected text, got a map"},
        WrongValue{"k:\nz: 2", "text", "rig.yaml:1:1: k: expected text, got nothing"},
        WrongValue{"k: fast", "number", "rig.yaml:1:4: k: expected a number, got fast"},
        WrongValue{"a: 1\nk:   \"5\"", "number",
                   "rig.yaml:2:6: k: expected a number, got \"5\"; remove the quotes"},
        WrongValue{"k: .nan", "number", "rig.yaml:1:4: k: expected a finite number, got .nan"},
        WrongValue{"k: -.Inf", "number", "rig.yaml:1:4: k: expected a finite number, got -.Inf"},
        WrongValue{"k: nan", "number", "rig.yaml:1:4: k: expected a number, got nan"},
        WrongValue{"k: inf", "number", "rig.yaml:1:4: k: expected a number, got inf"},
        WrongValue{"k: 1e999", "number",
                   "rig.yaml:1:4: k: expected a number, got 1e999, which no double can hold"},
        WrongValue{"k: 1,5", "number", "rig.yaml:1:4: k: expected a number, got 1,5"},
        WrongValue{"k: 1_000", "number", "rig.yaml:1:4: k: expected a number, got 1_000"},
        WrongValue{"k: 010", "number",
                   "rig.yaml:1:4: k: expected a number, got 010; write it without the leading zero"},
        WrongValue{"k: 5 ms", "number", "rig.yaml:1:4: k: expected a number, got 5 ms"},
        WrongValue{"k: --5", "number", "rig.yaml:1:4: k: expected a number, got --5"},
        WrongValue{"k:", "number_or", "rig.yaml:1:1: k: expected a number, got nothing"},
        WrongValue{"k: ~", "number_or", "rig.yaml:1:4: k: expected a number, got nothing"},
        WrongValue{"k: -25", "rate", "rig.yaml:1:4: k: expected a number above 0 and up to 20000, got -25"},
        WrongValue{"k: 0", "rate", "rig.yaml:1:4: k: expected a number above 0 and up to 20000, got 0"},
        WrongValue{"k: 20001", "rate",
                   "rig.yaml:1:4: k: expected a number above 0 and up to 20000, got 20001"},
        WrongValue{"k: 0", "negative", "rig.yaml:1:4: k: expected a number of at most -1, got 0"},
        WrongValue{"k: 1.0", "integer", "rig.yaml:1:4: k: expected a whole number, got 1.0"},
        WrongValue{
            "k: 9223372036854775808", "integer",
            "rig.yaml:1:4: k: expected a whole number, got 9223372036854775808, which 64 bits cannot hold"},
        WrongValue{"k: 0x", "integer", "rig.yaml:1:4: k: expected a whole number, got 0x"},
        WrongValue{"k: 9", "small", "rig.yaml:1:4: k: expected a whole number from 1 to 8, got 9"},
        WrongValue{"k: -1", "positive", "rig.yaml:1:4: k: expected a whole number of at least 0, got -1"},
        WrongValue{"k: yes", "flag", "rig.yaml:1:4: k: expected true or false, got yes; write true"},
        WrongValue{"k: OFF", "flag", "rig.yaml:1:4: k: expected true or false, got OFF; write false"},
        WrongValue{"k: \"true\"", "flag",
                   "rig.yaml:1:4: k: expected true or false, got \"true\"; write true"},
        WrongValue{"k: 1", "flag", "rig.yaml:1:4: k: expected true or false, got 1"},
        WrongValue{"k: 1", "map", "rig.yaml:1:4: k: expected a map, got 1"},
        WrongValue{"k: {a: 1}", "list", "rig.yaml:1:4: k: expected a list, got a map"},
        WrongValue{"k: [1, 2]", "numbers", "rig.yaml:1:4: k: expected a list of 3 numbers, got a list of 2"},
        WrongValue{"k: [1, 2, x]", "numbers", "rig.yaml:1:11: k.2: expected a number, got x"},
        WrongValue{"k: vrtual", "choice",
                   "rig.yaml:1:4: k: expected one of wall, virtual, got vrtual; did you mean 'virtual'?"},
        WrongValue{"k: zebra", "choice", "rig.yaml:1:4: k: expected one of wall, virtual, got zebra"},
        WrongValue{"k: aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
                   "number",
                   "rig.yaml:1:4: k: expected a number, got "
                   "\"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa...\""}));

TEST(ConfigValues, LimitsThemselvesAreAllowed) {
  const auto n = parsed("lo: 1\nhi: 8\nmin: -9223372036854775808\nmax: 9223372036854775807\ntiny: 1e-400");
  EXPECT_EQ(n.integer("lo", {.min = 1, .max = 8}), 1);
  EXPECT_EQ(n.integer("hi", {.min = 1, .max = 8}), 8);
  EXPECT_EQ(n.integer("min"), std::numeric_limits<std::int64_t>::min());
  EXPECT_EQ(n.integer("max"), std::numeric_limits<std::int64_t>::max());
  EXPECT_EQ(n.number("tiny"), 0.0);
}

TEST(ConfigValues, IntegerRangeIsExactBeyondWhatADoubleHolds) {
  const auto n = parsed("k: 9007199254740993\n");  // 2^53 + 1: as a double it would be 2^53
  EXPECT_EQ(n.integer("k", {.min = 9007199254740992.0}), 9007199254740993);
  EXPECT_NE(complaint([&] { (void)n.integer("k", {.max = 9007199254740992.0}); }), "(accepted)");
}

TEST(ConfigValues, ItemsOfListsAreReadAsThemselves) {
  const auto items = parsed("k: [left, 2.5, 3]").list("k");
  EXPECT_EQ(items[0].as_text(), "left");
  EXPECT_EQ(items[1].as_number(), 2.5);
  EXPECT_EQ(items[2].as_integer({.max = 3}), 3);
  EXPECT_EQ(complaint([&] { (void)items[0].as_number(); }), "rig.yaml:1:5: k.0: expected a number, got left");
  EXPECT_EQ(complaint([&] { (void)items[2].as_integer({.max = 2}); }),
            "rig.yaml:1:16: k.2: expected a whole number of at most 2, got 3");
}

TEST(ConfigValues, UnknownKeyNamesTheNearestKnownOne) {
  const auto n = parsed("loop:\n  rate_hz: 1000\n  spn_us: 20\n");
  const auto loop = n.map("loop");
  (void)loop.number("rate_hz");
  (void)loop.integer_or("spin_us", 0);
  EXPECT_EQ(complaint([&] { loop.finish(); }),
            "rig.yaml:3:3: loop.spn_us: unknown key; did you mean spin_us?");
}

TEST(ConfigValues, UnknownKeyWithoutALikenessListsWhatIsKnown) {
  const auto n = parsed("zebra: 1\n");
  (void)n.number_or("rate_hz", 1);
  (void)n.text_or("name", "");
  EXPECT_EQ(complaint([&] { n.finish(); }), "rig.yaml:1:1: zebra: unknown key; expected name, rate_hz");
}

TEST(ConfigValues, MissingKeyNamesTheUnreadKeyThatIsNear) {
  const auto n = parsed("loop: {rate_hx: 5}\n");
  EXPECT_EQ(
      complaint([&] { (void)n.map("loop").number("rate_hz"); }),
      "rig.yaml:1:7: loop.rate_hz: expected a number, got nothing: the key is missing; did you mean it by "
      "'rate_hx'?");
}

TEST(ConfigValues, CopiesOfANodeShareWhatWasAskedFor) {
  const auto n = parsed("a: {x: 1, y: 2}\n");
  const auto one = n.map("a");
  (void)n.map("a").integer("x");
  EXPECT_EQ(complaint([&] { one.finish(); }), "rig.yaml:1:11: a.y: unknown key; expected x");
  (void)one.integer("y");
  EXPECT_NO_THROW(n.map("a").finish());
}

TEST(ConfigValues, AskingWhetherAKeyIsThereDoesNotReadIt) {
  const auto n = parsed("a: 1\n");
  EXPECT_TRUE(n.has("a"));
  EXPECT_NE(complaint([&] { n.finish(); }), "(accepted)");
}

TEST(ConfigValues, AKeyWithoutValueIsAnEmptyMap) {
  const auto n = parsed("faults:\nlist:\n");
  EXPECT_TRUE(n.map("faults").is_map());
  EXPECT_NO_THROW(n.map("faults").finish());
  EXPECT_TRUE(n.list_or_empty("list").empty());
}

TEST(ConfigValues, ErrorsOfTheReaderCarryThePlaceToo) {
  const auto n = parsed("loop:\n  rate_hz: 333\n");
  EXPECT_EQ(n.map("loop").error("rate_hz", "expected a divisor of 1000, got 333").error().text(),
            "rig.yaml:2:12: loop.rate_hz: expected a divisor of 1000, got 333");
  EXPECT_EQ(n.map("loop").error({}, "expected more").error().text(), "rig.yaml:2:3: loop: expected more");
  EXPECT_EQ(n.map("loop").error("gone", "expected it").error().text(),
            "rig.yaml:2:3: loop.gone: expected it");
}

TEST(Nearest, FindsTyposEndingsAndSwaps) {
  EXPECT_EQ(nearest("spn_us", {"spin_us", "rate_hz"}), "spin_us");
  EXPECT_EQ(nearest("rate", {"spin_us", "rate_hz"}), "rate_hz");
  EXPECT_EQ(nearest("mnoo8", {"mono8", "mono16"}), "mono8");
  EXPECT_EQ(nearest("Left", {"left", "right"}), "left");
  EXPECT_EQ(nearest("zebra", {"spin_us", "rate_hz"}), "");
  EXPECT_EQ(nearest("a", {"b"}), "");
  EXPECT_EQ(nearest("", {"b", ""}), "");
  EXPECT_EQ(nearest(std::string(100000, 'x'), {std::string(100000, 'y'), "z"}).size(), 0u);
}

TEST(ConfigValues, OfEarlierVersionsAreRefusedWithTheNewName) {
  struct Row {
    const char *old, *now;
  };
  for (const auto& [old, now] :
       {Row{"hand_on", "active"}, Row{"engine", "renderer"}, Row{"effort", "quality"},
        Row{"becomes", "model_schedule"}, Row{"sheet", "model"}, Row{"walk_mm", "remission_bias_mm"},
        Row{"oblique_mm", "incidence_bias_mm"}}) {
    const std::string text = std::string(old) + ": x\n";
    const std::string told = "rig.yaml:1:1: " + std::string(old) + ": now called " + now;
    const auto optional = parsed(text);
    (void)optional.text_or(now, "");
    EXPECT_EQ(complaint([&] { optional.finish(); }), told);
    const auto required = parsed(text);
    EXPECT_EQ(complaint([&] { (void)required.text(now); }), told);
  }
  for (const auto& [old, now] :
       {Row{"vulkan", "raster"}, Row{"note", "log"}, Row{"late", "overdue"}, Row{"lost", "disconnected"}}) {
    const auto n = parsed("key: " + std::string(old) + "\n");
    EXPECT_EQ(complaint([&] {
                (void)n.choice("key", {now, "other"});
              }),
              "rig.yaml:1:6: key: expected one of " + std::string(now) + ", other, got " + old +
                  "; now called " + now);
  }
  const auto foreign = parsed("engine: x\n");
  EXPECT_EQ(complaint([&] { foreign.finish(); }), "rig.yaml:1:1: engine: unknown key; expected no keys here")
      << "where the new name would be as unknown";
}

}  // namespace
}  // namespace rigor

// Files as people and editors write them, and as an enemy would.
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "tests/sensor-hal/config/config_test.h"

namespace rigor {
namespace {

struct Refused {
  const char* text;
  const char* message;
};
class RefusedDocuments : public testing::TestWithParam<Refused> {};

TEST_P(RefusedDocuments, SayWhere) { EXPECT_EQ(refusal(GetParam().text), GetParam().message); }

INSTANTIATE_TEST_SUITE_P(
    Config, RefusedDocuments,
    testing::Values(
        Refused{"", "rig.yaml:1:1: expected keys and values, got an empty file"},
        Refused{"# only a comment\n", "rig.yaml:1:1: expected keys and values, got an empty file"},
        Refused{"---\n...\n", "rig.yaml:1:1: expected keys and values, got an empty file"},
        Refused{"\n- a\n- b\n", "rig.yaml:2:1: expected keys and values (key: value), got a list of 2"},
        Refused{"hello", "rig.yaml:1:1: expected keys and values (key: value), got hello"},
        Refused{"a: 1\nb: 2\na: 3\n",
                "rig.yaml:3:1: expected each key once, got 'a' again; the first is in line 1"},
        Refused{"x: {a: 1, \"a\": 2}",
                "rig.yaml:1:11: expected each key once, got 'a' again; the first is in line 1"},
        Refused{"a: 1\n---\nb: 2\n",
                "rig.yaml:3:1: expected one document, got a second one; remove what follows the line ---"},
        Refused{"a: &x [*x]",
                "rig.yaml:1:8: expected an alias of a finished value, got one inside the value itself"},
        Refused{"a: !magic 1", "rig.yaml:1:4: expected a plain value, got the tag '!magic'; remove it"},
        Refused{"a: &b {x: 1}\nc:\n  <<: *b\n",
                "rig.yaml:3:3: expected a key, got the merge key <<, which YAML 1.2 does not have; repeat "
                "the keys"},
        Refused{"? [a, b]\n: 1\n", "rig.yaml:1:3: expected a key, got a list"},
        Refused{"a: 1\n\tb: 2\n", "rig.yaml:2:1: expected spaces as indentation, got a tab"},
        Refused{"a:\n\tb: 2\n", "rig.yaml:2:1: expected spaces as indentation, got a tab"},
        Refused{"a: \"\xC3\x28\"",
                "rig.yaml:1:5: expected UTF-8 text, got a byte that is none; save the file as UTF-8"},
        Refused{"\xFF\xFE\x61", "rig.yaml:1:1: expected UTF-8 text, got UTF-16; save the file as UTF-8"},
        Refused{"a: 1\nb: \x04\n", "rig.yaml:2:4: expected text, got the control character 4"},
        Refused{"a: 1\rb: 2\r", "rig.yaml:1:5: expected lines that end in LF or CR LF, got a CR alone"}));

TEST(ConfigDocument, BrokenYamlNamesItsPlace) {
  EXPECT_TRUE(refusal("a: [1, 2\nb: 3\n").starts_with("rig.yaml:2:")) << refusal("a: [1, 2\nb: 3\n");
  EXPECT_TRUE(refusal("a: {x: 1\n").starts_with("rig.yaml:")) << refusal("a: {x: 1\n");
  EXPECT_TRUE(refusal("a: b: c\n").starts_with("rig.yaml:1:5: ")) << refusal("a: b: c\n");
  EXPECT_TRUE(refusal("a: \"open\n").starts_with("rig.yaml:")) << refusal("a: \"open\n");
  EXPECT_TRUE(refusal("a: 1\n b: 2\n").starts_with("rig.yaml:2:")) << refusal("a: 1\n b: 2\n");
  EXPECT_TRUE(refusal("a: 'open\nb: 2\n").starts_with("rig.yaml:")) << refusal("a: 'open\nb: 2\n");
  EXPECT_TRUE(refusal("a: *nobody\n").starts_with("rig.yaml:1:4: ")) << refusal("a: *nobody\n");
}

TEST(ConfigDocument, DumpKeepsWordsThatMeanMoreInABlock) {
  const auto once = parsed("a: [x, -, b:c, '?', '-']\n").dump();
  const auto items = parsed(once).list("a");
  ASSERT_EQ(items.size(), 5u);
  EXPECT_EQ(items[1].as_text(), "-");
  EXPECT_EQ(items[2].as_text(), "b:c");
}

TEST(ConfigDocument, BlockTextKeepsItsEnds) {
  const auto n = parsed("a: |\n  one\n  two\nb: |+\n  keep\n\nc: >-\n  folded\n  text\nd: |\n  last\n");
  EXPECT_EQ(n.text("a"), "one\ntwo\n");
  EXPECT_EQ(n.text("b"), "keep\n\n");
  EXPECT_EQ(n.text("c"), "folded text");
  EXPECT_EQ(n.text("d"), "last\n");
}

TEST(ConfigDocument, EscapesThatTheParserWritesAsOneByteAreRefused) {
  EXPECT_EQ(refusal("a: \"x\\Ny\"\n"),
            "rig.yaml:1:4: expected text, got an escape (\\N or \\_) that the parser gets wrong; write the "
            "character itself, or \\u0085 or \\u00a0");
  EXPECT_EQ(refusal("\"x\\_y\": 1\n").substr(0, 13), "rig.yaml:1:1:");
  EXPECT_EQ(parsed("a: \"x\\u0085y\"\n").text("a"), "x\u0085y");
}

TEST(ConfigDocument, ColumnsCountCharactersAndNotBytes) {
  const auto n = parsed("# Prüfstand\nname: \"größe\"\nmap: {ä: 1, b: x}\n");
  (void)n.text("name");
  EXPECT_EQ(complaint([&] { (void)n.map("map").number("b"); }),
            "rig.yaml:3:16: map.b: expected a number, got x");
}

TEST(ConfigDocument, WindowsFilesReadAsOthersDo) {
  const auto n =
      parsed("\xEF\xBB\xBFloop:\r\n  rate_hz: 100\r\n  name: \"left\"\r\n  plain: right\r\n  bad: x\r\n");
  const auto loop = n.map("loop");
  EXPECT_EQ(loop.number("rate_hz"), 100);
  EXPECT_EQ(loop.text("name"), "left");
  EXPECT_EQ(loop.text("plain"), "right");
  EXPECT_EQ(complaint([&] { (void)loop.number("bad"); }), "rig.yaml:5:8: loop.bad: expected a number, got x");
}

TEST(ConfigDocument, AnchorsAndAliasesAreTheSameValue) {
  const auto n = parsed("a: &cam {rate_hz: 25}\nb: *cam\nl: &l [1]\nm: *l\n");
  EXPECT_EQ(n.map("b").number("rate_hz"), 25);
  EXPECT_EQ(n.numbers("m", 1), (std::vector<double>{1}));
}

TEST(ConfigDocument, AliasesThatExplodeAreRefused) {
  std::string bomb = "a: &a [x, x, x, x, x, x, x, x, x, x]\n";
  for (char c = 'b'; c <= 'k'; ++c) {
    bomb += std::string(1, c) + ": &" + c + " [";
    for (int i = 0; i < 10; ++i) bomb += std::string(i ? ", " : "") + "*" + static_cast<char>(c - 1);
    bomb += "]\n";
  }
  EXPECT_NE(refusal(bomb).find("expected at most 1000000 values"), std::string::npos) << refusal(bomb);
}

TEST(ConfigDocument, DeepNestingIsRefusedAndDoesNotOverflow) {
  EXPECT_NE(refusal("a: " + std::string(200000, '[')), "(accepted)");
  EXPECT_NE(refusal("a: " + std::string(100000, '{')), "(accepted)");
  std::string block;
  for (int i = 0; i < 3000; ++i) block += std::string(i, ' ') + "a:\n";
  EXPECT_NE(refusal(block), "(accepted)");
}

TEST(ConfigDocument, BigFilesAreRefusedBeforeTheyAreParsed) {
  EXPECT_EQ(refusal("a: 1\n" + std::string(17u << 20, '#')),
            "rig.yaml: expected at most 16 MiB of YAML, got more");
  std::string many = "a: [";
  for (int i = 0; i < 1'100'000; ++i) many += "1,";
  EXPECT_NE(refusal(many + "1]").find("expected at most 1000000 values"), std::string::npos);
}

TEST(ConfigDocument, DumpReadsAsTheSameValues) {
  const std::string text =
      "name: \"a: b # c\"\nnumber_text: \"5\"\nnumber: 5\nempty: \"\"\nnull_text: \"null\"\nnothing: "
      "null\nlines: "
      "\"one\\ntwo\\t\\\"\"\nfolded: one\n  two\n\n  three\nlist: [1, [], {}, {a: [2, {b: 3}]}]\n\"odd: "
      "key\": 1\n";
  const auto once = parsed(text).dump();
  const auto again = parsed(once);
  EXPECT_EQ(again.dump(), once);
  EXPECT_EQ(again.text("name"), "a: b # c");
  EXPECT_EQ(again.text("lines"), "one\ntwo\t\"");
  EXPECT_EQ(again.text("folded"), parsed(text).text("folded"));
  EXPECT_EQ(again.integer("number"), 5);
  EXPECT_NE(complaint([&] { (void)again.integer("number_text"); }), "(accepted)");
  EXPECT_EQ(again.text("null_text"), "null");
  EXPECT_EQ(again.list("list")[3].list("a")[1].integer("b"), 3);
  EXPECT_EQ(again.integer("odd: key"), 1);
}

class ConfigFiles : public testing::Test {
 protected:
  void SetUp() override {
    dir_ = std::filesystem::temp_directory_path() / ("rigor_config_" + std::to_string(::getpid()));
    std::filesystem::create_directories(dir_);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }
  std::filesystem::path dir_;
};

TEST_F(ConfigFiles, AreLoadedWithTheirFolder) {
  std::ofstream(dir_ / "rig.yaml") << "world: world.yaml\nsub: {x: 1}\n";
  const auto n = ConfigDocument::load(dir_ / "rig.yaml");
  ASSERT_TRUE(n.has_value()) << n.error().text();
  EXPECT_EQ(n->base_dir(), dir_);
  EXPECT_EQ(n->map("sub").base_dir(), dir_);
  EXPECT_EQ(n->map("sub").place(), (dir_ / "rig.yaml").string() + ":2:6");
}

TEST_F(ConfigFiles, ThatAreMissingOrNoFilesAreNamed) {
  const auto missing = ConfigDocument::load(dir_ / "gone.yaml");
  ASSERT_FALSE(missing.has_value());
  EXPECT_EQ(missing.error().code, ErrorCode::not_found);
  EXPECT_EQ(missing.error().exit_status(), 2);
  EXPECT_EQ(missing.error().text(), (dir_ / "gone.yaml").string() +
                                        ": expected a YAML file, got nothing: no such file (looked in " +
                                        dir_.string() + ")");
  const auto folder = ConfigDocument::load(dir_);
  ASSERT_FALSE(folder.has_value());
  EXPECT_EQ(folder.error().message, "expected a YAML file, got a directory");
}

TEST_F(ConfigFiles, OfAnyLengthAreReadNoFurtherThanTheLimit) {
  const auto endless = ConfigDocument::load("/dev/zero");
  ASSERT_FALSE(endless.has_value());
  EXPECT_EQ(endless.error().message, "expected at most 16 MiB of YAML, got more");
}

TEST(ConfigText, WithControlCharactersOrALaterByteOrderMarkIsRefusedAtItsPlace) {
  const auto bell = ConfigDocument::parse("a: 1\nb: \x07\n", "f");
  ASSERT_FALSE(bell.has_value());
  EXPECT_EQ(bell.error().text(), "f:2:4: expected text, got the control character 7");
  EXPECT_FALSE(ConfigDocument::parse("a: 1\n\xEF\xBB\xBF b: 2\n", "f").has_value());
  EXPECT_TRUE(ConfigDocument::parse("\xEF\xBB\xBF"
                                    "a: 1\r\nb:\t2\n",
                                    "f")
                  .has_value());
  EXPECT_FALSE(ConfigOverride::parse("a\x01=2").has_value());
}

}  // namespace
}  // namespace rigor

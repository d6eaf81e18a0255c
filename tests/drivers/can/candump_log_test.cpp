// Logs of can-utils, line for line.
#include "drivers/can/candump_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

namespace rigor::can {
namespace {

using testing::HasSubstr;

std::string there_and_back(std::string_view line) {
  const auto e = parse_log_line(line);
  return e ? format_log_line(*e) : e.error().text();
}

TEST(CandumpLog, LinesComeBackByteForByte) {
  for (const std::string line : {
           "(1436509052.249713) vcan0 044#2A366C2BBA",
           "(1436509052.449847) vcan0 0F6#7ADFE07BD2",
           "(1436509052.650004) can1 7FF#",
           "(0000000000.000000) vcan0 000#00",
           "(1436509053.250106) vcan0 1F334455#1122334455667788",
           "(1436509053.850870) vcan0 00000001#01",
           "(1436509053.850870) vcan0 123#R",
           "(1436509053.850870) vcan0 123#R8",
           "(1436509053.850870) vcan0 1FFFFFFF#R3",
           "(1436509053.850870) vcan0 20000004#0004000000000000",
           "(1436509053.850870) vcan0 20000040#0000000000000000",
           "(1436509053.850870) vcan0 213##311",
           "(1436509053.850870) vcan0 213##0",
           "(1436509053.850870) vcan0 1F334455##5000102030405060708090A0B0C0D0E0F10111213",
           "(1436509053.850870123) vcan0 044#2A",
           "(1436509053.850870) vcan0 044#2A R",
           "(1436509053.850870) vcan0 044##12A T",
           "(1436509053.850870) vcan0 500#1122334455667788_E",
           "(1436509053.850870) vcan0 500#R8_9",
       })
    EXPECT_EQ(there_and_back(line), line);
}

TEST(CandumpLog, EntriesSayWhatTheLineSays) {
  auto e = parse_log_line("(1436509052.249713) vcan0 1F334455##5AABB");
  ASSERT_TRUE(e);
  EXPECT_EQ(e->t.ns(), 1436509052249713000);
  EXPECT_EQ(e->interface_name(), "vcan0");
  EXPECT_TRUE(e->frame.extended);
  EXPECT_EQ(e->frame.id, 0x1f334455u);
  EXPECT_TRUE(e->frame.fd);
  EXPECT_TRUE(e->frame.bit_rate_switch);
  EXPECT_EQ(e->frame.length, 2);
  EXPECT_EQ(e->frame.data[1], 0xbb);
  e = parse_log_line("(1.000001) can0 20000040#0000000000000000");
  ASSERT_TRUE(e);
  EXPECT_TRUE(e->frame.error);
  EXPECT_FALSE(e->frame.extended);
  EXPECT_EQ(e->frame.id, 0x40u);
}

TEST(CandumpLog, TolerantWhereTheToolsAre) {
  EXPECT_EQ(there_and_back("(1.000001)  vcan0  7ff#11.22.aB\r"), "(0000000001.000001) vcan0 7FF#1122AB");
}

TEST(CandumpLog, ErrorsGiveThePlace) {
  const auto bad = [](std::string_view line) {
    const auto e = parse_log_line(line, "a.log", 7);
    return e ? std::string("was accepted") : e.error().text();
  };
  EXPECT_EQ(bad("vcan0 044#"),
            "a.log:7:1: expected a time in parentheses, such as (1436509052.249713), got `vcan0 044#`");
  EXPECT_THAT(bad("(1.5) vcan0 044#"), HasSubstr("a.log:7:5: expected 6 digits"));
  EXPECT_THAT(bad("(99999999999.000000) vcan0 044#"), HasSubstr("at most 10 digits"));
  EXPECT_THAT(bad("(1.000000) vcan0"), HasSubstr("a.log:7:12: expected the name of an interface"));
  EXPECT_THAT(bad({"(1.000000) can\0 044#", 21}), HasSubstr("a.log:7:12: expected the name of an interface"));
  EXPECT_THAT(bad("(1.000000) averylonginterface 044#"), HasSubstr("up to 15 characters"));
  EXPECT_THAT(bad("(1.000000) vcan0 0441#"), HasSubstr("a.log:7:18: expected an identifier"));
  EXPECT_THAT(bad("(1.000000) vcan0 800#"), HasSubstr("an identifier"));
  EXPECT_THAT(bad("(1.000000) vcan0 FFFFFFFF#"), HasSubstr("an identifier"));
  EXPECT_THAT(bad("(1.000000) vcan0 044"), HasSubstr("a.log:7:21: expected `#`, got the end of the line"));
  EXPECT_THAT(bad("(1.000000) vcan0 044#1"), HasSubstr("a.log:7:22: expected pairs of digits"));
  EXPECT_THAT(bad("(1.000000) vcan0 044#112233445566778899"), HasSubstr("at most 8 bytes"));
  EXPECT_THAT(bad("(1.000000) vcan0 044##0" + std::string(130, '0')), HasSubstr("at most 64 bytes"));
  EXPECT_THAT(bad("(1.000000) vcan0 044#11 X"), HasSubstr("expected the end of the frame"));
  EXPECT_THAT(bad("(1.000000) vcan0 20000004#R"), HasSubstr("an error frame is no remote request"));
}

TEST(CandumpLog, FilesAreReadAndWritten) {
  const auto file =
      std::filesystem::temp_directory_path() / ("rigor_candump_" + std::to_string(::getpid()) + ".log");
  const std::string text =
      "(1436509052.249713) vcan0 044#2A366C2BBA\n(1436509052.449847) vcan0 "
      "0F6#7ADFE07BD2\n(1436509052.650004) vcan0 "
      "213##311223344\n";
  LogReader log(std::make_unique<std::istringstream>("# a comment\n\n" + text), "a.log");
  LogWriter out;
  ASSERT_TRUE(out.open(file));
  for (int round = 0; round < 2; ++round) {
    int frames = 0;
    for (auto e = log.next();; e = log.next(), ++frames) {
      ASSERT_TRUE(e) << e.error().text();
      if (!*e) break;
      if (round == 0) out.write(**e);
    }
    EXPECT_EQ(frames, 3);
    log.rewind();
  }
  ASSERT_TRUE(out.close());
  std::ifstream in(file);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(in), {}), text);
  EXPECT_TRUE(LogReader::open(file));
  std::filesystem::remove(file);
  EXPECT_FALSE(LogReader::open(file));
  EXPECT_FALSE(LogReader::open(std::filesystem::temp_directory_path()));
  EXPECT_FALSE(LogWriter().open("/nowhere/at/all.log"));
}

TEST(CandumpLog, ReadsLineByLineAndSaysWhereItIsNone) {
  const auto error = [](const std::string& text) {
    LogReader log(std::make_unique<std::istringstream>(text), "a.log");
    while (true) {
      const auto e = log.next();
      if (!e) return e.error().text();
      if (!*e) return std::string("(good)");
    }
  };
  const std::string line = "(1.000000) vcan0 044#2A";
  EXPECT_EQ(error(line), "(good)");  // without a line end
  EXPECT_EQ(error(line + "\r\n\n#" + std::string(4000, 'x') + "\n" + line + "\n"), "(good)");
  EXPECT_THAT(error(line + "\n" + line + "X"), HasSubstr("a.log:2:24: expected the end of the frame"));
  EXPECT_THAT(error(line + "\n" + std::string(100'000, '(')),
              HasSubstr("a.log:2:1: expected a line of less than 4096"));
  EXPECT_THAT(error(line + std::string("\0", 1) + line), HasSubstr("a.log:1:24: expected"));
}

TEST(CandumpLog, AFullDiskIsToldAtTheEnd) {
  if (::access("/dev/full", W_OK) != 0) GTEST_SKIP() << "this machine has no /dev/full";
  LogWriter out;
  ASSERT_TRUE(out.open("/dev/full"));
  for (int i = 0; i < 5000; ++i) out.write({});
  const auto s = out.close();
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::disk_full);
}

}  // namespace
}  // namespace rigor::can

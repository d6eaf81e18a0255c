// The emulator as clients see it: well-behaved, slow, gone, and hostile ones.
#include "drivers/sick/scanner_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <random>

#include "drivers/sick/scan_data.h"
#include "tests/drivers/sick/sick_test_tools.h"
#include "tests/paths.h"

namespace rigor::sick {
namespace {

using test::eventually;
using test::PlainClient;
using test::text_of;
using namespace std::string_view_literals;

class Server : public testing::Test {
 protected:
  void start(ScannerServer::Options options = {}, double frequency_hz = 50) {
    ScannerConfig c = scanner_config(Family::lms1xx);
    c.pattern = {-45, 0.5, 541};
    c.scan_frequency_hz = frequency_hz;
    server = std::make_unique<ScannerServer>(
        c, [this](std::uint64_t, BenchTime) { return std::optional<std::span<const LidarPoint>>(points); },
        options);
    ASSERT_TRUE(server->listen("127.0.0.1", 0));
    ASSERT_TRUE(server->start());
  }
  static void subscribe(PlainClient& c) {
    ASSERT_EQ(text_of(c.ask("sEN", "LMDscandata", {1})), "sEA LMDscandata \1"sv);
  }
  std::vector<LidarPoint> points{{1, 0, 0, 50, 0, 0, 0, 0}};
  std::unique_ptr<ScannerServer> server;
};

TEST_F(Server, ServesSeveralClientsEachWithItsOwnLoginAndStream) {
  start();
  PlainClient a(server->port()), b(server->port()), c(server->port());
  EXPECT_EQ(text_of(a.ask("sMN", "SetAccessMode", {3, 0xF4, 0x72, 0x47, 0x44})), "sAN SetAccessMode \1"sv);
  EXPECT_EQ(text_of(a.ask("sWN", "FREchoFilter", {1})), "sWA FREchoFilter "sv);
  EXPECT_EQ(text_of(b.ask("sWN", "FREchoFilter", {1})), "sFA\0\n"sv) << "a's log-in is a's";
  subscribe(a);
  subscribe(b);
  std::uint16_t last = 0;
  for (PlainClient* client : {&a, &b}) {
    for (int i = 0; i < 5; ++i) {
      const Buffer body = client->receive();
      const auto t = parse_telegram(body);
      ASSERT_TRUE(t && t->is("sSN", "LMDscandata"));
      ScanData s;
      ASSERT_EQ(decode_scan(t->values, s), ScanError::none);
      EXPECT_EQ(s.channels16[0].values[270], 1000);
      if (i > 0) {
        EXPECT_EQ(static_cast<std::uint16_t>(s.scan_counter - last), 1);
      }
      last = s.scan_counter;
    }
  }
  EXPECT_EQ(text_of(c.ask("sRN", "FirmwareVersion")), "sRA FirmwareVersion \0\x10V1.36-21.10.2010"sv)
      << "no stream in between";
  ScanData polled;
  const Buffer body = c.ask("sRN", "LMDscandata");
  const auto t = parse_telegram(body);
  ASSERT_TRUE(t && t->is("sRA", "LMDscandata"));
  EXPECT_EQ(decode_scan(t->values, polled), ScanError::none);
  EXPECT_EQ(text_of(a.ask("sEN", "LMDscandata", {0})), "sEA LMDscandata \0"sv);
}

TEST_F(Server, TurnsAwayOneClientTooMany) {
  start({.max_clients = 2});
  PlainClient a(server->port()), b(server->port());
  ASSERT_FALSE(a.ask("sRN", "DeviceIdent").empty());
  ASSERT_FALSE(b.ask("sRN", "DeviceIdent").empty());
  PlainClient c(server->port());
  EXPECT_TRUE(c.closed_by_peer());
  EXPECT_EQ(server->counters().turned_away, 1u);
  a.close();
  ASSERT_TRUE(eventually([&] { return server->counters().clients == 1; }));
  PlainClient d(server->port());
  EXPECT_FALSE(d.ask("sRN", "DeviceIdent").empty());
}

// One client reads nothing, the other everything: the second misses no scan, the first misses many and later
// sees by the counter how many.
TEST_F(Server, ASlowClientMissesScansAndHoldsUpNobody) {
  start({.stall_limit = seconds(60), .max_pending = 8 * 1024, .send_buffer = 4096}, 50);
  PlainClient slow(server->port(), 2048), quick(server->port());
  subscribe(slow);
  subscribe(quick);
  std::uint16_t last = 0;
  bool first = true;
  const auto read_one = [](PlainClient& c) {
    const Buffer body = c.receive();
    const auto t = parse_telegram(body);
    ScanData s;
    EXPECT_TRUE(t && decode_scan(t->values, s) == ScanError::none);
    return s.scan_counter;
  };
  for (int i = 0; i < 2000 && server->counters().scans_skipped < 20; ++i) {
    const auto n = read_one(quick);
    if (!first) {
      ASSERT_EQ(static_cast<std::uint16_t>(n - last), 1);
    }
    first = false, last = n;
  }
  ASSERT_GE(server->counters().scans_skipped, 20u);
  std::uint32_t gaps = 0;
  std::uint16_t before = read_one(slow);
  for (int i = 0; i < 400 && gaps == 0; ++i) {
    const auto n = read_one(slow);
    gaps += static_cast<std::uint16_t>(n - before) - 1u;
    before = n;
  }
  EXPECT_GE(gaps, 1u);
  EXPECT_EQ(slow.parser().bad_checksums(), 0u) << "whole scans are left out, never parts";
}

TEST_F(Server, DropsWhoReadsNothingOrSaysNothingForLong) {
  start({.idle_limit = milliseconds(300),
         .stall_limit = milliseconds(300),
         .max_pending = 8 * 1024,
         .send_buffer = 4096},
        200);
  PlainClient idle(server->port()), stuck(server->port(), 2048), half(server->port());
  subscribe(stuck);
  const Buffer beginning = {2, 2, 2, 2, 0, 0, 0, 19, 's', 'R', 'N'};
  ASSERT_TRUE(half.send(beginning));
  ASSERT_TRUE(eventually([&] { return server->counters().dropped >= 3; }));
  EXPECT_TRUE(idle.closed_by_peer());
  EXPECT_TRUE(half.closed_by_peer());
  EXPECT_EQ(server->counters().clients, 0u);
}

/// One byte at a time, for far longer than the limit, keeps no place.
TEST_F(Server, DropsWhoseRequestDoesNotComeToItsEnd) {
  start({.idle_limit = milliseconds(50)});
  PlainClient trickle(server->port());
  ASSERT_TRUE(trickle.send(Buffer{2, 2, 2, 2, 0, 0, 4, 0}));
  int sent = 0;
  for (; sent < 1000 && server->counters().dropped == 0; ++sent) {
    (void)trickle.send(Buffer{'s'});
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_LT(sent, 1000) << "five seconds of single bytes kept the place";
}

TEST_F(Server, OversizeAndGarbageCostTheirOwnConnection) {
  start();
  PlainClient good(server->port()), oversize(server->port()), garbage(server->port()), flood(server->port());
  subscribe(good);
  Buffer big;
  append_frame(Buffer(100'000, 'x'), big);
  (void)oversize.send(big);
  EXPECT_TRUE(oversize.closed_by_peer());
  std::mt19937 random(3);
  Buffer noise(70'000);
  for (auto& b : noise) b = static_cast<std::uint8_t>(random());
  (void)garbage.send(noise);
  (void)garbage.send(noise);
  EXPECT_TRUE(garbage.closed_by_peer());
  // Requests without end whose answers nobody reads.
  Buffer requests;
  for (int i = 0; i < 200; ++i) append_telegram(requests, "sRN", "LMDscandata");
  for (int i = 0; i < 2000 && flood.send(requests); ++i) {
    if (server->counters().dropped >= 3) break;
  }
  EXPECT_TRUE(eventually([&] { return server->counters().dropped >= 3; }));
  for (int i = 0; i < 5; ++i) EXPECT_FALSE(good.receive().empty());
}

TEST_F(Server, RequestsInPiecesAreAnsweredWhenTheyAreWhole) {
  start();
  PlainClient c(server->port());
  Buffer request;
  append_telegram(request, "sRN", "DeviceIdent");
  for (const auto b : request) ASSERT_TRUE(c.send(Bytes(&b, 1)));
  EXPECT_TRUE(text_of(c.receive()).starts_with("sRA DeviceIdent "));
}

// The client that others wrote for these scanners in Python, with nothing of ours in it: how much of a scan
// an independent reader understands.
TEST_F(Server, AnIndependentReaderUnderstandsItsScans) {
  if (std::system("python3 -c 1 >/dev/null 2>&1") != 0) GTEST_SKIP() << "python3 is not installed";
  points.clear();
  for (int b = 0; b < 541; ++b) {
    const double a = (-135 + 0.5 * b) * 0.017453292519943295, r = 2 + b * 0.01;
    points.push_back({static_cast<float>(r * std::cos(a)), static_cast<float>(r * std::sin(a)), 0,
                      static_cast<float>(b % 256), 0, 0, 0, 0});
  }
  start();
  const std::string command = "python3 " + rigor::test::source_dir() +
                              "/tests/drivers/sick/independent_reader.py " + std::to_string(server->port());
  std::FILE* pipe = ::popen(command.c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  std::string out;
  char line[4096];
  while (std::fgets(line, sizeof line, pipe)) out += line;
  EXPECT_EQ(::pclose(pipe), 0) << out;
  EXPECT_THAT(out, testing::HasSubstr("10 scans, 541 beams, 0 lost"));
}

}  // namespace
}  // namespace rigor::sick

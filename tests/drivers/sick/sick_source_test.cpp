// The source over TCP: against the emulator, against a recording that is played back, and against devices
// that go away, lie, or say nothing.
#include "drivers/sick/sick_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "drivers/sick/scan_data.h"
#include "drivers/sick/sick_virtual_source.h"
#include "tests/drivers/sick/recorded_dialogue.h"
#include "tests/drivers/sick/sick_test_tools.h"

namespace rigor::sick {
namespace {

using test::config_of;
using test::eventually;
using test::FormulaScan;

class Bench : public testing::Test {
 protected:
  void start_emulator(std::shared_ptr<SampleProvider> provider, const std::string& params = "{port: 0}") {
    emulator = std::make_unique<SickEmulator>();
    emulator->attach(test::parts_of(std::move(provider)));
    auto s = emulator->configure(config_of(params));
    if (s) s = emulator->arm({});
    ASSERT_TRUE(s) << s.error().text();
    port = emulator->port();
    ASSERT_TRUE(emulator->start(bench_now()));
  }
  ChannelConfig channel(const std::string& more = "", Duration period = milliseconds(20)) {
    return config_of("{address: 127.0.0.1, port: " + std::to_string(port) + ", timeout_ms: 5000" + more + "}",
                     period);
  }
  void start_source(const ChannelConfig& config, BenchTime t0 = bench_now()) {
    auto s = source.configure(config);
    if (s) s = source.arm({});
    if (s) s = source.start(t0);
    ASSERT_TRUE(s) << s.error().text();
  }
  bool collect(std::size_t n) {
    const std::size_t until = samples.size() + n;
    return eventually([&] {
      while (auto lease = source.poll(bench_now())) {
        samples.push_back(lease->stamp);
        const auto* p = reinterpret_cast<const LidarPoint*>(lease->bytes().data());
        points.assign(p, p + lease->as<PointCloudInfo>()->count);
      }
      return samples.size() >= until;
    });
  }
  std::unique_ptr<SickEmulator> emulator;
  std::uint16_t port = 0;
  SickSource source;
  std::vector<Stamp> samples;
  std::vector<LidarPoint> points;  ///< of the newest
};

TEST_F(Bench, PointsComeOverTheNetworkAsTheyWereMeasured) {
  start_emulator(std::make_shared<FormulaScan>());
  start_source(channel());
  ASSERT_TRUE(collect(25));
  EXPECT_EQ(source.describe().max_bytes % sizeof(LidarPoint), 0u);
  for (std::size_t i = 1; i < samples.size(); ++i) {
    EXPECT_EQ(samples[i].sequence, samples[i - 1].sequence + 1 + samples[i].lost_before);
    EXPECT_EQ(samples[i].t_release - samples[i].t_capture, milliseconds(40));
    EXPECT_GE(samples[i].t_arrival, samples[i].t_capture);
    EXPECT_EQ(samples[i].validity, kValid);
    EXPECT_GT(samples[i].sigma_capture.ns(), 0);
  }
  // One echo of each beam that had one; every beam where it was.
  ASSERT_EQ(points.size(), 541u - 54);
  const auto scan =
      static_cast<std::uint64_t>(std::lround((std::hypot(points[0].x_m, points[0].y_m) - 1) * 10));
  std::size_t at = 0;
  for (std::size_t b = 0; b < 541; ++b) {
    if (b % 10 == 9) continue;
    const LidarPoint& p = points[at++];
    EXPECT_NEAR(std::hypot(p.x_m, p.y_m), FormulaScan::range_m(scan, b, 0), 6e-4) << b;
    EXPECT_NEAR(
        std::remainder(std::atan2(p.y_m, p.x_m) * 57.29577951308232 - (-135 + 0.5 * static_cast<double>(b)),
                       360),
        0, 1e-3);
    EXPECT_EQ(p.remission, FormulaScan::remission(b, 0));
    EXPECT_NEAR(p.t_offset_ns, static_cast<double>(b) * 0.5 / 360 / 50 * 1e9, 600);
    EXPECT_EQ(p.ring, 0);
    EXPECT_EQ(p.return_index, 0);
  }
  ASSERT_TRUE(source.stop());
  EXPECT_FALSE(source.health().connected);
}

// The emulator knows when the first beam was fired; the source finds it by the arrivals alone.
TEST_F(Bench, TheDeviceClockIsMappedToTheBench) {
  start_emulator(std::make_shared<FormulaScan>());
  start_source(channel());
  ASSERT_TRUE(collect(30));
  // First beams lie on the emulator's grid: t_capture differs from it by the same delay each time.
  std::vector<double> residual;
  for (std::size_t i = 10; i < samples.size(); ++i)
    residual.push_back((samples[i].t_capture - samples[10].t_capture).seconds() -
                       static_cast<double>(samples[i].sequence - samples[10].sequence) * 0.02);
  for (const double r : residual) EXPECT_NEAR(r, 0, 4e-3);
  // Fired 17.5 ms + 0.5 ms before the telegram went out; loopback adds little, scheduling more, never less.
  std::int64_t least = 1'000'000'000;
  for (const auto& s : samples) least = std::min(least, (s.t_arrival - s.t_capture).ns());
  EXPECT_GT(least, 15'000'000 - 1'000'000);
  ASSERT_TRUE(source.stop());
}

TEST_F(Bench, SetsUpEchoesRangeAndInterval) {
  start_emulator(std::make_shared<FormulaScan>(), "{port: 0, device: lms5xx}");
  start_source(channel(", echoes: all, start_deg: -90, stop_deg: 90, output_interval: 2, rssi: 16_bit",
                       milliseconds(40)));
  ASSERT_TRUE(collect(5));
  std::size_t second = 0;
  for (const auto& p : points) {
    const double deg = std::atan2(p.y_m, p.x_m) * 57.29577951308232;
    EXPECT_GE(deg, -90.001);
    EXPECT_LE(deg, 90.001);
    second += p.return_index == 1;
    EXPECT_LE(p.return_index, 1);
  }
  // Beams 90 … 450 of the 541; every tenth has nothing, every seventh two.
  std::size_t one = 0, two = 0;
  for (int b = 90; b <= 450; ++b) one += b % 10 != 9, two += b % 10 != 9 && b % 7 == 0;
  EXPECT_EQ(points.size(), one + two);
  EXPECT_EQ(second, two);
  for (std::size_t i = 1; i < samples.size(); ++i) {
    EXPECT_EQ(samples[i].sequence, samples[i - 1].sequence + 1 + samples[i].lost_before);
    EXPECT_GT((samples[i].t_capture - samples[i - 1].t_capture).seconds(), 0.03);
  }
  ASSERT_TRUE(source.stop());
}

TEST_F(Bench, AKilledDeviceIsFoundAgainAndItsScansAreCounted) {
  auto samples_of = std::make_shared<FormulaScan>();
  start_emulator(samples_of);
  start_source(channel());
  ASSERT_TRUE(collect(10));
  const auto config = config_of("{port: " + std::to_string(port) + "}");
  emulator.reset();
  ASSERT_TRUE(eventually([&] { return !source.health().connected; }));
  while (source.poll(bench_now())) samples.emplace_back();
  const std::size_t before = samples.size();
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  start_emulator(samples_of, "{port: " + std::to_string(port) + "}");
  ASSERT_TRUE(collect(10));
  const HealthSnapshot h = source.health();
  EXPECT_TRUE(h.connected);
  EXPECT_EQ(h.reconnects, 1u);
  const Stamp& first = samples[before];
  EXPECT_GE(first.lost_before, 8u) << "200 ms at 50 Hz, at least";
  EXPECT_EQ(
      h.lost, first.lost_before + [&] {
        std::uint64_t more = 0;
        for (std::size_t i = before + 1; i < samples.size(); ++i) more += samples[i].lost_before;
        return more;
      }());
  ASSERT_TRUE(source.stop());
}

TEST_F(Bench, StopsAtOnceWhileTheDeviceIsAway) {
  start_emulator(std::make_shared<FormulaScan>());
  start_source(channel());
  ASSERT_TRUE(collect(1));
  emulator.reset();
  ASSERT_TRUE(eventually([&] { return !source.health().connected; }));
  ASSERT_TRUE(source.stop());
  EXPECT_EQ(source.state(), ChannelState::configured);
}

TEST_F(Bench, ScansThatTheDeviceDidNotMakeAreCounted) {
  auto slow = std::make_shared<FormulaScan>();
  start_emulator(slow);
  start_source(channel());
  ASSERT_TRUE(collect(5));
  slow->delay_us = 130'000;
  ASSERT_TRUE(collect(3));
  slow->delay_us = 0;
  ASSERT_TRUE(collect(3));
  std::uint64_t lost = 0;
  for (std::size_t i = 1; i < samples.size(); ++i) {
    EXPECT_EQ(samples[i].sequence, samples[i - 1].sequence + 1 + samples[i].lost_before);
    lost += samples[i].lost_before;
  }
  EXPECT_GE(lost, 4u);
  EXPECT_EQ(source.health().lost, lost);
  ASSERT_TRUE(source.stop());
}

TEST_F(Bench, SaysAtArmWhatIsWrong) {
  EXPECT_THAT(source.configure(config_of("{port: 2112}")).error().text(), testing::HasSubstr("address"));
  EXPECT_THAT(source.configure(config_of("{address: 127.0.0.1, password_hash: nonsense}")).error().text(),
              testing::HasSubstr("expected 8 hexadecimal digits"));
  EXPECT_THAT(
      source.configure(config_of("{address: 127.0.0.1, start_deg: 10, stop_deg: -10}")).error().text(),
      testing::HasSubstr("stop_deg"));
  {
    test::PlainClient nobody(1);
    ASSERT_TRUE(source.configure(config_of("{address: 127.0.0.1, port: 1}")));
    const auto s = source.arm({});
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().code, ErrorCode::not_found);
    EXPECT_THAT(s.error().text(), testing::HasSubstr("rigor emulate"));
  }
  start_emulator(std::make_shared<FormulaScan>());
  ASSERT_TRUE(source.configure(channel("", milliseconds(40))));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("expected a device that scans at 25 Hz"));
  EXPECT_EQ(source.state(), ChannelState::configured);
}

/// A listener that does with its first client what the test wants.
class OddDevice {
 public:
  explicit OddDevice(std::function<void(int)> serve) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in a{};
    a.sin_family = AF_INET;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof a;
    EXPECT_EQ(::bind(listener_, reinterpret_cast<const sockaddr*>(&a), sizeof a), 0);
    EXPECT_EQ(::listen(listener_, 4), 0);
    ::getsockname(listener_, reinterpret_cast<sockaddr*>(&a), &size);
    port = ntohs(a.sin_port);
    thread_ = std::thread([this, serve = std::move(serve)] {
      const int s = ::accept(listener_, nullptr, nullptr);
      if (s < 0) return;
      serve(s);
      ::close(s);
    });
  }
  ~OddDevice() {
    ::shutdown(listener_, SHUT_RDWR);
    ::close(listener_);
    thread_.join();
  }
  std::uint16_t port = 0;

 private:
  int listener_ = -1;
  std::thread thread_;
};

TEST_F(Bench, ADeviceThatSaysNothingTimesOut) {
  OddDevice silent([](int s) {
    char c;
    while (::recv(s, &c, 1, 0) > 0) {
    }
  });
  ASSERT_TRUE(source.configure(
      config_of("{address: 127.0.0.1, timeout_ms: 200, port: " + std::to_string(silent.port) + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::timeout);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("CoLa-B"));
}

TEST_F(Bench, ADeviceThatHangsUpIsToldFromOneThatIsSilent) {
  OddDevice rude([](int) {});
  ASSERT_TRUE(source.configure(config_of("{address: 127.0.0.1, port: " + std::to_string(rude.port) + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::protocol);
}

/// Plays a recorded device: each request gets the answer that the device gave to that request (an error to
/// others), and after the subscription come its scans, with noise and a broken checksum in between.
void play(int socket, const std::vector<Buffer>& payloads, bool with_faults) {
  FrameParser parser;
  std::vector<Buffer> scans;
  for (const auto& p : payloads) {
    const std::string text(p.begin() + 8, p.end());
    if (text.starts_with("sSN LMDscandata")) scans.push_back(p);
  }
  bool streaming = false;
  while (!streaming) {
    const auto n = ::recv(socket, parser.room(4096).data(), 4096, 0);
    if (n <= 0) return;
    parser.added(static_cast<std::size_t>(n));
    for (Bytes b = parser.next(); b.data(); b = parser.next()) {
      Buffer request;
      append_frame(b, request);
      const auto t = parse_telegram(b);
      Buffer answer;
      for (std::size_t i = 0; i + 1 < payloads.size() && answer.empty(); ++i)
        if (payloads[i] == request) answer = payloads[i + 1];
      if (answer.empty()) {
        // Not asked by SICK's driver in these words: what the device says when it has been told so.
        if (t->name == "LMDscandatacfg" || t->name == "FREchoFilter")
          append_telegram(answer, t->type == "sWN" ? "sWA" : "sRA", t->name, t->values);
        else if (t->name == "SetAccessMode")
          append_telegram(answer, "sAN", t->name, Buffer{0});  // another device's password
        else
          append_error(answer, SopasError::unknown_variable);
      }
      if (::send(socket, answer.data(), answer.size(), MSG_NOSIGNAL) < 0) return;
      streaming = t->is("sEN", "LMDscandata");
    }
  }
  std::size_t k = 0;
  for (const auto& scan : scans) {
    Buffer piece = scan;
    if (with_faults && k % 10 == 3) piece.insert(piece.begin(), {'n', 'o', 'i', 's', 'e', 2, 2});
    if (with_faults && k % 10 == 7) piece.back() ^= 1;
    ++k;
    // In two halves, as networks do.
    const std::size_t half = piece.size() / 2;
    if (::send(socket, piece.data(), half, MSG_NOSIGNAL) < 0) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    if (::send(socket, piece.data() + half, piece.size() - half, MSG_NOSIGNAL) < 0) return;
  }
  char c;
  while (::recv(socket, &c, 1, 0) > 0) {
  }
}

class RecordedDevice : public Bench, public testing::WithParamInterface<test::Recording> {};

TEST_P(RecordedDevice, IsUnderstoodFromLoginToItsLastScan) {
  const auto& r = GetParam();
  RIGOR_SKIP_WITHOUT_RECORDING(r);
  const auto payloads = test::read_payloads(test::recording_path(r));
  OddDevice device([&](int s) { play(s, payloads, false); });
  start_source(
      config_of("{address: 127.0.0.1, buffers: 200, timeout_ms: 10000, port: " + std::to_string(device.port) +
                    (r.wide_rssi ? ", rssi: 16_bit" : ", rssi: 8_bit") + "}",
                seconds_from(1 / r.frequency_hz), milliseconds(100)),
      BenchTime(0));  // played faster than recorded: its first scans are of long ago
  ASSERT_TRUE(collect(r.scans));
  EXPECT_EQ(source.health().lost, 0u);
  EXPECT_EQ(source.health().protocol_errors, 0u);
  for (std::size_t i = 1; i < samples.size(); ++i) EXPECT_EQ(samples[i].sequence, i);
  EXPECT_GT(points.size(), r.beams / 2);
  ASSERT_TRUE(source.stop());
}
TEST_P(RecordedDevice, WhatIsBrokenOnTheWayIsCountedAndTheRestArrives) {
  const auto& r = GetParam();
  RIGOR_SKIP_WITHOUT_RECORDING(r);
  const auto payloads = test::read_payloads(test::recording_path(r));
  OddDevice device([&](int s) { play(s, payloads, true); });
  start_source(
      config_of("{address: 127.0.0.1, buffers: 200, timeout_ms: 10000, port: " + std::to_string(device.port) +
                    (r.wide_rssi ? ", rssi: 16_bit" : ", rssi: 8_bit") + "}",
                seconds_from(1 / r.frequency_hz), milliseconds(100)),
      BenchTime(0));  // played faster than recorded: its first scans are of long ago
  const std::size_t broken = (r.scans + 2) / 10;
  ASSERT_TRUE(collect(r.scans - broken));
  EXPECT_EQ(source.health().lost, broken);
  EXPECT_EQ(source.health().protocol_errors, broken);
  EXPECT_EQ(samples.back().sequence, r.scans - 1);
  ASSERT_TRUE(source.stop());
}
INSTANTIATE_TEST_SUITE_P(Sick, RecordedDevice, testing::Values(test::kLms511, test::kTim781),
                         [](const auto& i) { return std::string(i.index == 0 ? "LMS511" : "TiM781S"); });

// ------------------------------------------------------------------ virtual time

struct VirtualRun {
  std::vector<Stamp> stamps;
  std::vector<std::byte> bytes;
};
VirtualRun virtual_run(const std::string& channel, const std::string& emulator, Duration duration,
                       Duration period = milliseconds(20)) {
  SickVirtualSource source(test::parts_of(std::make_shared<FormulaScan>()), config_of(emulator).params);
  ArmContext context;
  context.virtual_time = true;
  auto s = source.configure(config_of(channel, period));
  if (s) s = source.arm(context);
  if (s) s = source.start(BenchTime(0));
  EXPECT_TRUE(s) << s.error().text();
  VirtualRun run;
  if (!s) return run;
  for (BenchTime now(0); now < BenchTime(0) + duration; now = now + milliseconds(1)) {
    source.complete_until(now);
    while (auto lease = source.poll(now)) {
      EXPECT_LE(lease->stamp.t_release, now);
      run.stamps.push_back(lease->stamp);
      run.bytes.insert(run.bytes.end(), lease->bytes().begin(), lease->bytes().end());
    }
  }
  EXPECT_TRUE(source.stop());
  return run;
}

TEST(VirtualScanner, RepeatsBitForBitOnTheBenchsGrid) {
  const VirtualRun a = virtual_run("{}", "{}", seconds(1)), b = virtual_run("{}", "{}", seconds(1));
  EXPECT_EQ(a.bytes, b.bytes);
  ASSERT_EQ(a.stamps.size(), b.stamps.size());
  ASSERT_EQ(a.stamps.size(), 48u);  // captured at k · 20 ms, released 40 ms later
  for (std::size_t k = 0; k < a.stamps.size(); ++k) {
    EXPECT_EQ(a.stamps[k].sequence, k);
    // The wire carries microseconds, cut off.
    EXPECT_LE((BenchTime(0) + milliseconds(20) * static_cast<std::int64_t>(k) - a.stamps[k].t_capture).ns(),
              1000);
    EXPECT_GE((BenchTime(0) + milliseconds(20) * static_cast<std::int64_t>(k) - a.stamps[k].t_capture).ns(),
              0);
    EXPECT_EQ(a.stamps[k].t_release, a.stamps[k].t_arrival);
  }
}

TEST(VirtualScanner, RefusesALatencyInWhichNoScanCanBeMade) {
  SickVirtualSource source(test::parts_of(std::make_shared<FormulaScan>()), config_of("{}").params);
  ArmContext context;
  context.virtual_time = true;
  ASSERT_TRUE(source.configure(config_of("{}", milliseconds(20), milliseconds(5))));
  const auto s = source.arm(context);
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("expected at least 15.5"));
}

TEST(VirtualScanner, NeedsTheSensorModelOfALidarWithOneBeam) {
  SickVirtualSource none(DeviceParts{}, config_of("{}").params);
  EXPECT_THAT(none.configure(config_of("{}")).error().text(), testing::HasSubstr("`sensor`"));
}

}  // namespace
}  // namespace rigor::sick

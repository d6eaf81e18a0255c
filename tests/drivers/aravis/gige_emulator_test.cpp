// The camera behind real sockets on loopback, driven by our own client: no third party, so that the
// sanitizers see it.
#include "drivers/aravis/gige_emulator.h"

#include <gtest/gtest.h>

#include <chrono>
#include <mutex>
#include <random>

#include "tests/drivers/aravis/gige_udp_test_tools.h"
#include "tests/eventually.h"

namespace rigor::gige {
namespace {

using testing::LossRelay;
using testing::UdpSocket;
using testing::UdpTransport;

DeviceTime now() { return DeviceTime(monotonic_now().ns()); }
void sleep_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

constexpr std::uint32_t kOwnIp = 0x7F000001;

FillFrame pattern() {
  return [](const FrameRequest& r, MutableBytes out) {
    testing::fill_pattern(r.timestamp_ticks, out);
    return true;
  };
}

std::unique_ptr<GigeEmulator> camera_at(const std::string& address, GigeCameraConfig c = {},
                                        FillFrame fill = pattern(), double link_bits_per_s = 1e9) {
  GigeEmulatorOptions o;
  o.link_bits_per_s = link_bits_per_s;
  o.address = address;
  o.camera = std::move(c);
  auto e = GigeEmulator::start(o, std::move(fill));
  EXPECT_TRUE(e) << e.error().text();
  return e ? std::move(*e) : nullptr;
}

struct Seen {
  std::uint64_t complete = 0, incomplete = 0, torn = 0;
};
Seen receive(GigeClient& client, std::uint64_t frames, int timeout_ms) {
  Seen s;
  const auto end = now() + milliseconds(timeout_ms);
  auto next_heartbeat = now() + milliseconds(500);
  AssembledFrame f;
  while (s.complete + s.incomplete < frames && now() < end) {
    if (!client.poll(now(), f)) {
      if (now() > next_heartbeat) {
        EXPECT_TRUE(client.heartbeat());
        next_heartbeat = now() + milliseconds(500);
      }
      std::this_thread::sleep_for(std::chrono::microseconds(500));
      continue;
    }
    ++(f.complete ? s.complete : s.incomplete);
    if (f.complete && !testing::has_pattern(f.leader.timestamp_ticks, f.data)) ++s.torn;
  }
  return s;
}

TEST(GigeEmulator, OneBroadcastActionExposesTwoCamerasInTheSameNanosecond) {
  GigeCameraConfig c;
  c.ptp = {.present = true, .settle = {}, .offset = {}};
  std::mutex mutex;
  std::vector<std::int64_t> began;
  const FillFrame fill = [&](const FrameRequest& r, MutableBytes out) {
    const std::scoped_lock lock(mutex);
    began.push_back(r.t_exposure_start.ns());
    std::fill(out.begin(), out.end(), std::uint8_t{1});
    return true;
  };
  auto one = camera_at("127.0.0.30", c, fill), two = camera_at("127.0.0.31", c, fill);
  UdpTransport to_one({0x7F00001E, kGvcpPort}, kOwnIp), to_two({0x7F00001F, kGvcpPort}, kOwnIp);
  GigeClient first(to_one), second(to_two);
  for (GigeClient* client : {&first, &second}) {
    ASSERT_TRUE(client->connect());
    const RegisterWrite steps[] = {{reg::kPtpEnable, 1},
                                   {reg::kTriggerMode, 1},
                                   {reg::kTriggerSource, reg::kTriggerSourceAction0},
                                   {reg::kActionDeviceKey, 5},
                                   {reg::kActionGroupMask, 1}};
    for (const auto& s : steps) ASSERT_TRUE(client->write(s.address, s.value));
    ASSERT_TRUE(client->start());
  }
  const UdpSocket sender({kOwnIp, 0});
  const int on = 1;
  ASSERT_EQ(setsockopt(sender.fd(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on), 0);
  const std::int64_t t = (now() + milliseconds(100)).ns();
  sender.send({0x7FFFFFFF, kGvcpPort}, encode_action_cmd(1, {5, 0, 1, static_cast<std::uint64_t>(t)}));
  std::vector<std::uint8_t> d(1024);
  for (int i = 0; i < 2; ++i) {
    const auto n = sender.receive(d, 2000);
    GvcpAck a;
    ASSERT_EQ(decode_gvcp_ack(Bytes(d).first(n), a), DecodeStatus::ok);
    EXPECT_EQ(a.status, GvStatus::success);
    EXPECT_EQ(a.command, static_cast<std::uint16_t>(GvcpCommand::action_ack));
  }
  for (GigeClient* client : {&first, &second}) EXPECT_EQ(receive(*client, 1, 5'000).complete, 1u);
  {
    const std::scoped_lock lock(mutex);
    EXPECT_EQ(began, (std::vector{t, t}));
  }
  // A broadcast write is nobody's.
  const RegisterWrite w{reg::kControlPrivilege, 0};
  sender.send({0x7FFFFFFF, kGvcpPort}, encode_write_register_cmd(2, std::span(&w, 1)));
  EXPECT_EQ(sender.receive(d, 200), 0u);
}

TEST(GigeEmulator, StreamsWithoutALostPacket) {
  auto camera = camera_at("127.0.0.21");
  UdpTransport link({0x7F000015, kGvcpPort}, kOwnIp);
  GigeClient client(link);
  ASSERT_TRUE(client.connect());
  ASSERT_TRUE(client.set_frame_rate(60));
  ASSERT_TRUE(client.start());
  const auto seen = receive(client, 120, 10'000);
  EXPECT_EQ(seen.complete, 120U);
  EXPECT_EQ(seen.torn, 0U);
  EXPECT_TRUE(client.stop());
  const auto h = camera->health();
  EXPECT_GE(h.frames_sent, 120U);
  EXPECT_EQ(h.send_errors, 0U);
  EXPECT_EQ(h.blocks_dropped, 0U);
}

// Seen to catch: a pool that filled a block anew while it was kept for resends (174 of 200 frames complete).
TEST(GigeEmulator, ResendsWhatARelayLost) {
  auto camera = camera_at("127.0.0.22");
  LossRelay relay({0x7F000017, kGvcpPort}, {0x7F000016, kGvcpPort}, 0.02, 42);
  UdpTransport link({0x7F000017, kGvcpPort}, kOwnIp);
  GigeClient client(link);
  ASSERT_TRUE(client.connect());
  ASSERT_TRUE(client.set_frame_rate(50));
  ASSERT_TRUE(client.start());
  const auto seen = receive(client, 200, 15'000);
  EXPECT_GE(seen.complete, 198U);
  EXPECT_EQ(seen.torn, 0U);
  EXPECT_GT(relay.lost(), 500U);
  EXPECT_GT(camera->health().packets_resent, 500U);
}

TEST(GigeEmulator, ASecondClientIsRefusedUntilTheFirstFallsSilent) {
  auto camera = camera_at("127.0.0.21");
  UdpTransport first_link({0x7F000015, kGvcpPort}, kOwnIp), second_link({0x7F000015, kGvcpPort}, kOwnIp);
  GigeClientOptions o;
  o.heartbeat_timeout_ms = 500;
  GigeClient first(first_link, o), second(second_link, o);
  ASSERT_TRUE(first.connect());
  ASSERT_TRUE(first.start());
  const auto refused = second.connect();
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("access denied"), std::string::npos);
  sleep_ms(800);
  EXPECT_FALSE(camera->health().controlled);
  EXPECT_FALSE(camera->health().acquiring);
  EXPECT_TRUE(second.connect());
  EXPECT_FALSE(first.set_gain(1));
}

TEST(GigeEmulator, FourCamerasOnOneMachineAnswerABroadcast) {
  std::vector<std::unique_ptr<GigeEmulator>> cameras;
  for (int i = 0; i < 4; ++i) {
    GigeCameraConfig c;
    c.serial = "CAM" + std::to_string(i);
    cameras.push_back(camera_at("127.0.0." + std::to_string(31 + i), c));
  }
  const UdpSocket asker({kOwnIp, 0});
  const int on = 1;
  setsockopt(asker.fd(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
  asker.send({0x7FFFFFFF, kGvcpPort}, encode_discovery_cmd(5));
  std::vector<std::uint8_t> d(2048);
  std::vector<std::string> serials;
  Endpoint from;
  while (const auto n = asker.receive(d, 300, &from)) {
    GvcpAck ack;
    ASSERT_EQ(decode_gvcp_ack(Bytes(d).first(n), ack), DecodeStatus::ok);
    EXPECT_EQ(std::get<DiscoveryAck>(ack.body).ip, from.ip);
    // Cameras of other tests, which run beside this one, hear it, too.
    const std::string serial = std::get<DiscoveryAck>(ack.body).serial;
    if (serial.starts_with("CAM")) serials.push_back(serial);
  }
  std::sort(serials.begin(), serials.end());
  EXPECT_EQ(serials, (std::vector<std::string>{"CAM0", "CAM1", "CAM2", "CAM3"}));
}

TEST(GigeEmulator, TestPacketHasTheSizeThatWasAskedFor) {
  auto camera = camera_at("127.0.0.21");
  UdpTransport link({0x7F000015, kGvcpPort}, kOwnIp);
  GigeClient client(link);
  ASSERT_TRUE(client.connect());
  for (const std::uint32_t size : {576U, 1400U, 8996U}) {
    ASSERT_TRUE(client.write(reg::kStreamPacketSize, reg::kFireTestPacket | reg::kDoNotFragment | size));
    std::vector<std::uint8_t> d(65536);
    std::size_t n = 0;
    for (int i = 0; i < 100 && n == 0; ++i, sleep_ms(2)) n = link.receive_stream(d);
    EXPECT_EQ(n + kIpUdpHeaderSize, size);
  }
}

/// The packets of a camera at 127.0.0.21 as they come, and a client that asks for single frames.
struct PacketsOfACamera {
  static constexpr Endpoint kCamera{0x7F000015, kGvcpPort};
  explicit PacketsOfACamera(double link_bits_per_s = 1e9)
      : camera(camera_at("127.0.0.21", {}, pattern(), link_bits_per_s)) {
    EXPECT_TRUE(client.connect());
    EXPECT_TRUE(client.write(reg::kStreamPort, stream.local().port));
    EXPECT_TRUE(client.set_acquisition(AcquisitionMode::single_frame));
    EXPECT_TRUE(client.set_exposure(milliseconds(1)));
  }
  /// The next one; its payload lies in `bytes`.
  GvspPacket next() {
    GvspPacket p;
    const std::size_t size = stream.receive(bytes, 10'000, &from);
    EXPECT_TRUE(decode_gvsp(Bytes(bytes).first(size), p));
    return p;
  }
  /// Starts an acquisition; from then to the last packet of its frame.
  Duration frame() {
    const auto began = now();
    EXPECT_TRUE(client.start());
    while (next().format != GvspFormat::trailer && !::testing::Test::HasFailure()) {
    }
    return now() - began;
  }
  void ask_for(std::uint64_t block, std::uint32_t first, std::uint32_t last) {
    stream.send(kCamera, encode_packet_resend_cmd(++id, {0, block, first, last, false}));
  }
  std::unique_ptr<GigeEmulator> camera;
  UdpTransport link{kCamera, kOwnIp};
  GigeClient client{link};
  UdpSocket stream{{kOwnIp, 0}};
  Endpoint from;
  std::vector<std::uint8_t> bytes = std::vector<std::uint8_t>(2048);
  std::uint16_t id = 100;
};

TEST(GigeEmulator, SaysItsSubnetAndThePortOfItsStream) {
  PacketsOfACamera c;
  (void)c.frame();
  EXPECT_EQ(c.from.ip, PacketsOfACamera::kCamera.ip);
  EXPECT_EQ(c.client.read(reg::kStreamSourcePort).value(), c.from.port);
  EXPECT_EQ(c.client.read(reg::kCurrentMask).value(), 0xFF000000U) << "of the loopback interface";
}

TEST(GigeEmulator, SendsTheRangeThatWasAskedForAndSaysWhatItNoLongerHas) {
  PacketsOfACamera c;
  (void)c.frame();
  c.ask_for(1, 3, 6);
  c.ask_for(77, 5, 9);
  for (const std::uint32_t packet : {3U, 4U, 5U, 6U}) {
    const auto p = c.next();
    EXPECT_EQ(p.block_id, 1U);
    EXPECT_EQ(p.packet_id, packet);
    EXPECT_EQ(p.status, GvStatus::success);
  }
  const auto p = c.next();
  EXPECT_EQ(p.status, GvStatus::packet_unavailable);
  EXPECT_EQ(p.block_id, 77U);
  EXPECT_EQ(p.packet_id, 5U);
  EXPECT_EQ(c.camera->health().packets_resent, 4U);
  EXPECT_EQ(c.camera->health().resends_unavailable, 1U);
}

TEST(GigeEmulator, QueuesABoundedNumberOfPacketsForResends) {
  constexpr int kAsked = 750;  // times 12 packets, more than the 8192 that may wait
  {
    PacketsOfACamera c;
    EXPECT_TRUE(c.client.set_region({0, 0, 128, 96}));
    (void)c.frame();
    for (int i = 0; i < kAsked; ++i) {
      c.ask_for(1, 0, 11);
      while (c.next().packet_id != 11 && !HasFailure()) {
      }
    }
    EXPECT_EQ(c.camera->health().resends_dropped, 0U) << "what was sent no longer waits";
  }
  PacketsOfACamera slow(1e6);
  EXPECT_TRUE(slow.client.set_region({0, 0, 128, 96}));
  (void)slow.frame();
  for (int i = 0; i < kAsked; ++i) {
    slow.ask_for(1, 0, 11);
    if (i % 50 == 0) {
      EXPECT_TRUE(slow.client.read(reg::kWidth)) << "its socket is empty again";
    }
  }
  EXPECT_TRUE(slow.client.read(reg::kWidth));
  const std::uint64_t dropped = slow.camera->health().resends_dropped;
  EXPECT_GT(dropped, 0U);
  EXPECT_EQ(dropped % 12, 0U);
}

TEST(GigeEmulator, SendsNoFasterThanItsLinkAndThePacketDelayAllow) {
  {
    PacketsOfACamera c(20e6);
    // 307200 bytes of picture and the headers of 227 packets, in bursts of 32 packets.
    EXPECT_GT(c.frame(), milliseconds(100));
  }
  PacketsOfACamera c;
  EXPECT_TRUE(c.client.set_region({0, 0, 128, 96}));  // 10 packets, leader and trailer
  EXPECT_TRUE(c.client.write(reg::kStreamPacketDelay, 10'000'000));
  EXPECT_GT(c.frame(), milliseconds(100));
}

TEST(GigeEmulator, DropsWhatItsLinkCannotCarry) {
  PacketsOfACamera c(1e6);
  EXPECT_TRUE(c.client.set_region({0, 0, 128, 96}));
  EXPECT_TRUE(c.client.set_acquisition(AcquisitionMode::continuous));
  EXPECT_TRUE(c.client.set_frame_rate(100));
  EXPECT_TRUE(c.client.start());
  EXPECT_TRUE(test::eventually([&] { return c.camera->health().blocks_dropped > 0; }));
}

TEST(GigeEmulator, HostileDatagramsAreCountedAndTheStreamGoesOn) {
  auto camera = camera_at("127.0.0.21");
  UdpTransport link({0x7F000015, kGvcpPort}, kOwnIp);
  GigeClient client(link);
  ASSERT_TRUE(client.connect());
  ASSERT_TRUE(client.set_frame_rate(30));
  ASSERT_TRUE(client.start());
  std::atomic<bool> stop{false};
  std::thread attacker([&stop] {
    const UdpSocket s({0x7F00004D, 0});
    std::mt19937 rng(3);
    std::vector<std::uint8_t> d(60'000);
    while (!stop) {
      for (int i = 0; i < 20; ++i) {
        const std::size_t n = rng() % 4 == 0 ? rng() % d.size() : rng() % 64;
        for (std::size_t k = 0; k < std::min<std::size_t>(n, 64); ++k)
          d[k] = static_cast<std::uint8_t>(rng());
        if (rng() % 2 == 0) d[0] = 0x42;
        s.send({0x7F000015, kGvcpPort}, Bytes(d).first(n));
      }
      // A stranger asks for the whole of every block, and for control.
      s.send({0x7F000015, kGvcpPort}, encode_packet_resend_cmd(1, {0, 1 + rng() % 100, 0, 0xFFFFFF, false}));
      const RegisterWrite w{reg::kControlPrivilege, 0};
      s.send({0x7F000015, kGvcpPort}, encode_write_register_cmd(2, std::span(&w, 1)));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  const auto seen = receive(client, 60, 10'000);
  stop = true;
  attacker.join();
  EXPECT_EQ(seen.complete, 60U);
  EXPECT_EQ(seen.torn, 0U);
  const auto h = camera->health();
  EXPECT_GT(h.malformed, 100U);
  EXPECT_TRUE(h.controlled);
  EXPECT_EQ(h.packets_resent, 0U);
}

TEST(GigeEmulator, ASlowRendererSkipsFramesAndKeepsTheGrid) {
  GigeCameraConfig c;
  c.frame_rate_hz = 50;
  std::mutex m;
  std::vector<DeviceTime> starts;
  auto camera = camera_at("127.0.0.21", c, [&](const FrameRequest& r, MutableBytes) {
    const std::scoped_lock lock(m);
    starts.push_back(r.t_exposure_start);
    sleep_ms(50);
    return starts.size() % 2 == 0;
  });
  UdpTransport link({0x7F000015, kGvcpPort}, kOwnIp);
  GigeClient client(link);
  ASSERT_TRUE(client.connect());
  ASSERT_TRUE(client.start());
  sleep_ms(600);
  ASSERT_TRUE(client.stop());
  camera->stop();
  ASSERT_GT(starts.size(), 4U);
  for (const auto t : starts) EXPECT_EQ((t - starts[0]).ns() % 20'000'000, 0);
  const auto h = camera->health();
  EXPECT_GT(h.exposures_skipped, 4U);
  EXPECT_GT(h.pictures_missing, 1U);
  EXPECT_GT(h.pictures_late, 1U);
}

TEST(GigeEmulator, ControlPortInUseAndForeignAddressAreSaid) {
  auto camera = camera_at("127.0.0.21");
  GigeEmulatorOptions o;
  o.address = "127.0.0.21";
  auto second = GigeEmulator::start(o, pattern());
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::unavailable);
  EXPECT_NE(second.error().message.find("another camera"), std::string::npos);
  o.address = "192.0.2.1";
  second = GigeEmulator::start(o, pattern());
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().message.find("no such address"), std::string::npos);
  o.address = "localhost";
  second = GigeEmulator::start(o, pattern());
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::bad_input);
  camera->stop();
  camera->stop();
  o.address = "127.0.0.21";
  camera.reset();
  EXPECT_TRUE(GigeEmulator::start(o, pattern()));
}

}  // namespace
}  // namespace rigor::gige

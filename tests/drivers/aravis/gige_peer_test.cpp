// Other people's programs on the emulated camera: arv-camera-test streams from it, arv-test tries all of it,
// and tshark's dissectors read what was on the wire, chunks and resends included.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <regex>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_channel_emulator.h"
#include "rt-core/file_descriptor.h"
#include "tests/drivers/aravis/aravis_test_tools.h"
#include "tests/drivers/aravis/range_pictures.h"

namespace rigor {
namespace {

bool installed(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0;
}
std::string say(const std::string& command) {
  std::string text;
  FILE* p = ::popen((command + " 2>&1").c_str(), "r");
  if (p == nullptr) return text;
  char b[512];
  while (const auto n = std::fread(b, 1, sizeof b, p)) text.append(b, n);
  ::pclose(p);
  return text;
}
std::string temporary(const std::string& name) {
  return (std::filesystem::temp_directory_path() / ("rigor-" + std::to_string(::getpid()) + "-" + name))
      .string();
}

/// Ends as a person would end it.
void run_camera_test(const std::string& keys, std::string& said) {
  said =
      say("timeout -s INT 3 arv-camera-test-0.8 --no-packet-socket --packet-size-adjustment=never "
          "--gv-packet-size=1400 " +
          keys);
}

TEST(GigePeer, ArvCameraTestStreamsWithoutLoss) {
  if (!installed("arv-camera-test-0.8")) GTEST_SKIP() << "arv-camera-test-0.8 is not installed";
  // A frame fits the receiver's socket buffer as machines have it by default, so that what is lost is ours.
  gige::GigeCameraConfig config;
  config.sensor_width_px = 320, config.sensor_height_px = 240;
  auto camera = testing::start_camera("127.0.0.91", "PEER91", gige::testing::fill_stamped, config);
  std::string said;
  run_camera_test("-n Rigor-PEER91 -f 25 -e 2000", said);
  // "n_completed_buffers    = 97" and so on.
  const auto number = [&](const std::string& name) {
    std::smatch m;
    return std::regex_search(said, m, std::regex(name + "\\s*=\\s*([0-9]+)")) ? std::stoll(m[1]) : -1;
  };
  EXPECT_GE(number("n_completed_buffers"), 20) << said;
  EXPECT_EQ(number("n_missing_frames"), 0) << said;
  EXPECT_EQ(number("n_missing_packets"), 0) << said;
  EXPECT_EQ(number("n_size_mismatch_errors"), 0) << said;
  EXPECT_EQ(camera->health().malformed, 0u);
}

/// What arv-test says of each of its tests, of a camera of its own.
void run_arv_test(const std::string& address, const std::string& serial, const std::string& more) {
  gige::GigeCameraConfig config;
  config.sensor_width_px = 320, config.sensor_height_px = 240;
  config.ptp.present = true;
  auto camera = testing::start_camera(address, serial, gige::testing::fill_stamped, config);
  const std::string said = say("timeout 60 arv-test-0.8 -n '*-" + serial + "'" + more);
  const auto lines = [&](const std::string& verdict) {
    const std::regex r(verdict);
    return std::distance(std::sregex_iterator(said.begin(), said.end(), r), std::sregex_iterator());
  };
  EXPECT_EQ(lines("FAILURE"), 0) << said;
  EXPECT_GE(lines("SUCCESS"), 17) << said;
  EXPECT_EQ(lines("Chunks:BufferCheck +SUCCESS"), 1) << said;
  EXPECT_EQ(camera->health().malformed, 0u);
}

TEST(GigePeer, ArvTestFindsNoFailure) {
  if (!installed("arv-test-0.8")) GTEST_SKIP() << "arv-test-0.8 is not installed";
  run_arv_test("127.0.0.94", "PEER94", "");
}

TEST(GigePeer, ArvTestFindsNoFailureOverAPacketSocket) {
  if (!installed("arv-test-0.8")) GTEST_SKIP() << "arv-test-0.8 is not installed";
  if (!FileDescriptor(::socket(AF_PACKET, SOCK_RAW | SOCK_CLOEXEC, 0)))
    GTEST_SKIP() << "packet sockets are not allowed here";
  run_arv_test("127.0.0.95", "PEER95", " --packet-socket");
}

/// What tshark's dissectors make of the traffic of `address` while `client` runs: one line for each packet
/// (protocols, kind of stream packet); empty where tshark may not capture here, with the reason in `why`.
std::string dissected(const std::string& address, const std::function<void()>& client, std::string& why,
                      std::string& malformed) {
  const auto file = temporary("gige.pcapng"), log = temporary("tshark.log");
  const std::string filter = "udp and host " + address;
  const pid_t tshark = ::fork();
  if (tshark == 0) {
    if (std::freopen(log.c_str(), "w", stderr) == nullptr ||
        std::freopen("/dev/null", "w", stdout) == nullptr)
      ::_exit(1);
    ::execlp("tshark", "tshark", "-i", "lo", "-f", filter.c_str(), "-w", file.c_str(), nullptr);
    ::_exit(127);
  }
  bool gone = false, ready = false;
  for (int i = 0; i < 2000 && !gone && !ready; ++i) {
    usleep(10'000);
    gone = ::waitpid(tshark, nullptr, WNOHANG) == tshark;
    ready = say("cat " + log).find("Capturing on") != std::string::npos;
  }
  if (gone || !ready) {
    if (!gone) ::kill(tshark, SIGTERM), ::waitpid(tshark, nullptr, 0);
    why = "tshark may not capture on lo here: " + say("cat " + log);
    return {};
  }
  usleep(300'000);  // "Capturing on" comes before the socket is open
  client();
  usleep(1'500'000);  // dumpcap hands packets on once a second
  ::kill(tshark, SIGINT);
  ::waitpid(tshark, nullptr, 0);
  // The stream's port is nobody's that tshark knows: it comes from the camera, and not from its control port.
  std::string port = say("tshark -r " + file + " -Y 'ip.src == " + address +
                         " && udp.srcport != 3956' -T fields -e udp.srcport 2>/dev/null "
                         "| sort | uniq -c | sort -n | tail -1 | awk '{print $2}'");
  while (!port.empty() && port.back() == '\n') port.pop_back();
  EXPECT_FALSE(port.empty());
  const std::string read = "tshark -r " + file + " -d udp.port==" + port + ",gvsp ";
  const auto packets =
      say(read +
          "-T fields -e frame.protocols -e gvsp.format -e gvsp.payloadtype -e gvsp.partlength 2>/dev/null");
  malformed = say(read + "-Y _ws.malformed -V 2>/dev/null | head -80");
  std::filesystem::remove(file);
  std::filesystem::remove(log);
  return packets;
}

std::ptrdiff_t count(const std::string& in, const std::string& pattern) {
  const std::regex r(pattern);
  return std::distance(std::sregex_iterator(in.begin(), in.end(), r), std::sregex_iterator());
}

TEST(GigePeer, TsharkFindsNothingMalformedInOurTraffic) {
  if (!installed("tshark")) GTEST_SKIP() << "tshark is not installed";
  if (!installed("arv-camera-test-0.8")) GTEST_SKIP() << "arv-camera-test-0.8 is not installed";
  gige::GigeCameraConfig config;
  config.sensor_width_px = 128, config.sensor_height_px = 96;
  config.ptp.present = true;
  auto camera = testing::start_camera("127.0.0.92", "PEER92", gige::testing::fill_stamped, config);
  std::string said, why, malformed;
  const auto packets = dissected(
      "127.0.0.92",
      [&] { run_camera_test("-n Rigor-PEER92 -f 25 --chunks=Timestamp,ExposureTime,Gain,FrameID", said); },
      why, malformed);
  if (!why.empty()) GTEST_SKIP() << why;
  EXPECT_GE(count(packets, ":gvcp"), 50) << said;
  EXPECT_GE(count(packets, ":gvsp"), 100) << said;
  EXPECT_EQ(count(packets, "malformed"), 0) << malformed;
}

TEST(GigePeer, TsharkReadsOurMultiPartFrames) {
  if (!installed("tshark")) GTEST_SKIP() << "tshark is not installed";
  GigeChannelEmulator emulator;
  DeviceParts parts;
  parts.samples = std::make_shared<testing::RangePictures>();
  emulator.attach(parts);
  ASSERT_TRUE(emulator.configure(testing::make_config("{address: 127.0.0.93, serial: PEER93, rate_hz: 25}")));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(testing::now()));
  std::string why, malformed;
  std::uint64_t received = 0;
  const auto packets = dissected(
      "127.0.0.93",
      [&] {
        AravisSource source;
        ChannelConfig c = testing::make_config("{address: 127.0.0.93, packet_size: 1400}");
        c.kind = SampleKind::range_image;
        ASSERT_TRUE(source.configure(c));
        const auto s = source.arm({});
        ASSERT_TRUE(s) << s.error().text();
        ASSERT_TRUE(source.start(testing::now()));
        for (const auto end = testing::now() + seconds(20); testing::now() < end && received < 10;
             usleep(1000))
          while (source.poll(testing::now())) ++received;
        ASSERT_TRUE(source.stop());
      },
      why, malformed);
  ASSERT_TRUE(emulator.stop());
  if (!why.empty()) GTEST_SKIP() << why;
  EXPECT_GE(received, 10u);
  // Leaders and trailers (formats 1 and 2, 0x80: extended ids) have the lengths of both parts.
  const std::string both = "\t0x000a\t0x0000000000001800,0x0000000000001800";
  EXPECT_GE(count(packets, ":gvsp\t0x81" + both), 10) << packets;
  EXPECT_GE(count(packets, ":gvsp\t0x82" + both), 10) << packets;
  EXPECT_GE(count(packets, ":gvsp\t0x87"), 100) << packets;
  EXPECT_EQ(count(packets, "malformed"), 0) << malformed;
}

}  // namespace
}  // namespace rigor

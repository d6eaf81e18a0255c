// Other people's programs on the emulated camera: arv-camera-test streams from it, and tshark's dissectors
// read what was on the wire, chunks and resends included.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <regex>

#include "tests/drivers/aravis/aravis_test_tools.h"

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

TEST(GigePeer, TsharkFindsNothingMalformedInOurTraffic) {
  if (!installed("tshark")) GTEST_SKIP() << "tshark is not installed";
  if (!installed("arv-camera-test-0.8")) GTEST_SKIP() << "arv-camera-test-0.8 is not installed";
  gige::GigeCameraConfig config;
  config.sensor_width_px = 128, config.sensor_height_px = 96;
  config.ptp.present = true;
  auto camera = testing::start_camera("127.0.0.92", "PEER92", gige::testing::fill_stamped, config);
  const auto file = temporary("gige.pcapng"), log = temporary("tshark.log");
  const pid_t tshark = ::fork();
  if (tshark == 0) {
    if (std::freopen(log.c_str(), "w", stderr) == nullptr ||
        std::freopen("/dev/null", "w", stdout) == nullptr)
      ::_exit(1);
    ::execlp("tshark", "tshark", "-i", "lo", "-f", "udp and host 127.0.0.92", "-w", file.c_str(), nullptr);
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
    GTEST_SKIP() << "tshark may not capture on lo here: " << say("cat " + log);
  }
  usleep(300'000);  // "Capturing on" comes before the socket is open
  std::string said;
  run_camera_test("-n Rigor-PEER92 -f 25 --chunks=Timestamp,ExposureTime,Gain,FrameID", said);
  usleep(1'500'000);  // dumpcap hands packets on once a second
  ::kill(tshark, SIGINT);
  ::waitpid(tshark, nullptr, 0);
  // The stream's port is nobody's that tshark knows: it comes from the camera, and not from its control port.
  std::string port =
      say("tshark -r " + file +
          " -Y 'ip.src == 127.0.0.92 && udp.srcport != 3956' -T fields -e udp.srcport 2>/dev/null "
          "| sort | uniq -c | sort -n | tail -1 | awk '{print $2}'");
  while (!port.empty() && port.back() == '\n') port.pop_back();
  ASSERT_FALSE(port.empty()) << said;
  // One line for each packet: protocols, kind of stream packet.
  const auto packets = say("tshark -r " + file + " -d udp.port==" + port +
                           ",gvsp -T fields -e frame.protocols -e gvsp.format 2>/dev/null");
  const auto count = [&](const std::string& pattern) {
    const std::regex r(pattern);
    return std::distance(std::sregex_iterator(packets.begin(), packets.end(), r), std::sregex_iterator());
  };
  EXPECT_GE(count(":gvcp"), 50) << said;
  EXPECT_GE(count(":gvsp"), 100) << said;
  EXPECT_EQ(count("malformed"), 0) << say("tshark -r " + file + " -d udp.port==" + port +
                                          ",gvsp -Y _ws.malformed -V 2>/dev/null | head -80");
  std::filesystem::remove(file);
  std::filesystem::remove(log);
}

}  // namespace
}  // namespace rigor

// The emulated USB3 Vision camera on a real kernel: its virtual host controller (vhci_hcd) imports the camera
// by USB/IP, libusb finds it on the bus, and Aravis streams from it. Counted behaviour; where the kernel
// lives in an emulator, time means little.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "drivers/aravis/aravis_backend.h"
#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/u3v_emulator.h"
#include "tests/drivers/aravis/aravis_test_tools.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::make_config;

/// What a command prints; its status is lost.
std::string output_of(const std::string& command) {
  std::string text;
  FILE* p = ::popen((command + " 2>&1").c_str(), "r");
  char piece[512];
  while (p != nullptr && std::fgets(piece, sizeof piece, p) != nullptr) text += piece;
  if (p != nullptr) ::pclose(p);
  return text;
}

bool installed(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0;
}

template <class F>
bool within(Duration limit, F&& is) {
  const BenchTime end = testing::now() + limit;
  while (!is()) {
    if (testing::now() > end) return false;
    usleep(20'000);
  }
  return true;
}

bool seen_by_aravis(const std::string& serial) {
  for (const FoundDevice& d : aravis_backend().find_devices())
    if (d.description.find("serial " + serial + ", USB3 Vision") != std::string::npos) return true;
  return false;
}

class KernelU3v : public ::testing::Test {
 protected:
  void SetUp() override {
    (void)!std::system("modprobe -q vhci_hcd 2>/dev/null");
    std::error_code error;
    const bool there = fs::exists("/sys/devices/platform/vhci_hcd.0/attach", error) && ::getuid() == 0;
    if (!there && std::getenv("RIGOR_GUEST") != nullptr) FAIL() << "vhci_hcd is not loaded";
    if (!there) GTEST_SKIP() << "this kernel has no vhci_hcd, or you are not root";
    if (!installed("usbip")) {
      ASSERT_EQ(std::getenv("RIGOR_GUEST"), nullptr) << "usbip is not installed";
      GTEST_SKIP() << "usbip is not installed";
    }
    u3v::EmulatorOptions o;
    o.port = 0;
    auto& c = o.camera.camera;
    c.serial = "U3V1";
    c.model = "Emulated USB3 camera";
    c.sensor_width_px = 160, c.sensor_height_px = 120;
    c.formats = {gige::PixelFormat::mono8, gige::PixelFormat::mono16};
    c.frame_rate_hz = c.min_frame_rate_hz = 5;
    c.exposure_us = 2000;
    auto e = u3v::Emulator::start(o, gige::testing::fill_stamped);
    ASSERT_TRUE(e) << e.error().text();
    camera = std::move(*e);
  }
  /// With the kernel's own tool, as a user would.
  [[nodiscard]] std::string usbip(const std::string& arguments) const {
    return output_of("usbip --tcp-port " + std::to_string(camera->port()) + " " + arguments);
  }
  void attach() {
    const std::string said = usbip("attach -r 127.0.0.1 -b 1-1");
    ASSERT_TRUE(within(seconds(20), [] { return seen_by_aravis("U3V1"); })) << said;
  }
  std::unique_ptr<u3v::Emulator> camera;
};

TEST_F(KernelU3v, OtherPeoplesProgramsFindItAndReadItsFeatures) {
  EXPECT_THAT(usbip("list -r 127.0.0.1"), HasSubstr("1209:000a"));
  attach();
  if (!installed("arv-tool-0.8")) GTEST_SKIP() << "arv-tool-0.8 is not installed";
  EXPECT_THAT(output_of("arv-tool-0.8 -n Rigor-U3V1 control ExposureTime=3000 ExposureTime PixelFormat "
                        "DeviceSerialNumber"),
              ::testing::AllOf(HasSubstr("3000"), HasSubstr("Mono8"), HasSubstr("U3V1")));
}

TEST_F(KernelU3v, AravisStreamsFromItUnpluggedAndBack) {
  attach();
  AravisSource source;
  auto s =
      source.configure(make_config("{device: Rigor-U3V1, interface: lo, exposure_us: 4000, gain_db: 6, "
                                   "region: {x_px: 16, y_px: 8, width_px: 128, height_px: 96}}",
                                   milliseconds(200), milliseconds(300)));
  ASSERT_TRUE(s) << s.error().text();
  s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(testing::now()));
  std::vector<testing::Seen> seen;
  const auto receive = [&](std::size_t n, Duration limit) {
    const std::size_t before = seen.size();
    return within(limit, [&] {
      collect(source, seen);
      return seen.size() >= before + n;
    });
  };
  EXPECT_TRUE(receive(10, seconds(40)));
  auto h = camera->health();
  std::printf("before it is unplugged: %lu frames sent, %zu received, %lu dropped, %lu cut\n", h.frames_sent,
              seen.size(), h.frames_dropped, h.frames_cut);
  camera->unplug();
  EXPECT_TRUE(within(seconds(30), [&] { return !source.health().connected; }));
  EXPECT_TRUE(within(seconds(10), [&] { return !camera->health().imported; }));
  const std::size_t before = seen.size();
  camera->plug();
  attach();
  EXPECT_TRUE(receive(6, seconds(60)));
  ASSERT_TRUE(source.stop());
  h = camera->health();
  std::uint64_t missing = 0;
  for (const auto& one : seen) {
    missing += one.stamp.lost_before;
    EXPECT_EQ(one.verdict.wrong + one.verdict.zero, 0U);
    EXPECT_EQ(one.bytes, 128U * 96U);
    EXPECT_EQ(one.image.exposure, milliseconds(4));
  }
  ASSERT_GE(seen.size(), before + 1);
  EXPECT_EQ(seen.back().stamp.sequence - seen.front().stamp.sequence + 1,
            seen.size() + missing - seen.front().stamp.lost_before);
  EXPECT_GE(missing, 1U) << "what was exposed while it was unplugged is lost";
  EXPECT_GE(source.health().reconnects, 1U);
  EXPECT_EQ(h.truncated, 0U);
  EXPECT_EQ(h.malformed, 0U);
  std::printf("back: %lu frames sent, %zu received, %lu reported lost, %lu dropped, %lu cut\n", h.frames_sent,
              seen.size(), missing, h.frames_dropped, h.frames_cut);
}

}  // namespace
}  // namespace rigor

// `as: usb3vision` of a rig's emulator: the emulator as a channel, seen by a USB/IP host.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>

#include "drivers/aravis/camera_emulator.h"
#include "tests/drivers/aravis/aravis_test_tools.h"
#include "tests/drivers/aravis/u3v_host.h"

namespace rigor {
namespace {

using ::testing::HasSubstr;
using testing::make_config;

/// Each picture is grey as its exposure has milliseconds.
class GreyPictures final : public ImageProvider {
 public:
  [[nodiscard]] Geometry geometry() const override {
    return {.width_px = 128,
            .height_px = 96,
            .format = PixelFormat::mono8,
            .exposure = milliseconds(3),
            .frame_id = "f"};
  }
  [[nodiscard]] Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    std::fill(pixels.begin(), pixels.end(), static_cast<std::byte>(r.exposure.ns() / 1'000'000));
    return {};
  }
};

std::unique_ptr<Emulator> camera_of(const std::string& keys) {
  auto emulator = make_camera_emulator();
  DeviceParts parts;
  parts.image = std::make_shared<GreyPictures>();
  emulator->attach(parts);
  const auto configured = emulator->configure(make_config(keys));
  if (!configured) throw std::runtime_error(configured.error().text());
  return emulator;
}

TEST(CameraEmulator, AsUsb3VisionShowsTheProvidersPictureToAHost) {
  const auto emulator = camera_of("{as: usb3vision, port: 0, bus_id: 2-4, serial: usb, rate_hz: 50}");
  ASSERT_TRUE(emulator->arm({}));
  ASSERT_TRUE(emulator->start(testing::now()));
  const std::string endpoint = emulator->endpoint();
  EXPECT_THAT(endpoint, HasSubstr("USB3 Vision camera Rigor-usb on USB/IP at 127.0.0.1:"));
  EXPECT_THAT(endpoint, HasSubstr("attach -r 127.0.0.1 -b 2-4"));
  std::smatch port;
  ASSERT_TRUE(std::regex_search(endpoint, port, std::regex(":(\\d+) ")));
  usbip::testing::Host bus(static_cast<std::uint16_t>(std::stoul(port[1])));
  ASSERT_EQ(bus.import("2-4"), usbip::kOk);
  u3v::testing::U3vHost host(bus);
  EXPECT_EQ(host.read<double>(u3v::reg::kExposureTime), 3000.0);
  EXPECT_EQ(host.read<double>(u3v::reg::kFrameRate), 50.0);
  ASSERT_EQ(host.write(u3v::reg::kExposureTime, 7000.0), u3v::Status::success);
  ASSERT_EQ(host.open_stream(), u3v::Status::success);
  ASSERT_EQ(host.write(u3v::reg::kAcquisitionStart, 1), u3v::Status::success);
  for (int i = 0; i < 3; ++i) {
    const auto f = host.take_frame();
    ASSERT_TRUE(f);
    EXPECT_EQ(f->payload, std::string(128 * 96, '\7'));
  }
  const BenchTime end = testing::now() + seconds(5);
  while (!emulator->health().connected && testing::now() < end) usleep(10'000);
  EXPECT_TRUE(emulator->health().connected);
  ASSERT_TRUE(emulator->stop());
  EXPECT_FALSE(emulator->health().connected);
}

TEST(CameraEmulator, SaysWhatAUsb3VisionCameraCannotBe) {
  const auto ptp = camera_of("{as: usb3vision, port: 0, ptp: {settle_s: 1}}");
  EXPECT_THAT(ptp->arm({}).error().message, HasSubstr("ptp"));
  EXPECT_THROW(camera_of("{as: usb3, port: 0}"), std::runtime_error);
  auto bare = make_camera_emulator();
  ASSERT_TRUE(bare->configure(make_config("{as: usb3vision, port: 0}")));
  EXPECT_THAT(bare->arm({}).error().message, HasSubstr("`sensor`"));
}

}  // namespace
}  // namespace rigor

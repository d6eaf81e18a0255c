// A USB3 Vision camera and its host on a bus in memory, at instants that the test chooses.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "drivers/aravis/u3v_usb_device.h"
#include "tests/drivers/aravis/u3v_host.h"

namespace rigor::u3v::testing {

inline constexpr DeviceTime kNow{1'000'000'000};

inline CameraOptions options() {
  CameraOptions o;
  o.camera.sensor_width_px = 64, o.camera.sensor_height_px = 48;
  o.camera.formats = {PixelFormat::mono8, PixelFormat::mono16};
  o.camera.serial = "U0001";
  o.camera.user_name = "left";
  o.camera.frame_rate_hz = 100;
  o.camera.exposure_us = 1000;
  return o;
}

/// A camera whose plug is in, and its host.
struct Bench {
  explicit Bench(const CameraOptions& o = options())
      : device(Camera::create(o).value(), "1-1"), session(device), bus(session), host(bus) {
    device.set_now(kNow);
    EXPECT_EQ(bus.import("1-1"), usbip::kOk);
  }
  /// Exposures and frames up to `t`; each picture holds its number.
  void run_until(DeviceTime t) {
    while (device.camera().next_exposure() <= t) {
      FrameJob job;
      const DeviceTime at = device.camera().next_exposure();
      ASSERT_TRUE(device.camera().begin_frame(at, job));
      starts.push_back(job.request.t_exposure_start);
      std::fill(job.picture().begin(), job.picture().end(), static_cast<std::uint8_t>(job.request.index));
      device.advance(at);
      if (auto f = device.camera().finish_frame(std::move(job), true)) {
        ++produced;
        (void)device.send_frame(*f);
      }
    }
    device.advance(t);
  }
  UsbDevice device;
  usbip::Session session;
  usbip::testing::Host bus;
  U3vHost host;
  std::vector<DeviceTime> starts;
  std::uint64_t produced = 0;
};

}  // namespace rigor::u3v::testing

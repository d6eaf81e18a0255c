// Tables of devices as their drivers give them, and a camera whose picture is a formula.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/v4l2/v4l2_virtual_source.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::v4l2::test {

inline OfferedSize size(std::uint32_t w, std::uint32_t h, std::vector<Interval> intervals) {
  OfferedSize s;
  s.min_width_px = s.max_width_px = w;
  s.min_height_px = s.max_height_px = h;
  s.intervals = std::move(intervals);
  return s;
}

/// A USB camera (Logitech C525, as `v4l2-ctl --list-formats-ext --list-ctrls-menus` shows it, shortened).
inline DeviceTable webcam() {
  DeviceTable t;
  t.path = "/dev/video0", t.driver = "uvcvideo", t.card = "HD Webcam C525", t.bus = "usb-0000:00:14.0-1";
  t.captures = t.streams = t.sets_rate = true;
  const std::vector<Interval> fast{{1, 30}, {1, 24}, {1, 15}, {1, 5}};
  t.formats = {{kYuyv,
                "YUYV 4:2:2",
                {size(640, 480, fast), size(320, 240, fast), size(1280, 720, {{1, 10}, {2, 15}, {1, 5}})}},
               {kMjpg, "Motion-JPEG", {size(640, 480, fast), size(1280, 720, fast)}}};
  t.current_code = kYuyv, t.current_width_px = 640, t.current_height_px = 480;
  t.controls = {
      {.id = 0x00980900, .name = "brightness", .minimum = 0, .maximum = 255, .step = 1, .fallback = 128},
      {.id = 0x0098090c, .name = "white_balance_automatic", .type = ControlType::boolean, .maximum = 1},
      {.id = 0x00980918,
       .name = "power_line_frequency",
       .type = ControlType::menu,
       .maximum = 2,
       .items = {{0, "Disabled"}, {1, "50 Hz"}, {2, "60 Hz"}}},
      {.id = 0x009a0901,
       .name = "auto_exposure",
       .type = ControlType::menu,
       .maximum = 3,
       .items = {{1, "Manual Mode"}, {3, "Aperture Priority Mode"}}},
      {.id = kExposureAbsolute,
       .name = "exposure_time_absolute",
       .minimum = 3,
       .maximum = 2047,
       .step = 1,
       .fallback = 166},
      {.id = 0x009a090a, .name = "focus_absolute", .minimum = 0, .maximum = 255, .step = 5, .fallback = 60},
      {.id = 0x009a0911,
       .name = "iris",
       .type = ControlType::integer_menu,
       .minimum = 0,
       .maximum = 2,
       .items = {{0, "14"}, {1, "28"}, {2, "56"}}},
      {.id = 0x00980999, .name = "reset", .type = ControlType::button},
      {.id = 0x00980998, .name = "temperature", .maximum = 100, .read_only = true}};
  return t;
}

/// Gradients that differ by colour, index and place.
class FormulaCamera final : public ImageProvider {
 public:
  FormulaCamera(std::uint32_t width_px, std::uint32_t height_px)
      : width_px_(width_px), height_px_(height_px) {}
  Geometry geometry() const override {
    return {width_px_, height_px_, PixelFormat::rgb8, milliseconds(2), "test_optical"};
  }
  Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    fill(r.index, pixels);
    last = r;
    return {};
  }
  static void fill(std::uint64_t index, std::span<std::byte> pixels) {
    for (std::size_t i = 0; i < pixels.size(); ++i)
      pixels[i] = static_cast<std::byte>((index * 37 + i * 11 + i / 97 * 3) & 0xFF);
  }
  ImageRequest last;

 private:
  std::uint32_t width_px_, height_px_;
};

inline DeviceParts parts_of(std::uint32_t width_px, std::uint32_t height_px) {
  DeviceParts p;
  p.image = std::make_shared<FormulaCamera>(width_px, height_px);
  return p;
}

inline ChannelConfig config(const std::string& params, Duration period = milliseconds(40),
                            Duration latency = milliseconds(60)) {
  return rigor::test::image_config(params, period, latency);
}

}  // namespace rigor::v4l2::test

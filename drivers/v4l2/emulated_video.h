// A rig's `emulators:` entry of this driver as a camera: its pictures, its instants, what it tells of itself.
// The emulators that leave as kernel devices and the stand-in in virtual time are made from the same lines,
// so they are the same camera.
//
//   emulators:
//     webcam:
//       backend: v4l2
//       as: video                # a loop-back or output node; or usb: a UVC gadget
//       device: /dev/video2      # video: the node that is written to, or its card's name; usb: see
//       uvc_emulator.h formats: [YUYV]          # the first is the default; a loop-back node has one rate_hz:
//       30 exposure_us: 5000        # without it the sensor's gain_db: 0 readout_us: 0            # rolling
//       shutter: from the first row to the last timestamp: end_of_frame  # or start_of_exposure: what the
//       frames' stamps mean io: mmap                 # or write: stamps are then the kernel's, of the moment
//       of writing jpeg_quality: 90 sensor: …                # what it sees, as for every simulated camera
//
// Depth (formats: [Z16]) comes from a range image; the lens that it was measured through is then said by
// fx_px, fy_px, cx_px and cy_px, and the unit by depth_unit_m (0.001).
#pragma once

#include "drivers/v4l2/frame_conversion.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::v4l2 {

struct EmulatedVideoSettings {
  std::vector<std::uint32_t> codes;
  double rate_hz = 30;
  std::optional<Duration> exposure;
  double gain_db = 0;
  Duration readout;
  TimestampEvent event = TimestampEvent::end_of_frame;
  int jpeg_quality = 90;
  struct Lens {
    double fx_px = 0, fy_px = 0, cx_px = 0, cy_px = 0, unit_m = 0.001;
  } lens;
  std::string card;
};
/// Throws ConfigError. `period`: of the channel that it stands for; the default rate.
[[nodiscard]] EmulatedVideoSettings read_emulated_video(const ConfigNode& params, const std::string& name,
                                                        const Period& period);

/// Depth along z from range along the ray: z = r / √(1 + x² + y²), x = (u − cx)/fx; in units of `unit_m`,
/// rounded to nearest, 0 for no return and for what 16 bits do not hold.
void depth_from_range(std::span<const std::byte> range_m, std::uint32_t width_px, std::uint32_t height_px,
                      const EmulatedVideoSettings::Lens& lens, std::span<std::byte> depth) noexcept;

/// Pictures of the emulated camera, as frames of one format. One thread at a time.
class EmulatedPictures {
 public:
  /// bad_input where `parts` has nothing that this camera could show.
  [[nodiscard]] static Result<EmulatedPictures> create(const EmulatedVideoSettings& settings,
                                                       const DeviceParts& parts, const std::string& name);
  [[nodiscard]] std::uint32_t width_px() const noexcept { return width_px_; }
  [[nodiscard]] std::uint32_t height_px() const noexcept { return height_px_; }
  [[nodiscard]] Duration exposure() const noexcept { return exposure_; }
  void set_exposure(Duration exposure) noexcept { exposure_ = exposure; }
  /// Sets the format of frames from now on.
  void set_code(std::uint32_t code);
  [[nodiscard]] std::uint32_t code() const noexcept { return code_; }
  /// Bytes written to `out`, which has frame_bytes; 0: there is no picture.
  [[nodiscard]] std::size_t capture(std::uint64_t index, BenchTime t_capture, BenchTime t_start,
                                    std::span<std::byte> out);

 private:
  EmulatedPictures(const EmulatedVideoSettings& settings, DeviceParts parts);
  EmulatedVideoSettings settings_;
  DeviceParts parts_;
  std::uint32_t width_px_ = 0, height_px_ = 0, code_ = 0;
  Duration exposure_;
  std::unique_ptr<FrameMaker> maker_;
  std::vector<std::byte> picture_;
  std::unique_ptr<SamplePool> range_;
};

}  // namespace rigor::v4l2

// From what a rig asks to what a device can be set to.
//
//   pixel_format: RGB8, 1280x720, 30 Hz      device: MJPG 1280x720 at 30, YUYV 1280x720 at 10
//   → MJPG, decoded
//
// The format is the first of those that give the pixels that were asked for (the same bytes first, then cheap
// conversions, then decoding) which the device offers in this size at this rate. Where there is none the
// message says what the device offers.
#pragma once

#include <span>

#include "drivers/v4l2/device_table.h"
#include "rt-core/period.h"
#include "rt-core/result.h"

namespace rigor::v4l2 {

/// 30 and 30000/1001 Hz are two rates; 333333 · 100 ns, as UVC has it, is 30 Hz.
inline constexpr double kRateTolerance = 5e-4;

struct FormatRequest {
  PixelFormat format = PixelFormat::mono8;    ///< of the samples
  std::uint32_t code = 0;                     ///< of the device; 0: any that gives `format`
  std::uint32_t width_px = 0, height_px = 0;  ///< 0: as the device is set
  Period period;                              ///< 0: as the device is set
};
struct FormatChoice {
  std::uint32_t code = 0, width_px = 0, height_px = 0;
  Interval interval;  ///< numerator 0: left as it is
};

/// FourCC codes that can be turned into samples of this format, the best first.
[[nodiscard]] std::span<const std::uint32_t> codes_for(PixelFormat format) noexcept;
/// The samples' format that has the same bytes; empty where none has.
[[nodiscard]] std::optional<PixelFormat> same_bytes(std::uint32_t code) noexcept;

/// Where a request fails, `where` of the error is the key that is at fault: pixel_format, device_format,
/// width_px, rate_hz. Setup context.
[[nodiscard]] Result<FormatChoice> negotiate(const DeviceTable& table, const FormatRequest& request);

}  // namespace rigor::v4l2

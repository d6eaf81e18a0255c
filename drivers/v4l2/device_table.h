// What a video device says of itself, as plain values: who it is, which formats, sizes and rates it offers,
// which controls it has. Filled by the ioctl layer (v4l2_device.h) or by the model of an emulated device;
// read by negotiation and by checks of controls, which so need no device. Structure and numbers follow the
// kernel's user space API (https://docs.kernel.org/userspace-api/media/v4l/): VIDIOC_QUERYCAP, ENUM_FMT,
// ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS, QUERY_EXT_CTRL.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/time.h"
#include "sensor-hal/types/pixel_format.h"

namespace rigor::v4l2 {

/// Four characters, the first in the lowest byte.
[[nodiscard]] constexpr std::uint32_t fourcc(char a, char b, char c, char d) {
  return static_cast<std::uint32_t>(static_cast<unsigned char>(a)) |
         static_cast<std::uint32_t>(static_cast<unsigned char>(b)) << 8 |
         static_cast<std::uint32_t>(static_cast<unsigned char>(c)) << 16 |
         static_cast<std::uint32_t>(static_cast<unsigned char>(d)) << 24;
}
inline constexpr std::uint32_t kGrey = fourcc('G', 'R', 'E', 'Y'), kY10 = fourcc('Y', '1', '0', ' '),
                               kY12 = fourcc('Y', '1', '2', ' '), kY16 = fourcc('Y', '1', '6', ' '),
                               kY16Be = kY16 | 1u << 31, kZ16 = fourcc('Z', '1', '6', ' '),
                               kYuyv = fourcc('Y', 'U', 'Y', 'V'), kUyvy = fourcc('U', 'Y', 'V', 'Y'),
                               kNv12 = fourcc('N', 'V', '1', '2'), kYu12 = fourcc('Y', 'U', '1', '2'),
                               kMjpg = fourcc('M', 'J', 'P', 'G'), kJpeg = fourcc('J', 'P', 'E', 'G'),
                               kRgb3 = fourcc('R', 'G', 'B', '3'), kBgr3 = fourcc('B', 'G', 'R', '3'),
                               kRggb = fourcc('R', 'G', 'G', 'B'), kRg10 = fourcc('R', 'G', '1', '0'),
                               kRg12 = fourcc('R', 'G', '1', '2'), kRg16 = fourcc('R', 'G', '1', '6');

/// "YUYV", "Y10", "Y16-BE" (big-endian).
[[nodiscard]] std::string fourcc_text(std::uint32_t code);
/// The code of such a name; trailing blanks may be left out. Empty for what is no name of one to four
/// printable characters.
[[nodiscard]] std::optional<std::uint32_t> fourcc_from(std::string_view text);

/// A frame interval in seconds.
struct Interval {
  std::uint32_t numerator = 0, denominator = 1;
  [[nodiscard]] double rate_hz() const {
    return numerator == 0 ? 0 : static_cast<double>(denominator) / static_cast<double>(numerator);
  }
  [[nodiscard]] Duration duration() const {
    return seconds_from(denominator == 0 ? 0
                                         : static_cast<double>(numerator) / static_cast<double>(denominator));
  }
  friend bool operator==(const Interval&, const Interval&) = default;
};

/// One size, or sizes in steps; with the intervals that it is offered at.
struct OfferedSize {
  std::uint32_t min_width_px = 0, max_width_px = 0, step_width_px = 1;
  std::uint32_t min_height_px = 0, max_height_px = 0, step_height_px = 1;
  std::vector<Interval> intervals;  ///< discrete; both ends where `continuous`; empty: not known
  bool continuous = false;          ///< any interval between the two
  [[nodiscard]] bool discrete() const {
    return min_width_px == max_width_px && min_height_px == max_height_px;
  }
  [[nodiscard]] bool holds(std::uint32_t width_px, std::uint32_t height_px) const;
};

struct OfferedFormat {
  std::uint32_t code = 0;
  std::string description;
  std::vector<OfferedSize> sizes;  ///< empty: the device does not enumerate them
};

enum class ControlType : std::uint8_t {
  integer,
  boolean,
  menu,
  button,
  integer64,
  bitmask,
  integer_menu,
  other  ///< strings and arrays
};
struct Control {
  std::uint32_t id = 0;
  std::string name{};  ///< as v4l2-ctl writes it: "exposure_time_absolute"
  ControlType type = ControlType::integer;
  std::int64_t minimum = 0, maximum = 0, step = 1, fallback = 0;
  bool read_only = false, inactive = false;
  struct Item {
    std::int64_t index = 0;
    std::string name;  ///< of menus; of integer menus the value
  };
  std::vector<Item> items{};
};
inline constexpr std::uint32_t kExposureAbsolute = 0x009a0902;  ///< V4L2_CID_EXPOSURE_ABSOLUTE, 100 µs

struct DeviceTable {
  std::string path, driver, card, bus;
  bool captures = false, outputs = false, streams = false, writes = false;
  bool multiplanar = false;  ///< only through the multi-planar API, which is not supported
  bool sets_rate = false;    ///< VIDIOC_S_PARM with V4L2_CAP_TIMEPERFRAME
  std::vector<OfferedFormat> formats;
  std::vector<Control> controls;
  std::uint32_t current_code = 0, current_width_px = 0, current_height_px = 0;

  [[nodiscard]] const OfferedFormat* format(std::uint32_t code) const;
  [[nodiscard]] const Control* control(std::uint32_t id) const;
};

/// A control's name as the kernel has it ("Exposure Time, Absolute"), as v4l2-ctl and rigs write it.
[[nodiscard]] std::string control_key(std::string_view kernel_name);

/// "640x480, 1280x720" or "48x32 … 1920x1080 in steps of 2x2".
[[nodiscard]] std::string sizes_text(const OfferedFormat& format);
/// "30, 15 Hz".
[[nodiscard]] std::string rates_text(const OfferedSize& size);
/// "0 … 255 in steps of 1", "one of auto_mode, manual_mode".
[[nodiscard]] std::string range_text(const Control& control);

}  // namespace rigor::v4l2

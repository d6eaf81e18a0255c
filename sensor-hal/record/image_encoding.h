// Names that ROS 2 has for pixel formats (sensor_msgs/Image::encoding).
#pragma once

#include <array>
#include <string_view>
#include <utility>

#include "sensor-hal/types/pixel_format.h"

namespace rigor::record {

/// Of formats with one encoding the first is what an image of others means; in our own recordings the
/// settings beside it name the format.
inline constexpr std::array<std::pair<PixelFormat, std::string_view>,
                            kPixelFormats.size() + kVideoFormats.size()>
    kEncodings{{{PixelFormat::mono8, "mono8"},
                {PixelFormat::mono12p, "mono12p"},
                {PixelFormat::mono16, "mono16"},
                {PixelFormat::mono10, "mono16"},
                {PixelFormat::mono12, "mono16"},
                {PixelFormat::bayer_rg8, "bayer_rggb8"},
                {PixelFormat::bayer_rg16, "bayer_rggb16"},
                {PixelFormat::bayer_rg10, "bayer_rggb16"},
                {PixelFormat::bayer_rg12, "bayer_rggb16"},
                {PixelFormat::rgb8, "rgb8"},
                {PixelFormat::yuv422_8, "yuv422_yuy2"},
                {PixelFormat::yuv420_sp, "nv12"},
                {PixelFormat::coord3d_c16, "16UC1"}}};

[[nodiscard]] inline std::string_view encoding_of(PixelFormat format) {
  for (const auto& [f, name] : kEncodings)
    if (f == format) return name;
  return "";
}

}  // namespace rigor::record

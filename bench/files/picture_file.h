// Pictures as the bytes of a file, made in memory: what a disk has no room for is said by whoever writes it.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// One channel of an OpenEXR file.
struct ExrPlane {
  std::string name;
  bool whole_numbers = false;  ///< std::uint32_t, else float
  const void* data = nullptr;
  std::size_t stride = 4;  ///< bytes from one pixel to the next
};
/// `class_names`: an attribute of that name; empty: none. internal: the codec's own words.
[[nodiscard]] Result<std::string> exr_bytes(std::uint32_t width_px, std::uint32_t height_px,
                                            const std::vector<ExrPlane>& planes,
                                            const std::string& class_names = {});

/// A sample's image: `.png` as 8-bit rows for people (demosaicked, unpacked, not stretched), `.exr` with the
/// sensor's own numbers. internal: fewer bytes than the size says.
[[nodiscard]] Result<std::string> picture_bytes(const std::string& extension, const ImageInfo& info,
                                                std::span<const std::byte> bytes);

}  // namespace rigor

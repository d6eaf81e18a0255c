// Sizes of samples that a configuration asks for, refused where they are asked for: a picture that no sensor
// has, and buffers that the machine's memory cannot hold. Setup context; throw ConfigError.
#pragma once

#include <cstdint>

#include "sensor-hal/config/yaml.h"

namespace rigor {

/// 16384 x 16384: beyond the largest sensors on sale.
inline constexpr std::uint64_t kMostPicturePixels = std::uint64_t{1} << 28;

/// At the key `width_px` of `n`.
void check_picture_size(const ConfigNode& n, std::uint64_t width_px, std::uint64_t height_px);

/// Whether `count` buffers (the key, which need not be there) of `bytes` each fit in this machine's memory.
void check_buffer_memory(const ConfigNode& n, std::string_view key, std::uint64_t count, std::uint64_t bytes);

}  // namespace rigor

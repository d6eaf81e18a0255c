// Pixels in which a few rays stand for too much: those that differ from a neighbour by more than a share of
// the picture's mean light, such as twigs before a bright sky. Internal to sim/sensors/camera.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "sim/sensors/camera/camera_optics_picture.h"

namespace rigor {

/// Pixels whose rays are shot together.
inline constexpr int kPacketWidth_px = 4, kPacketHeight_px = 2;

struct PixelPlace {
  int u = 0, v = 0;
  bool operator==(const PixelPlace&) const = default;
};

/// The pixels of `inner`, within a picture of this size, that are wanted (not 0, row by row): neighbouring
/// places follow each other, by blocks of kPacketWidth_px x
/// kPacketHeight_px.
[[nodiscard]] std::vector<PixelPlace> pixels_by_blocks(const OpticsRequest::Region& inner, int width_px,
                                                       int height_px, std::span<const std::uint8_t> wanted);

/// The uneven pixels of `inner`, a part of the picture's region; pixels of the region beyond `inner` are
/// neighbours only. A pixel is uneven where the radiance of a band spans more than `contrast` times `mean` of
/// that band over the pixel and its eight neighbours. Places of `inner` and of what is returned count from
/// the picture's corner. `lit`: whether the lens sends light to a place, on any thread; others neither
/// count nor are returned. In the order of pixels_by_blocks(). Radiance that is not finite is left out.
[[nodiscard]] std::vector<PixelPlace> uneven_pixels(const OpticsPicture& picture,
                                                    const OpticsRequest::Region& inner,
                                                    const std::array<float, 4>& mean, float contrast,
                                                    const std::function<bool(int u, int v)>& lit);

}  // namespace rigor

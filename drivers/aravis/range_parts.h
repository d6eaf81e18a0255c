// Range images as 3D cameras send them: one part with range in counts (Coord3D_C16), one with the amplitude.
//
//   range [m] = (counts · scale + offset) · ray, NaN where the camera says that there is none
//
// A camera whose coordinate C is spherical gives the ray's length; of one that gives depth (Cartesian), `ray`
// is the length of the pixel's ray for a depth of 1, from the camera's focal length and principal point
// (SFNC 2.5: Scan3dFocalLength, Scan3dPrincipalPointU and V, in pixels).
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "drivers/aravis/gvsp_codec.h"

namespace rigor {

struct RangeScale {
  double scale_m = 1e-3, offset_m = 0;
  std::optional<double> invalid;  ///< counts
  double amplitude_scale = 1;     ///< of a count
  std::vector<float> ray;         ///< by pixel; empty: 1

  /// Fills `ray` of a camera that gives depth.
  void set_pinhole(const gige::Region& region, double focal_px, double u_px, double v_px);
};

/// `counts`: 16 bits, little-endian, row by row. `gaps`: bytes that never came are 0, and such counts mean
/// nothing. Any thread, no allocation.
void counts_to_range(const RangeScale& scale, std::span<const std::byte> counts, bool gaps,
                     std::span<float> range_m) noexcept;
/// `bytes`: of 8 or 16 bits. Any thread, no allocation.
void counts_to_amplitude(const RangeScale& scale, std::span<const std::byte> counts, std::size_t bytes,
                         std::span<float> amplitude) noexcept;

/// Rows of the region out of a full plane of `width_px`, as 16-bit counts; what has no return, or none that
/// the counts can say, is 0.
void range_to_counts(std::span<const float> range_m, std::uint32_t width_px, const gige::Region& region,
                     double scale_m, gige::MutableBytes out) noexcept;
/// Clipped to what 16 bits hold.
void amplitude_to_counts(std::span<const float> amplitude, std::uint32_t width_px, const gige::Region& region,
                         double scale, gige::MutableBytes out) noexcept;

}  // namespace rigor

// What built things are covered with: the materials of the library, with patterns of bricks, tiles, boards
// and grains. A pattern changes the look near by, never the mean reflectance that the material states.
#pragma once

#include <memory>
#include <string_view>

#include "sim/render/content/content.h"

namespace rigor::nature::built {

struct Cover {
  std::shared_ptr<const render::Surface> surface;
  double repeats_per_m = 1.0;  ///< of its pictures
};

enum class Finish : std::uint8_t {
  plaster,
  plaster_ochre,
  plaster_grey,
  brick,
  roof_tiles,
  roof_slate,
  roof_felt,
  concrete,
  asphalt,
  gravel,
  soil,
  road_marking,
  glass,
  window_frame,
  door,
  wood,
  wire,
  count
};

/// Made once, at the first call. Any thread.
[[nodiscard]] const Cover& cover(Finish finish);

/// A world's own material that has no pictures but bears the name of a covered one (`brick`, `roof_tiles`, …)
/// gets that one's pattern; any other comes back as it is.
[[nodiscard]] std::shared_ptr<const render::Surface> with_pattern(
    const std::shared_ptr<const render::Surface>& surface);
/// Repeats per metre of a surface's pictures: those of the pattern, else one.
[[nodiscard]] double repeats_of(const render::Surface& surface);

}  // namespace rigor::nature::built

// From radiance to something to look at: exposure, the curve of a film, sRGB. For pictures on
// screens and in reports; sensors measure radiance itself.
#pragma once

#include <cstdint>
#include <vector>

#include "sim/render/view/view_renderer.h"

namespace rigor::render {

struct ToneMapOptions {
  enum class Exposure : std::uint8_t {
    log_average,  ///< the geometric mean of what is neither black nor the sun becomes `key`,
                  ///< or less, so that few pixels come near white
    percentile,   ///< `percentile` of the pixels are darker than white
    fixed         ///< radiance · `scale`
  } exposure = Exposure::log_average;
  double key = 0.18;
  double percentile = 0.99;
  double scale = 1.0;
  double compensation_ev = 0.0;  ///< brighter by so many stops, on top of the above
  bool film = true;              ///< darks and brights are compressed as on film; off: clipped at white
  enum class Colours : std::uint8_t {
    natural,             ///< channels 0, 1, 2 as red, green, blue
    near_infrared,       ///< channel 3 as grey
    false_near_infrared  ///< channels 3, 0, 1 as red, green, blue: plants are red, as on infrared film
  } colours = Colours::natural;
};

/// Rows from the top, red green blue, 8 bits in sRGB. Pixels that are not finite are black. Any thread.
[[nodiscard]] std::vector<std::uint8_t> tone_map(const ViewPicture& picture,
                                                 const ToneMapOptions& options = {});
/// What radiance is multiplied by under these options; 0 for a picture without light.
[[nodiscard]] double exposure_scale(const ViewPicture& picture, const ToneMapOptions& options = {});

}  // namespace rigor::render

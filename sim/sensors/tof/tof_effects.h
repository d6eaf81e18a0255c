// What the draws of a time-of-flight camera are for (see sensor-hal/models/philox.h). Element is the pixel
// (jitter: the sample; multipath: the ray); fixed patterns use capture index 0.
#pragma once

#include "sensor-hal/models/philox.h"

namespace rigor::tof {

inline constexpr auto kFixedPattern = static_cast<models::NoiseEffect>(61);  ///< words: range offset, gain
inline constexpr auto kJitter = static_cast<models::NoiseEffect>(62);        ///< words: u, v
inline constexpr auto kMultipath = static_cast<models::NoiseEffect>(63);     ///< words: two of a direction

/// Of modulation frequency j, 0 to 7; a word for each tap.
[[nodiscard]] constexpr models::NoiseEffect shot_effect(std::size_t j) {
  return static_cast<models::NoiseEffect>(64 + j);
}
[[nodiscard]] constexpr models::NoiseEffect read_effect(std::size_t j) {
  return static_cast<models::NoiseEffect>(72 + j);
}

}  // namespace rigor::tof

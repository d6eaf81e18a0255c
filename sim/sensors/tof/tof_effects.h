// What the draws of a time-of-flight camera are for: sensor-hal/models/philox.h.
#pragma once

#include <cstddef>

#include "sensor-hal/models/philox.h"

namespace rigor::tof {

/// Shot noise of the taps of modulation frequency j, 0 to 7; a word for each tap.
[[nodiscard]] constexpr models::NoiseEffect shot_effect(std::size_t j) {
  return static_cast<models::NoiseEffect>(static_cast<std::size_t>(models::NoiseEffect::tof_shot) + j);
}
/// Read noise of the same.
[[nodiscard]] constexpr models::NoiseEffect read_effect(std::size_t j) {
  return static_cast<models::NoiseEffect>(static_cast<std::size_t>(models::NoiseEffect::tof_read) + j);
}

}  // namespace rigor::tof

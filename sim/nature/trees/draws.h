// Numbers for shapes: each a function of (what is made, stream, index), never of what was made before.
#pragma once

#include <cstdint>

#include "sensor-hal/models/philox.h"

namespace rigor::nature {

class Draws {
 public:
  /// `subject`: what is made, e.g. form, class and variant packed; the name keeps users apart.
  Draws(std::string_view name, std::uint64_t subject)
      : key_(models::channel_key(subject, models::channel_id_from_name(name))) {}
  /// 0 ≤ u < 1.
  [[nodiscard]] float uniform(std::uint32_t stream, std::uint32_t index, std::uint32_t item = 0) const {
    return static_cast<float>(models::philox({index, stream, item, 0}, key_)[0] >> 8) * 0x1p-24F;
  }
  /// −1 ≤ v < 1.
  [[nodiscard]] float spread(std::uint32_t stream, std::uint32_t index, std::uint32_t item = 0) const {
    return 2 * uniform(stream, index, item) - 1;
  }

 private:
  models::PhiloxKey key_;
};

}  // namespace rigor::nature

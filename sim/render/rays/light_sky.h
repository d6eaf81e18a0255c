// A sky map as the tracer of light asks for it: radiance by direction, irradiance by normal, in four bands.
// Internal to sim/render/rays.
#pragma once

#include <array>
#include <vector>

#include "sim/render/content/content.h"
#include "sim/render/rays/light_vec.h"

namespace rigor::render::light {

[[nodiscard]] inline Bands4 pick(const Spectrum& s, const std::array<int, 4>& bands) noexcept {
  const auto at = [&](std::size_t i) { return s[static_cast<std::size_t>(bands[i])]; };
  return Bands4{at(0), at(1), at(2), at(3)};
}

class SkyTables {
 public:
  /// Null: dark. What is not finite or below 0 is 0.
  SkyTables(const SkyMap* map, const std::array<int, 4>& bands);

  /// As SkyMap::at. `d`: unit length.
  [[nodiscard]] Bands4 radiance(Vec3 d) const noexcept;
  /// W/m² that the upper half of the sky sends onto a plane of this normal (unit length): between the places
  /// of a table, within 3e-3 of its largest value.
  [[nodiscard]] Bands4 irradiance(Vec3 n) const noexcept;

 private:
  void integrate();
  int width_ = 0, height_ = 0;
  std::vector<Bands4> texels_;      ///< a column more than the map's: the first one again
  std::vector<Bands4> irradiance_;  ///< by the octahedron unfolded into a square (Meyer et al. 2010)
};

}  // namespace rigor::render::light

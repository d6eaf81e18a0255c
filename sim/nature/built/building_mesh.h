// From a footprint to a house: closed walls with windows and a door set into them, a plinth, a roof.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "sim/nature/built/building_roof.h"
#include "sim/nature/built/built_surfaces.h"
#include "sim/nature/built/polygon.h"
#include "sim/render/content/content.h"

namespace rigor::nature::built {

struct BuildingSpec {
  Polygon footprint;    ///< relative to the mesh's origin, whose z is the floor
  double height_m = 6;  ///< eaves above the floor
  RoofShape roof = RoofShape::flat;
  double roof_height_m = 3;
  double overhang_m = 0.35;
  bool openings = true;  ///< windows and a door
  bool chimney = true;
  /// z of the ground relative to the floor; NaN: unknown. Empty: everywhere unknown.
  std::function<double(const Eigen::Vector2d&)> ground{};
  double foundation_m = 0.6;  ///< how far walls reach below the floor
  Cover walls = cover(Finish::plaster), roof_cover = cover(Finish::roof_tiles);
};

struct BuildingMesh {
  /// With set-in windows; with windows flush; without.
  std::vector<render::LevelOfDetail> levels;
  std::vector<std::string> warnings;
};

[[nodiscard]] BuildingMesh make_building(const BuildingSpec& spec);

}  // namespace rigor::nature::built

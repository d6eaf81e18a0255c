// The semantic render plugins, in the order in which a view should hold them: what stands on the ground asks
// the terrain for its height, so the terrain is told of changes first.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "sim/render/content/provider.h"

namespace rigor::nature {

/// A provider that also knows the height of the ground.
class TerrainProvider : public render::ContentProvider, public render::GroundHeights {};

struct TerrainOptions {
  /// Show imagery draped plainly where there is some, instead of what the land cover means.
  bool plain_imagery = false;
};

[[nodiscard]] std::shared_ptr<TerrainProvider> make_terrain_provider(const TerrainOptions& options = {});
/// Grass, fern, shrubs, flowers, litter: GroundVegetation on LandCover.
[[nodiscard]] std::unique_ptr<render::ContentProvider> make_ground_vegetation_provider(
    std::shared_ptr<const render::GroundHeights> ground);
/// Trees of an inventory.
[[nodiscard]] std::unique_ptr<render::ContentProvider> make_tree_provider(
    std::shared_ptr<const render::GroundHeights> ground);
/// Buildings, roads, fences, poles. `base_dir`: for the maps of the world's own materials.
[[nodiscard]] std::unique_ptr<render::ContentProvider> make_built_provider(
    std::shared_ptr<const render::GroundHeights> ground, std::filesystem::path base_dir);
/// Sun, sky, clouds, haze, fog, rain, snow, wind: Place and Atmosphere.
[[nodiscard]] std::unique_ptr<render::ContentProvider> make_atmosphere_provider();

}  // namespace rigor::nature

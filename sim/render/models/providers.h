// Geometry that goes to the renderer as it is.
#pragma once

#include <filesystem>
#include <memory>

#include "sim/render/content/provider.h"

namespace rigor::render {

/// Model nodes: files that assimp reads (glTF, OBJ), with colour, normal and gloss maps. `base_dir`: where
/// relative names begin.
[[nodiscard]] std::unique_ptr<ContentProvider> make_model_provider(std::filesystem::path base_dir);
/// Body, GroundPlane and Lamp nodes.
[[nodiscard]] std::unique_ptr<ContentProvider> make_body_provider(std::filesystem::path base_dir);

}  // namespace rigor::render

// A model file as meshes with surfaces: the node hierarchy baked in, materials by band.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/render/content/content.h"

namespace rigor::render {

inline constexpr std::uint64_t kMostModelVertices = 50'000'000;
inline constexpr int kMostTexturePixels = 8192;  ///< along a side

struct ModelMesh {
  std::shared_ptr<const Mesh> mesh;   ///< in the file's own frame and unit
  std::vector<std::string> warnings;  ///< pictures that are missing, and what else was left out
};

/// What assimp reads: glTF 2.0 (with embedded pictures), OBJ and more. Colours: a material's base or diffuse
/// colour. Near infrared: from `infrared` where given (all its bands beyond the visible), else from the
/// library's surface of the material's name, else the mean of the visible bands. Roughness: glTF's own; of
/// other files from the Phong exponent n as sqrt(2 / (n + 2)), matt where nothing shines.
/// Errors: not_found; bad_input (what assimp says; no faces; above the limits).
[[nodiscard]] Result<ModelMesh> load_model(const std::filesystem::path& file,
                                           const std::shared_ptr<const Surface>& infrared = nullptr);

}  // namespace rigor::render

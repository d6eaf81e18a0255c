// A world file, parsed once into a Scene: materials, nodes, bodies, ground, sun and sky. configs/worlds holds
// examples with every key explained.
#pragma once

#include <filesystem>
#include <string_view>

#include "rt-core/result.h"
#include "sim/world/scene.h"

namespace rigor::world {

/// Setup. Errors read `file:line:column: key: expected … got …`; unknown keys are errors. The scene is valid.
[[nodiscard]] Result<Scene> load_world(const std::filesystem::path& file);
[[nodiscard]] Result<Scene> parse_world(std::string_view text, std::string_view name = "<text>");

}  // namespace rigor::world

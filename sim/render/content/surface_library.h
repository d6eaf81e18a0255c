// Materials by name, band by band: those that come with Rigor (configs/materials/, built into the program),
// and those of a world's Material nodes, which go before.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sim/render/content/content.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::render {

class SurfaceLibrary {
 public:
  /// What configs/materials/ holds, as it was when the program was built: bark, needles, broad_leaves, grass,
  /// fern, leaf_litter, soil, rock, gravel, sand, asphalt, concrete, brick, plaster, roof_tiles, wood,
  /// painted_metal, bare_metal, glass, snow, water, retro_reflector, road_marking, lichen_bark. Any thread.
  [[nodiscard]] static const SurfaceLibrary& builtin();
  /// The *.yaml files of a folder. Errors: not_found, bad_input with file, line and column.
  [[nodiscard]] static Result<SurfaceLibrary> load(const std::filesystem::path& folder);

  /// Null where there is none.
  [[nodiscard]] std::shared_ptr<const Surface> find(std::string_view name) const;
  /// As above, or a matt grey that is named `unknown`. Never null.
  [[nodiscard]] std::shared_ptr<const Surface> get(std::string_view name) const;
  [[nodiscard]] std::vector<std::string> names() const;
  void put(std::shared_ptr<const Surface> surface);

 private:
  std::map<std::string, std::shared_ptr<const Surface>, std::less<>> surfaces_;
};

/// The surface of a Material node, its maps loaded from files relative to `base_dir`. Errors: not_found,
/// bad_input (a map).
[[nodiscard]] Result<std::shared_ptr<const Surface>> surface_of(const world::Snapshot& world, NodeId material,
                                                                const std::filesystem::path& base_dir);
/// A picture file as a texture. Errors: not_found, bad_input.
[[nodiscard]] Result<std::shared_ptr<const Texture>> load_texture(const std::filesystem::path& file,
                                                                  bool srgb);

}  // namespace rigor::render

// Worlds from files, and what makes pictures of them: where the world database, its files, GIS and the
// providers of content meet.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "bench/files/output_file.h"
#include "bench/world/world_plugins.h"
#include "rt-core/result.h"
#include "sim/gis/import.h"
#include "sim/nature/providers.h"
#include "sim/render/content/world_view.h"
#include "sim/world/graph/database.h"

namespace rigor {

struct OpenedWorld {
  std::unique_ptr<world::Database> db;
  std::unique_ptr<world::Plugins> plugins;
  std::filesystem::path base_dir;  ///< where file names in the world begin
  std::vector<std::string> warnings;
  bool scene = false;  ///< a small scene of boxes and cylinders (sim/world/scene.h)
};

/// A world file (*.rigor), a world in YAML, or an import plan (*.import.yaml), which is imported into memory.
/// Plugins of the command line, `plugins`, and those that the file names are loaded first. Errors: not_found,
/// bad_input, unavailable.
[[nodiscard]] Result<OpenedWorld> open_world(const std::filesystem::path& file,
                                             const std::vector<NamedFile>& plugins = {});
/// Without a node: with the types of the tree and those of the plugins, the command line's before `plugins`.
/// Errors: those of Plugins::load.
[[nodiscard]] Result<OpenedWorld> new_world(const std::vector<NamedFile>& plugins);
/// What a plan names, and then what the plugins' importers read, into a new world. `what`: for the progress.
[[nodiscard]] Result<gis::ImportReport> import_world(OpenedWorld& opened, gis::ImportPlan plan,
                                                     const std::vector<WorldPlugins::Data>& data,
                                                     const std::string& what);

/// Which providers show the world.
struct PictureContent {
  bool plain = false;  ///< the ground alone, with imagery draped on it as it is
};

struct WorldPicture {
  std::shared_ptr<nature::TerrainProvider> ground;
  std::unique_ptr<render::WorldView> view;
};
[[nodiscard]] WorldPicture make_world_picture(const OpenedWorld& world, const PictureContent& content = {});

/// `Type.attribute=value`: on every node of the type. bad_input: an unknown name, no such node, a value of
/// another kind.
[[nodiscard]] Status set_attribute(world::Database& db, const std::string& assignment);

/// A name that a world or its export can be written to, before any work is done: it ends in `ending`, it is
/// none of the inputs, and no file is there, unless `force`. Errors: bad_input, not_writable.
[[nodiscard]] Status check_output(const std::filesystem::path& output, std::string_view ending,
                                  InputFiles inputs, bool force);

}  // namespace rigor

// Plugins of the worlds that commands open (docs/world-plugins.md): by --plugin, by the rig, by the world
// itself.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sensor-hal/config/named_file.h"
#include "sim/world/plugin/plugin.h"

namespace rigor {

/// `--plugin`: for every world that this process opens from now on.
void set_command_plugins(const std::vector<std::string>& files);
[[nodiscard]] const std::vector<NamedFile>& command_plugins();

/// What a world in YAML, or an import plan, says of plugins:
///
///   plugins: [build/beehives.so]                # loaded before anything of the world is read
///   plugin_files: [hives.csv, { file: more.txt, importer: beehives }]   # read by their importers, after all
///   else
struct WorldPlugins {
  struct Data {
    NamedFile file;
    std::string importer;  ///< empty: the only one for the file's suffix
  };
  std::vector<NamedFile> plugins;
  std::vector<Data> data;
};
/// bad_input. Marks the keys as read.
[[nodiscard]] Result<WorldPlugins> read_world_plugins(const ConfigNode& root);

/// Loads each file once, whoever names it; who does stands in errors, which are those of Plugins::load.
[[nodiscard]] Status load_plugins(world::Plugins& plugins, const std::vector<NamedFile>& files);
/// Each in a transaction of its own; errors are those of Plugins::import_file.
[[nodiscard]] Status import_plugin_data(world::Plugins& plugins, const std::vector<WorldPlugins::Data>& data);

}  // namespace rigor

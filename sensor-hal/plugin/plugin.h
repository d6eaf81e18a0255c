// A plugin of the bench: a shared object with drivers (backends), applications or analyses, which a rig names
// in `plugins: [./libmine.so]`.
//
//   rigor::Status define(rigor::Registry& registry) {
//     rigor::Backend backend;
//     backend.name = "my-lidar";
//     backend.make_source = [] { return std::make_unique<MyLidar>(); };
//     registry.add(std::move(backend));
//     return {};
//   }
//   RIGOR_PLUGIN("my-lidar", "1.0", "A LiDAR of my own.", define)
//
// It is built against an installed Rigor (find_package(Rigor COMPONENTS Hal), target Rigor::Hal) with the
// compiler that built that, or it is refused before any code of it has run. Plugins are never unloaded. What
// a plugin adds under a name that is there already replaces it. docs/sdk.md walks through one.
#pragma once

#include <rigor/hal_abi.h>  // made by the build: a digest of the public headers

#include <filesystem>
#include <string>

#include "sensor-hal/channel/registry.h"
#include "sensor-hal/config/named_file.h"
#include "sensor-hal/plugin/plugin_abi.h"

namespace rigor {

struct LoadedPlugin {
  std::string name, version, meaning;
};

/// Loads a shared object and has it fill `registry`, which is left as it was where that fails. not_found;
/// bad_input: no shared object, no plugin, one that was built against something else (nothing of it has run
/// then), or what the plugin itself complains of. Setup thread.
[[nodiscard]] Result<LoadedPlugin> load_plugin(const std::filesystem::path& file, Registry& registry);
/// Each of them, in this order. Errors of load_plugin, at the place that names the file.
[[nodiscard]] Status load_plugins(const std::vector<NamedFile>& files, Registry& registry);

}  // namespace rigor

/// Once in a shared object, outside namespaces. `define_function`: rigor::Status(rigor::Registry&).
#define RIGOR_PLUGIN(plugin_name, plugin_version, plugin_meaning, define_function)                          \
  extern "C" {                                                                                              \
  extern __attribute__((visibility("default"))) const ::rigor::PluginEntry<::rigor::Registry> rigor_plugin; \
  const ::rigor::PluginEntry<::rigor::Registry> rigor_plugin = {"rigor plugin",                             \
                                                                RIGOR_PLUGIN_ABI(RIGOR_HAL_HEADERS_DIGEST), \
                                                                plugin_name,                                \
                                                                plugin_version,                             \
                                                                plugin_meaning,                             \
                                                                define_function};                           \
  }

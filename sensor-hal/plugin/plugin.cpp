#include "sensor-hal/plugin/plugin.h"

#include <exception>

#include "sensor-hal/plugin/plugin_file.h"

namespace rigor {

Result<LoadedPlugin> load_plugin(const std::filesystem::path& file, Registry& registry) {
  using Entry = PluginEntry<Registry>;
  static const PluginKind kind{"rigor_plugin", "rigor plugin", "RIGOR_PLUGIN", "plugin of the bench",
                               "Rigor::Hal"};
  const auto found = open_plugin(file, kind, RIGOR_PLUGIN_ABI(RIGOR_HAL_HEADERS_DIGEST));
  if (!found) return tl::unexpected<Error>(found.error());
  const auto* entry = static_cast<const Entry*>(*found);
  if (!entry->name || !entry->version || !entry->meaning || !entry->define)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a name, a version, a meaning and a function in the entry rigor_plugin, got none");
  const auto refuse = [&](const std::string& why) {
    return fail(ErrorCode::bad_input, file.string(),
                "the plugin " + std::string(entry->name) + " cannot be used: " + why);
  };
  Registry filled = registry;
  try {
    if (const Status s = entry->define(filled); !s) return refuse(s.error().text());
  } catch (const std::exception& e) {
    return refuse(std::string("an exception left its function: ") + e.what());
  } catch (...) {
    return refuse("an exception left its function");
  }
  registry = std::move(filled);
  return LoadedPlugin{entry->name, entry->version, entry->meaning};
}

Status load_plugins(const std::vector<NamedFile>& files, Registry& registry) {
  for (const NamedFile& plugin : files)
    if (const auto loaded = load_plugin(plugin.file, registry); !loaded)
      return fail(loaded.error().code, plugin.named_by, loaded.error().text());
  return {};
}

}  // namespace rigor

#include "bench/world/world_plugins.h"

#include "bench/console/progress.h"

namespace rigor {
namespace {

std::vector<NamedFile>& of_the_command() {
  static std::vector<NamedFile> files;
  return files;
}

/// The error of a file, with who names the file before it.
Status with_who_names_it(Status s, const NamedFile& file) {
  if (s) return s;
  Error e = s.error();
  e.where = e.where.empty() ? file.file.string() : e.where;
  e.where = file.named_by + ": " + e.where;
  return tl::unexpected<Error>(std::move(e));
}

}  // namespace

void set_command_plugins(const std::vector<std::string>& files) {
  of_the_command().clear();
  for (const std::string& file : files) of_the_command().push_back({file, "--plugin"});
}
const std::vector<NamedFile>& command_plugins() { return of_the_command(); }

Result<WorldPlugins> read_world_plugins(const ConfigNode& root) {
  return catch_config([&] {
    WorldPlugins out;
    out.plugins = named_files(root, "plugins");
    for (const ConfigNode& n : root.list_or_empty("plugin_files")) {
      WorldPlugins::Data data;
      const std::string file = n.is_map() ? n.text("file") : n.as_text();
      data.file = {root.base_dir() / file, n.place()};
      if (n.is_map()) {
        data.importer = n.text_or("importer", "");
        n.finish();
      }
      out.data.push_back(std::move(data));
    }
    return out;
  });
}

Status load_plugins(world::Plugins& plugins, const std::vector<NamedFile>& files) {
  for (const NamedFile& f : files) {
    std::error_code none;
    bool loaded = false;
    for (const world::PluginInfo& known : plugins.list())
      loaded = loaded || std::filesystem::equivalent(known.file, f.file, none);
    if (loaded) continue;
    if (auto s = with_who_names_it(plugins.load(f.file), f); !s) return s;
  }
  return {};
}

Status import_plugin_data(world::Plugins& plugins, const std::vector<WorldPlugins::Data>& data) {
  for (const auto& d : data) {
    const ProgressTask reading("read " + d.file.file.filename().string());
    if (auto s = with_who_names_it(plugins.import_file(d.file.file, d.importer), d.file); !s) return s;
  }
  return {};
}

}  // namespace rigor

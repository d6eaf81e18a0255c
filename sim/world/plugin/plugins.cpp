#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <utility>

#include "sensor-hal/plugin/plugin_file.h"
#include "sim/world/plugin/plugin.h"
#include "sim/world/plugin/trial.h"

namespace rigor::world {
namespace {

const std::string& library_abi() {
  static const std::string abi = RIGOR_WORLD_ABI;
  static_assert(sizeof(RIGOR_WORLD_ABI) <= sizeof(PluginEntry<PluginHost>::abi));
  return abi;
}

/// A foreign function, with its exceptions as errors.
template <class F>
Status guarded(const std::string& who, F&& call) {
  try {
    return call();
  } catch (const std::exception& e) {
    return fail(ErrorCode::bad_input, who, std::string("expected a return, got an exception: ") + e.what());
  } catch (...) {
    return fail(ErrorCode::bad_input, who, "expected a return, got an exception of an unknown type");
  }
}

std::string suffix_of(const std::filesystem::path& file) {
  std::string s = file.extension().string();
  for (auto& c : s)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c + 32);
  return s;
}

}  // namespace

struct Plugins::Impl {
  Database& db;
  std::vector<PluginInfo> list;
  std::vector<Importer> importers;

  [[nodiscard]] Status add(PluginInfo info, const std::function<Status(PluginHost&)>& define) {
    const auto where = info.file.empty() ? "plugin " + info.name : info.file.string();
    if (info.name.empty())
      return fail(ErrorCode::bad_input, where, "expected a plugin with a name, got none");
    for (const auto& other : list)
      if (other.name == info.name)
        return fail(ErrorCode::bad_input, where,
                    fmt::format("expected each plugin once, got '{}' again; the first is {}", info.name,
                                other.file.empty() ? "built in" : other.file.string()));
    PluginHost::Impl trial(db, importers, info.name);
    PluginHost host(trial);
    if (auto s = guarded(where, [&] { return define(host); }); !s) {
      // What the host refused says more than what the plugin made of it.
      const auto& e = trial.first_error() ? *trial.first_error() : s.error();
      return fail(e.code, where, e.where == where || e.where.empty() ? e.message : e.text());
    }
    if (trial.first_error()) return fail(trial.first_error()->code, where, trial.first_error()->text());
    if (auto s = trial.apply(); !s) return fail(s.error().code, where, s.error().text());
    info.types = trial.types();
    info.edges = trial.edges();
    info.rules = trial.rules();
    for (auto& i : trial.new_importers()) {
      info.importers.push_back(i.name);
      importers.push_back(std::move(i));
    }
    list.push_back(std::move(info));
    return {};
  }
};

Plugins::Plugins(Database& db) : impl_(std::make_unique<Impl>(Impl{db, {}, {}})) {}
Plugins::~Plugins() = default;

const std::vector<PluginInfo>& Plugins::list() const noexcept { return impl_->list; }
const std::vector<Importer>& Plugins::importers() const noexcept { return impl_->importers; }

Status Plugins::add(const BuiltInPlugin& plugin) {
  if (!plugin.define)
    return fail(ErrorCode::bad_input, "plugin " + plugin.name, "expected a function that defines, got none");
  return impl_->add({.name = plugin.name, .version = plugin.version, .meaning = plugin.meaning},
                    plugin.define);
}

Status Plugins::load(const std::filesystem::path& file) {
  static const PluginKind kind{"rigor_world_plugin", "rigor world plugin", "RIGOR_WORLD_PLUGIN",
                               "plugin of the world", "Rigor::World"};
  const auto found = open_plugin(file, kind, library_abi());
  if (!found) return tl::unexpected<Error>(found.error());
  const auto* entry = static_cast<const PluginEntry<PluginHost>*>(*found);
  if (entry->name == nullptr || entry->version == nullptr || entry->meaning == nullptr ||
      entry->define == nullptr)
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected a name, a version, a meaning and a function in the entry rigor_world_plugin, got none");
  std::error_code ec;
  const auto path = std::filesystem::absolute(file, ec);
  return impl_->add({.name = entry->name, .version = entry->version, .meaning = entry->meaning, .file = path},
                    entry->define);
}

Status Plugins::import_file(const std::filesystem::path& file, std::string_view importer) {
  const auto where = file.string();
  std::vector<std::string> names;
  const Importer* chosen = nullptr;
  for (const auto& i : impl_->importers) {
    const bool fits = importer.empty() ? std::find(i.suffixes.begin(), i.suffixes.end(), suffix_of(file)) !=
                                             i.suffixes.end()
                                       : i.name == importer;
    if (fits) chosen = &i, names.push_back(i.name);
  }
  if (names.size() > 1)
    return fail(ErrorCode::bad_input, where,
                fmt::format("expected one importer for {}, got {}; name one of them", suffix_of(file),
                            fmt::join(names, ", ")));
  if (chosen == nullptr) {
    for (const auto& i : impl_->importers) names.push_back(i.name);
    return fail(ErrorCode::bad_input, where,
                (importer.empty() ? "no importer reads files of the suffix '" + suffix_of(file) + "'"
                                  : "no importer has the name '" + std::string(importer) + "'") +
                    (names.empty() ? "; none is there: load a plugin that has one"
                                   : fmt::format("; there are {}", fmt::join(names, ", "))));
  }
  std::error_code ec;
  if (!std::filesystem::exists(file, ec))
    return fail(ErrorCode::not_found, where, "expected a file to import, got nothing: no such file");
  auto tx = impl_->db.begin("import " + file.filename().string());
  if (auto s = guarded(where, [&] { return chosen->run(file, tx); }); !s) return s;
  if (auto s = tx.commit(); !s) return fail(s.error().code, where, s.error().text());
  return {};
}

}  // namespace rigor::world

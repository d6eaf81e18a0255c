// Plugins: what makes a bare database know about forests, or bee-keeping. A plugin defines types and edges,
// adds rules, and registers importers. It is built in, or a shared object:
//
//   rigor::Status define(rigor::world::PluginHost& host) {
//     auto hive = host.define(rigor::world::TypeSpec{.name = "Beehive", …});
//     if (!hive) return tl::unexpected(hive.error());
//     return host.add_rule({.name = "beehives.frames", …});
//   }
//   RIGOR_WORLD_PLUGIN("beehives", "1.0", "Beehives and their colonies.", define)
//
// A shared object says what it was built against, in its constant `rigor_world_plugin`. That is read from the
// file before any code of it runs; where it differs from this library, the plugin is refused. What a plugin
// defines takes effect only when all of it can: one that fails, throws, or makes rules run in a ring leaves
// nothing behind. Plugins are never unloaded. docs/world-plugins.md walks through one.
#pragma once

#include <rigor/world_abi.h>  // made by the build: a digest of the public headers
#include <Eigen/Core>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/plugin/plugin_abi.h"
#include "sim/world/graph/database.h"

namespace rigor::world {

/// Reads a file into a world, within a transaction: where it fails, the world stays as it was.
struct Importer {
  std::string name;
  std::vector<std::string> suffixes = {};  ///< of its files, with the dot: `.csv`; small letters
  std::string meaning = "";
  std::function<Status(const std::filesystem::path& file, Transaction& tx)> run;
};

/// What a plugin sees of the world that it is added to. Setup, world thread.
class PluginHost {
 public:
  /// With all that this plugin has defined so far; handles from it stay good.
  [[nodiscard]] const Schema& schema() const noexcept;
  /// As Database's. A type or an edge that is there already, word for word, is found and not refused: a world
  /// file may have brought it. After an error the plugin is refused, whatever it returns.
  Result<TypeId> define(const TypeSpec& spec);
  Result<EdgeTypeId> define(const EdgeSpec& spec);
  Result<AttributeId> add_attribute(TypeId type, const AttributeSpec& spec);
  /// An exception that leaves the rule's function is a veto.
  Status add_rule(Rule rule);
  /// bad_input: a name twice, no function.
  Status add_importer(Importer importer);

  struct Impl;
  explicit PluginHost(Impl& impl) : impl_(impl) {}
  PluginHost(const PluginHost&) = delete;
  PluginHost& operator=(const PluginHost&) = delete;

 private:
  Impl& impl_;
};

struct PluginInfo {
  std::string name, version, meaning;
  std::filesystem::path file = {};  ///< empty: built in
  std::vector<std::string> types = {}, edges = {}, rules = {}, importers = {};
};

/// A plugin that is part of the program.
struct BuiltInPlugin {
  std::string name, version, meaning;
  std::function<Status(PluginHost&)> define;
};

/// The plugins of one database. World thread, outside transactions.
class Plugins {
 public:
  /// The database must outlive this.
  explicit Plugins(Database& db);
  ~Plugins();
  Plugins(const Plugins&) = delete;
  Plugins& operator=(const Plugins&) = delete;

  /// bad_input: a name twice, or what the plugin itself complains of.
  [[nodiscard]] Status add(const BuiltInPlugin& plugin);
  /// A shared object. not_found; bad_input: no shared object, no plugin, one built against something else
  /// (nothing of it has run then), a name twice, or what the plugin itself complains of.
  [[nodiscard]] Status load(const std::filesystem::path& file);

  /// In the order in which they were added.
  [[nodiscard]] const std::vector<PluginInfo>& list() const noexcept;
  [[nodiscard]] const std::vector<Importer>& importers() const noexcept;
  /// By the importer of that name, or by the only one for the file's suffix, in one transaction. not_found;
  /// bad_input: no importer or several for the suffix, what the importer or a rule complains of.
  [[nodiscard]] Status import_file(const std::filesystem::path& file, std::string_view importer = "");

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// ---------------------------------------------------------------- the entry of a shared object

/// All that the layout of what the two sides hand each other depends on.
// clang-format off
#define RIGOR_WORLD_ABI RIGOR_PLUGIN_ABI(RIGOR_WORLD_HEADERS_DIGEST)                                       \
  "; Eigen " RIGOR_PLUGIN_TEXT(EIGEN_WORLD_VERSION) "." RIGOR_PLUGIN_TEXT(EIGEN_MAJOR_VERSION) "."          \
  RIGOR_PLUGIN_TEXT(EIGEN_MINOR_VERSION) ", alignment " RIGOR_PLUGIN_TEXT(EIGEN_MAX_STATIC_ALIGN_BYTES)
// clang-format on

}  // namespace rigor::world

/// Once in a shared object, outside namespaces. `define_function`: rigor::Status(rigor::world::PluginHost&).
#define RIGOR_WORLD_PLUGIN(plugin_name, plugin_version, plugin_meaning, define_function)                    \
  extern "C" {                                                                                              \
  extern __attribute__((visibility("default"))) const ::rigor::PluginEntry<::rigor::world::PluginHost>      \
      rigor_world_plugin;                                                                                   \
  const ::rigor::PluginEntry<::rigor::world::PluginHost> rigor_world_plugin = {                             \
      "rigor world plugin", RIGOR_WORLD_ABI, plugin_name, plugin_version, plugin_meaning, define_function}; \
  }

// What a shared object says of itself, read from the file without running any of it.
#pragma once

#include <filesystem>
#include <string>

#include "rt-core/result.h"

namespace rigor {

/// How shared objects of one kind are known: by an entry of the form of PluginEntry (plugin_abi.h).
struct PluginKind {
  const char* entry;   ///< its symbol
  const char* magic;   ///< its first text
  const char* macro;   ///< that makes it
  const char* noun;    ///< "plugin of the world"
  const char* target;  ///< of CMake, to link with
};

/// The text of the ABI that a plugin was built against. not_found; bad_input: no shared object of this
/// machine, cut short, or no plugin of this kind.
[[nodiscard]] Result<std::string> plugin_abi_of(const std::filesystem::path& file, const PluginKind& kind);

/// What differs between two such texts, in the words of a message.
[[nodiscard]] std::string abi_difference(const std::string& library, const std::string& plugin);

/// Loads a plugin for good, and gives its entry. Errors of plugin_abi_of; bad_input: built against something
/// else (nothing of it has run then), or it cannot be loaded. Setup context.
[[nodiscard]] Result<const void*> open_plugin(const std::filesystem::path& file, const PluginKind& kind,
                                              const std::string& abi);

}  // namespace rigor

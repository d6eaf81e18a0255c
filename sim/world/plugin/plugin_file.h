// What a shared object says of itself, read from the file without running any of it.
#pragma once

#include <filesystem>
#include <string>

#include "rt-core/result.h"

namespace rigor::world {

/// The text of the ABI that a plugin was built against. not_found; bad_input: no shared object of this
/// machine, cut short, or no plugin.
[[nodiscard]] Result<std::string> plugin_abi_of(const std::filesystem::path& file);

/// What differs between two such texts, in the words of a message.
[[nodiscard]] std::string abi_difference(const std::string& library, const std::string& plugin);

}  // namespace rigor::world

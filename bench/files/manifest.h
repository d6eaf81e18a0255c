// What folders that grow over several starts of a command say of themselves: a manifest with the options and
// with digests of all inputs, by which the next start finds whether it may go on.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bench/files/output_file.h"

namespace rigor {

/// SHA-256 of each file by its path relative to the folder of `main`, such as the rig.
[[nodiscard]] nlohmann::json input_digests(const InputFiles& files, const std::filesystem::path& main);
/// Where two manifests differ first, in words; empty where they are the same.
[[nodiscard]] std::string manifest_difference(const nlohmann::json& there, const nlohmann::json& here);

}  // namespace rigor

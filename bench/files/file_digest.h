#pragma once

#include <filesystem>
#include <string>

namespace rigor {

/// SHA-256 of a file's bytes in hexadecimal digits; empty where it cannot be read.
[[nodiscard]] std::string sha256_of(const std::filesystem::path& file);

}  // namespace rigor

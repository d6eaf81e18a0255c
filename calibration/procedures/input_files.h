// The files that a user names as inputs of a calibration.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor {

/// Files that the inputs name: a folder stands for what it holds with one of these extensions, in the order
/// of names. bad_input: no inputs; not_found.
[[nodiscard]] Result<std::vector<std::filesystem::path>> input_files(
    const std::vector<std::filesystem::path>& inputs, const std::vector<std::string>& extensions);

}  // namespace rigor

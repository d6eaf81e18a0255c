#include "calibration/procedures/input_files.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>

namespace rigor {

Result<std::vector<std::filesystem::path>> input_files(const std::vector<std::filesystem::path>& inputs,
                                                       const std::vector<std::string>& extensions) {
  if (inputs.empty()) return fail(ErrorCode::bad_input, "INPUT", "expected a file or a folder, got none");
  std::vector<std::filesystem::path> files;
  std::error_code ec;
  for (const auto& input : inputs) {
    if (!std::filesystem::is_directory(input, ec)) {
      if (!std::filesystem::exists(input, ec))
        return fail(ErrorCode::not_found, input.string(),
                    "expected a file or a folder, got nothing of that name");
      files.push_back(input);
      continue;
    }
    std::vector<std::filesystem::path> found;
    for (const auto& entry : std::filesystem::directory_iterator(input, ec)) {
      std::string extension = entry.path().extension().string();
      std::transform(extension.begin(), extension.end(), extension.begin(),
                     [](unsigned char c) { return std::tolower(c); });
      if (std::find(extensions.begin(), extensions.end(), extension) != extensions.end())
        found.push_back(entry.path());
    }
    if (found.empty())
      return fail(
          ErrorCode::not_found, input.string(),
          fmt::format("expected files ending in {} in this folder, found none", fmt::join(extensions, ", ")));
    std::sort(found.begin(), found.end());
    files.insert(files.end(), found.begin(), found.end());
  }
  return files;
}

}  // namespace rigor

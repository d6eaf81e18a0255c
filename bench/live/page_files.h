// The page's files, as they were when the program was built: bench/live/page, listed in page/files.cmake.
#pragma once

#include <span>
#include <string_view>

namespace rigor::live {

struct PageFile {
  std::string_view path;  ///< "index.html", "vendor/three.module.js"
  std::string_view bytes;
};
[[nodiscard]] std::span<const PageFile> page_files();

}  // namespace rigor::live

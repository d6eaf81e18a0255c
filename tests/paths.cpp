#include "tests/paths.h"

#include <cstdlib>

namespace rigor::test {

const std::string& source_dir() {
  static const std::string folder = RIGOR_SOURCE_DIR;
  return folder;
}

const std::string& build_dir() {
  static const std::string folder = RIGOR_BINARY_DIR;
  return folder;
}

std::filesystem::path test_data(const std::string& name) {
  const char* const data = std::getenv("RIGOR_TEST_DATA");
  const std::filesystem::path folder =
      data ? std::filesystem::path(data)
           : std::filesystem::path(source_dir()).parent_path() / "shared" / "data";
  return folder / name;
}

}  // namespace rigor::test

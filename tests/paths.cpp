#include "tests/paths.h"

namespace rigor::test {

const std::string& source_dir() {
  static const std::string folder = RIGOR_SOURCE_DIR;
  return folder;
}

const std::string& build_dir() {
  static const std::string folder = RIGOR_BINARY_DIR;
  return folder;
}

}  // namespace rigor::test

#pragma once

#include <string>

namespace rigor::test {

/// The folder of the sources, absolute. A function in place of a macro, so that one object file alone depends
/// on the place.
const std::string& source_dir();

/// The folder that CMake builds in, absolute.
const std::string& build_dir();

}  // namespace rigor::test

#pragma once

#include <filesystem>
#include <string>

namespace rigor::test {

/// The folder of the sources, absolute. A function in place of a macro, so that one object file alone depends
/// on the place.
const std::string& source_dir();

/// The folder that CMake builds in, absolute.
const std::string& build_dir();

/// A folder or file of the test data: below RIGOR_TEST_DATA, else below ../shared/data of the sources. It may
/// not exist.
std::filesystem::path test_data(const std::string& name);

}  // namespace rigor::test

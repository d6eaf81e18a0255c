// The rigs below configs/, as parameters of a test: one case each.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <ostream>
#include <string>
#include <vector>

#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor::test {

struct Rig {
  std::string path;  ///< below configs/
};
inline std::ostream& operator<<(std::ostream& out, const Rig& rig) { return out << rig.path; }

/// Files below configs/ that are rigs: those with channels.
inline std::vector<Rig> rigs() {
  const std::filesystem::path folder = rigor::test::source_dir() + "/configs";
  std::vector<Rig> found;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file() || entry.path().extension() != ".yaml") continue;
    if (("\n" + read_file(entry.path())).find("\nchannels:") == std::string::npos) continue;
    found.push_back({entry.path().lexically_relative(folder).generic_string()});
  }
  std::sort(found.begin(), found.end(), [](const Rig& a, const Rig& b) { return a.path < b.path; });
  return found;
}

/// "rigs/pair-watch.yaml" as a name of a case: "rigs_pair_watch".
inline std::string name_of(const testing::TestParamInfo<Rig>& info) {
  std::string name = std::filesystem::path(info.param.path).replace_extension().generic_string();
  for (char& c : name)
    if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '_';
  return name;
}

}  // namespace rigor::test

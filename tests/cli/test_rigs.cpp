// Every rig below configs/ runs in virtual time and is replayed: what the application saw of each kind of
// driver and sink is seen again from the recording. One case a rig; the list is read when the binary starts.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;

struct Rig {
  std::string path;  ///< below configs/
};
std::ostream& operator<<(std::ostream& out, const Rig& rig) { return out << rig.path; }

/// Files below configs/ that are rigs: those with channels.
std::vector<Rig> rigs() {
  const std::filesystem::path folder = RIGOR_SOURCE_DIR "/configs";
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
std::string name_of(const testing::TestParamInfo<Rig>& info) {
  std::string name = std::filesystem::path(info.param.path).replace_extension().generic_string();
  for (char& c : name)
    if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '_';
  return name;
}

class EveryRig : public testing::TestWithParam<Rig> {
 protected:
  TempDir dir;
};

TEST_P(EveryRig, LoadsAndRunsAndIsReplayed) {
  const std::string recording = (dir / "any.mcap").string();
  std::vector<std::string> words{"run",
                                 config(GetParam().path),
                                 "--clock",
                                 "virtual",
                                 "--duration",
                                 "0.2",
                                 "--json",
                                 "--record",
                                 recording,
                                 "--report",
                                 (dir / "any").string()};
  // In place of `rigor tune`, which writes beside the rig.
  if (GetParam().path == "rigs/tuned-scan.yaml")
    words.insert(words.end(), {"--set", "channels.scan.engine=rays"});
  const Said said = rigor(words);
  ASSERT_EQ(said.status, 0) << said.err;
  const Said replay = rigor({"replay", recording, "--json"});
  ASSERT_EQ(replay.status, 0) << replay.err;
  const json seen = json::parse(said.out)["seen_sha256"];
  EXPECT_NE(seen, "");
  EXPECT_EQ(json::parse(replay.out)["seen_sha256"], seen);
}
INSTANTIATE_TEST_SUITE_P(Tree, EveryRig, testing::ValuesIn(rigs()), name_of);

// The cases above are found by the text `channels:` at the start of a line. Here rigs are found in another
// way: by their folder and by what documents name, so that none drops out of the list unseen.
TEST(Rigs, OfTheRigFolderAndTheDemoAreAllTried) {
  std::set<std::string> tried, there{"demo.yaml"};
  for (const Rig& rig : rigs()) tried.insert(rig.path);
  for (const auto& entry : std::filesystem::directory_iterator(RIGOR_SOURCE_DIR "/configs/rigs"))
    if (entry.path().extension() == ".yaml") there.insert("rigs/" + entry.path().filename().string());
  EXPECT_EQ(tried, there);
}

}  // namespace
}  // namespace rigor::test

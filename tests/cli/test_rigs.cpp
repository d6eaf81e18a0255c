// Every rig below configs/ runs in virtual time and is replayed: what the application saw of each kind of
// driver and sink is seen again from the recording. One case a rig; the list is read when the binary starts.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>

#include "tests/cli/command.h"
#include "tests/cli/rigs_of_the_tree.h"

namespace rigor::test {
namespace {

using nlohmann::json;

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

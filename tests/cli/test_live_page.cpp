// The live view's page: its readers against the reference's, and the page in a browser. There each test is a
// case of tests/npm/live_page.mjs, which runs `rigor run --live` on a rig of its own, opens the page in
// headless Chromium and does what a user does.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

const std::string kSource = RIGOR_SOURCE_DIR;

class LivePageModules : public ::testing::Test {
 protected:
  void SetUp() override {
    if (std::system("node --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "node is not installed";
    if (!std::filesystem::exists(kSource + "/tests/npm/node_modules/playwright-core"))
      GTEST_SKIP() << "playwright-core is absent; run ./dev deps test, or npm ci --prefix tests/npm";
  }
  static void expect(std::vector<std::string> words) {
    words.front() = kSource + "/tests/npm/" + words.front();
    words.insert(words.begin(), "node");
    Command node(words);
    const Said said = node.wait(std::chrono::seconds(240));
    EXPECT_EQ(said.status, 0) << said.err;
  }
};

class LivePage : public LivePageModules {
 protected:
  void SetUp() override {
    LivePageModules::SetUp();
    if (!std::filesystem::exists("/usr/bin/chromium")) GTEST_SKIP() << "chromium is not installed";
  }
  static void expect(const std::string& name) {
    LivePageModules::expect(
        {"live_page.mjs", name, rigor_words({}).front(), kSource + "/tests/cli/live-page.yaml"});
  }
};

TEST_F(LivePageModules, ReadMessagesAsTheReferenceDoes) {
  TempDir dir;
  const std::string recording = (dir / "page.mcap").string();
  const Said said = rigor({"run", kSource + "/tests/cli/live-page.yaml", "--clock", "virtual", "--duration",
                           "1", "--record", recording, "--report", (dir / "report").string()});
  ASSERT_EQ(said.status, 0) << said.err;
  expect({"page_modules.mjs", "messages", recording});
}
TEST_F(LivePageModules, ShowPixelsOfEveryFormat) { expect({"page_modules.mjs", "pictures"}); }

TEST_F(LivePageModules, RememberALongRunInBoundedMemory) { expect({"page_modules.mjs", "history"}); }

TEST_F(LivePage, ShowsEveryKindOfChannelWithoutTrouble) { expect("shows"); }
TEST_F(LivePage, SwitchesAPair) { expect("switches"); }
TEST_F(LivePage, InjectsAFaultAndShowsIt) { expect("faults"); }
TEST_F(LivePage, ShowsHowExpectationsStand) { expect("expects"); }
TEST_F(LivePage, AnEditIsSeenInTheNextPictureAndABadOneIsRefused) { expect("edits"); }
TEST_F(LivePage, AsksForTheToken) { expect("token"); }
TEST_F(LivePage, ShowsAReplayAsARun) { expect("replays"); }
TEST_F(LivePage, SaysThatTheRunHasEnded) { expect("ends"); }

}  // namespace
}  // namespace rigor::test

// The live view's page: its readers against the reference's, and the page in a browser. There each test is a
// case of tests/npm/live_page.mjs, which runs `rigor run --live` on a rig of its own, opens the page in
// headless Chromium and does what a user does. The cases that run in one process share the browser.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

const std::string kSource = rigor::test::source_dir();

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
  static void SetUpTestSuite() {
    const auto& suite = *::testing::UnitTest::GetInstance()->current_test_suite();
    std::vector<std::string> words{"node", kSource + "/tests/npm/live_page.mjs", rigor_words({}).front(),
                                   kSource + "/tests/cli/live-page.yaml"};
    for (int i = 0; i < suite.total_test_count(); ++i)
      if (suite.GetTestInfo(i)->should_run()) words.emplace_back(suite.GetTestInfo(i)->name());
    cases = std::make_unique<Command>(words);
  }
  static void TearDownTestSuite() { cases.reset(); }
  void SetUp() override {
    LivePageModules::SetUp();
    if (!std::filesystem::exists("/usr/bin/chromium-headless-shell") &&
        !std::filesystem::exists("/usr/bin/chromium"))
      GTEST_SKIP() << "chromium-headless-shell is not installed";
  }
  /// Waits for the end of the case with this test's name.
  static void expect_passed() {
    const std::string name = ::testing::UnitTest::GetInstance()->current_test_info()->name();
    const auto ended = [&] {
      const std::string said = cases->out();
      return said.find("passed " + name + "\n") != std::string::npos ||
             said.find("failed " + name + "\n") != std::string::npos;
    };
    while (cases->running() && !ended()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
    EXPECT_NE(cases->out().find("passed " + name + "\n"), std::string::npos) << cases->err();
  }
  static inline std::unique_ptr<Command> cases;
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

TEST_F(LivePage, ShowsEveryKindOfChannelWithoutTrouble) { expect_passed(); }
TEST_F(LivePage, SwitchesAPair) { expect_passed(); }
TEST_F(LivePage, InjectsAFaultAndShowsIt) { expect_passed(); }
TEST_F(LivePage, ShowsHowExpectationsStand) { expect_passed(); }
TEST_F(LivePage, AnEditIsSeenInTheNextPictureAndABadOneIsRefused) { expect_passed(); }
TEST_F(LivePage, ShowsFramesAndCloudsInTheirPlaces) { expect_passed(); }
TEST_F(LivePage, AsksForTheToken) { expect_passed(); }
TEST_F(LivePage, ShowsAReplayAsARun) { expect_passed(); }
TEST_F(LivePage, SaysThatTheRunHasEnded) { expect_passed(); }

}  // namespace
}  // namespace rigor::test

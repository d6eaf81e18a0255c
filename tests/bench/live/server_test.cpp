// The live view of a run by an independent client: each test is a case of tests/npm/live_client.mjs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "tests/cli/command.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

const std::string kSource = rigor::test::source_dir();

class LiveServer : public ::testing::Test {
 protected:
  void SetUp() override {
    if (std::system("node --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "node is not installed";
    if (!std::filesystem::exists(kSource + "/tests/npm/node_modules/@foxglove/ws-protocol"))
      GTEST_SKIP() << "@foxglove/ws-protocol is absent; run ./dev deps test, or npm ci --prefix tests/npm";
  }
  static void expect(const std::string& name) {
    Command node({"node", kSource + "/tests/npm/live_client.mjs", name, rigor_words({}).front(),
                  kSource + "/tests/cli/live-page.yaml"});
    const Said said = node.wait(std::chrono::seconds(240));
    EXPECT_EQ(said.status, 0) << said.err;
  }
};

TEST_F(LiveServer, OffersTheTopicsOfARecording) { expect("topics"); }
TEST_F(LiveServer, TellsHowExpectationsStand) { expect("expects"); }
TEST_F(LiveServer, AnswersServicesAndRecordsEdits) { expect("services"); }
TEST_F(LiveServer, RefusesOtherSitesAndLimitsClients) { expect("access"); }
TEST_F(LiveServer, DropsMessagesForASlowClientAlone) { expect("slow"); }
TEST_F(LiveServer, TellsFramesToWhoComesLaterAndThinsForWhoAsksForLess) { expect("frames"); }
TEST_F(LiveServer, AsksForTheToken) { expect("token"); }

TEST(LiveOptions, AreRefusedBeforeAnythingIsTouched) {
  const std::string rig = kSource + "/tests/cli/live-page.yaml";
  const auto refused = [&](std::vector<std::string> more, const char* words) {
    more.insert(more.begin(), {"run", rig, "--clock", "virtual"});
    const Said said = rigor(more);
    EXPECT_EQ(said.status, 2);
    EXPECT_THAT(said.err, ::testing::HasSubstr(words));
  };
  refused({"--live", "nonsense"}, "--live: expected [ADDRESS:]PORT");
  refused({"--live", "0.0.0.0:0", "--live-open"}, "leave --live-open out");
  refused({"--live", "0", "--live-open", "--live-token", "open-sesame"}, "got both");
  refused({"--live-open"}, "expected --live with it");
  refused({"--live", "0.0.0.0:0", "--live-token", "short"}, "at least 8 characters");
  refused({"--live-token", "open-sesame"}, "expected --live with it");
}

}  // namespace
}  // namespace rigor::test

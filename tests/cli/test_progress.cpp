// What is said of work that takes long: speed and time left by an injected clock, and as programs meet it.
#include "bench/console/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/cli/command.h"
#include "tests/cli/world_fixture.h"

namespace rigor {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

MonotonicTime at(double s) { return MonotonicTime(0) + seconds_from(s); }

TEST(ProgressMeter, TellsTheTimeThatIsLeftByTheSpeedOfLateNotOfTheWhole) {
  ProgressMeter meter(at(0));
  EXPECT_TRUE(std::isnan(meter.eta_s(1000))) << "nothing is known at the beginning";
  double done = 0;
  for (int i = 1; i <= 50; ++i) meter.take(at(0.2 * i), done = 10 * 0.2 * i);  // 10 a second for 10 s
  EXPECT_NEAR(meter.speed(), 10, 0.2);
  EXPECT_NEAR(meter.eta_s(1000), 90, 2);
  for (int i = 1; i <= 200; ++i) meter.take(at(10 + 0.2 * i), done += 0.2);  // then 1 a second for 40 s
  EXPECT_NEAR(meter.speed(), 1, 0.05);
  EXPECT_NEAR(meter.eta_s(1000), 860, 45) << "not 50 s x 860 / 140 = 307 s";
}

TEST(ProgressMeter, WaitsLongerWhereNothingGoesOn) {
  ProgressMeter meter(at(0));
  for (int i = 1; i <= 50; ++i) meter.take(at(0.2 * i), 2.0 * i);
  const double before = meter.eta_s(200);
  for (int i = 1; i <= 500; ++i) meter.take(at(10 + 0.2 * i), 100);
  EXPECT_GT(meter.eta_s(200), 5 * before);
}

TEST(ProgressMeter, KnowsTheSpeedOfWorkThatAdvancesInLargeSteps) {
  ProgressMeter meter(at(0));
  for (int i = 1; i <= 5 * 300; ++i) meter.take(at(0.2 * i), std::floor(0.2 * i / 60));  // a step a minute
  EXPECT_NEAR(meter.eta_s(10), 300, 10);
}

TEST(ProgressMeter, NeverGoesBack) {
  ProgressMeter meter(at(0));
  meter.take(at(1), 10);
  meter.take(at(2), 5);
  EXPECT_EQ(meter.done(), 10);
}

TEST(ProgressDisplay, SaysNothingOfWhatTakesLessThanTwoSeconds) {
  for (const bool terminal : {true, false}) {
    ProgressDisplay display(ProgressFormat::line, terminal);
    EXPECT_THAT(display.begin("work", 10, "pictures", at(0)).text, IsEmpty());
    for (int i = 1; i < 10; ++i) EXPECT_THAT(display.update(i, "", at(0.2 * i)).text, IsEmpty());
    EXPECT_THAT(display.end(10, "", true, at(1.9)).text, IsEmpty());
  }
}

TEST(ProgressDisplay, RewritesOneLineOfATerminalThatFitsAndClearsIt) {
  ProgressDisplay display(ProgressFormat::line, true);
  (void)display.begin("start", 0, "", at(0));
  (void)display.begin("run", 50, "s", at(1));
  for (int i = 0; i < 20; ++i) (void)display.update(i, "", at(1 + 0.1 * i));
  auto out = display.update(21, "12 found", at(3), 200);
  EXPECT_TRUE(out.rewritten);
  EXPECT_THAT(out.text, AllOf(HasSubstr("start: run"), HasSubstr("42 %"), HasSubstr("21.0 of 50.0 s"),
                              HasSubstr("x real time"), HasSubstr(" left"), HasSubstr("12 found")));
  EXPECT_THAT(out.text, Not(HasSubstr("\n")));
  EXPECT_EQ(display.update(22, "ä long note that does not fit in", at(3.2), 40).text.size(), 39U);
  EXPECT_FALSE(display.end(50, "", true, at(4)).rewritten) << "another task is shown now";
  out = display.end(0, "", false, at(5));
  EXPECT_TRUE(out.rewritten && out.text.empty()) << "the line is cleared";
}

TEST(ProgressDisplay, WritesALineNowAndThenWhereNoTerminalIs) {
  ProgressDisplay display(ProgressFormat::line, false);
  (void)display.begin("run", 1000, "s", at(0));
  int lines = 0;
  for (int i = 1; i <= 5000; ++i) {
    const auto out = display.update(0.2 * i, "", at(0.2 * i));  // 1000 s
    EXPECT_FALSE(out.rewritten);
    if (out.text.empty()) continue;
    ++lines;
    EXPECT_THAT(out.text, AllOf(HasSubstr("run  "), HasSubstr("%")));
  }
  EXPECT_GE(lines, 30);
  EXPECT_LE(lines, 40);
}

TEST(ProgressDisplay, WritesObjectsThatEndAtOneWhereAllWasDone) {
  ProgressDisplay display(ProgressFormat::json, false);
  std::string text = display.begin("run", 4, "s", at(0)).text;
  for (int i = 1; i <= 20; ++i) text += display.update(0.1 * i, "\"quoted\" \xff", at(0.2 * i)).text;
  text += display.end(2.5, "", true, at(4.1)).text;
  std::istringstream in(text);
  std::vector<json> objects;
  for (std::string line; std::getline(in, line);) objects.push_back(json::parse(line));
  ASSERT_EQ(objects.size(), 2U + 20U) << text;
  EXPECT_EQ(objects.front()["done"], 0);
  EXPECT_TRUE(objects.front()["eta_s"].is_null());
  EXPECT_EQ(objects[5]["task"], "run");
  EXPECT_NEAR(objects[5]["speed"].get<double>(), 0.5, 0.01);
  EXPECT_NEAR(objects[5]["eta_s"].get<double>(), 2 * (4 - objects[5]["done"].get<double>()), 0.1);
  EXPECT_EQ(objects.back()["fraction"], 1);
  EXPECT_EQ(objects.back()["eta_s"], 0);
}

TEST(ProgressDisplay, DoesNotCallWholeWhatBrokeOff) {
  ProgressDisplay display(ProgressFormat::json, false);
  (void)display.begin("run", 4, "s", at(0));
  EXPECT_EQ(json::parse(display.end(1, "", false, at(1)).text)["fraction"], 0.25);
}

TEST(TextOfSpan, HasTwoUnits) {
  EXPECT_EQ(text_of_span(34.4), "34 s");
  EXPECT_EQ(text_of_span(94), "1 min 34 s");
  EXPECT_EQ(text_of_span(2 * 3600 + 5 * 60), "2 h 5 min");
  EXPECT_EQ(text_of_span(76 * 3600), "3 d 4 h");
}

// ---------------------------------------------------------------- as programs meet it

/// Objects of the task, of what a command wrote to stderr with --progress json.
std::vector<json> objects_of(const std::string& err, const std::string& task) {
  std::vector<json> all;
  std::istringstream in(err);
  for (std::string line; std::getline(in, line);) {
    json object = json::parse(line, nullptr, false);
    if (object.is_discarded()) ADD_FAILURE() << line;
    if (object.is_object() && object["task"] == task) all.push_back(std::move(object));
  }
  return all;
}

void increase_to_one(const std::vector<json>& objects) {
  ASSERT_GE(objects.size(), 2U);
  double last = 0;
  for (const json& o : objects) {
    EXPECT_GE(o["fraction"].get<double>(), last) << o;
    last = o["fraction"];
  }
  EXPECT_EQ(objects.front()["fraction"], 0);
  EXPECT_EQ(last, 1);
}

TEST(Progress, OfAVirtualRunIsJsonThatIncreasesToOne) {
  // A pace of 1 keeps it from being over at once.
  const test::TempDir dir;
  const test::Said said = test::rigor({"run", test::config("demo.yaml"), "--clock", "virtual", "--duration",
                                       "3", "--pace", "1", "--json", "--progress", "json"},
                                      dir.path());
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_TRUE(json::parse(said.out).is_object());
  const auto run = objects_of(said.err, "run");
  increase_to_one(run);
  EXPECT_GE(run.size(), 5U);
  EXPECT_EQ(run.back()["total"], 3);
  EXPECT_EQ(run.back()["unit"], "s");
  EXPECT_GT(run[run.size() / 2]["done"], 0);
  EXPECT_GT(run[run.size() - 2]["speed"], 0);
  EXPECT_LT(run[run.size() - 2]["speed"], 1.3) << "no faster than its pace";
  EXPECT_THAT(run.back()["note"].get<std::string>(), HasSubstr("cycles"));
  EXPECT_FALSE(objects_of(said.err, "start").empty()) << "phases before it have names";
  EXPECT_FALSE(objects_of(said.err, "read turntable.yaml").empty());
}

TEST(Progress, IsSilentWhereWorkIsShortOrNobodyWantsIt) {
  for (const char* format : {"line", "none"}) {
    const test::TempDir dir;
    const test::Said said = test::rigor({"run", test::config("demo.yaml"), "--clock", "virtual", "--duration",
                                         "0.1", "--json", "--progress", format},
                                        dir.path());
    EXPECT_EQ(said.status, 0);
    EXPECT_THAT(said.err, IsEmpty());
  }
  const test::Said wrong = test::rigor({"run", test::config("demo.yaml"), "--progress", "bar"});
  EXPECT_EQ(wrong.status, 2);
  EXPECT_THAT(wrong.err, HasSubstr("--progress"));
}

TEST(Progress, OnATerminalIsOneLineThatIsRewrittenAndClearedAtTheEnd) {
  auto words = test::rigor_words(
      {"run", test::config("demo.yaml"), "--clock", "virtual", "--duration", "4", "--pace", "1", "--json"});
  std::vector<char*> argv;
  for (auto& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);
  const test::TempDir dir;
  const MonotonicTime begin = monotonic_now();
  const winsize size{.ws_row = 24, .ws_col = 60, .ws_xpixel = 0, .ws_ypixel = 0};
  int terminal = -1;
  const pid_t pid = forkpty(&terminal, nullptr, nullptr, &size);
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (chdir(dir.path().c_str()) != 0) _exit(125);
    if (freopen("/dev/null", "w", stdout) == nullptr) _exit(126);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  std::string shown;
  std::array<char, 4096> block{};
  for (ssize_t n = 0; (n = read(terminal, block.data(), block.size())) > 0;)
    shown.append(block.data(), static_cast<std::size_t>(n));
  int status = 0;
  waitpid(pid, &status, 0);
  close(terminal);
  EXPECT_EQ(status, 0);
  const std::string clear = "\r\033[K";
  EXPECT_THAT(shown, AllOf(HasSubstr(clear + "run  "), HasSubstr("of 4.0 s"), Not(HasSubstr("\n"))));
  EXPECT_TRUE(shown.ends_with(clear)) << shown;
  int lines = 0;
  for (std::size_t from = shown.find(clear); from != std::string::npos; ++lines) {
    const std::size_t next = shown.find(clear, from + 1);
    EXPECT_LE(std::min(next, shown.size()) - from - clear.size(), 59U) << "it fits in the terminal";
    from = next;
  }
  EXPECT_GE(lines, 4);
  EXPECT_LE(lines, 4 + 6 * (monotonic_now() - begin).seconds()) << "a few times a second";
}

class ProgressOfWorlds : public test::World {};

TEST_F(ProgressOfWorlds, ImportAndRenderIncreaseToOne) {
  const test::Said imported = import("w.rigor", {"--progress", "json"});
  ASSERT_EQ(imported.status, 0) << imported.err;
  increase_to_one(objects_of(imported.err, "import"));
  const test::Said drawn = world({"render", "w.rigor", "-o", "w.png", "--renderer", "rays", "--width", "64",
                                  "--height", "48", "--progress", "json"});
  ASSERT_EQ(drawn.status, 0) << drawn.err;
  increase_to_one(objects_of(drawn.err, "draw"));
  EXPECT_FALSE(objects_of(drawn.err, "collect what is in view").empty());
  const test::Said by_vulkan = world({"render", "w.rigor", "-o", "v.png", "--renderer", "raster", "--width",
                                      "64", "--height", "48", "--progress", "json"});
  ASSERT_EQ(by_vulkan.status, 0) << by_vulkan.err;
  increase_to_one(objects_of(by_vulkan.err, "draw"));
}

}  // namespace
}  // namespace rigor

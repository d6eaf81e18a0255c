// Ctrl-C keeps the best so far, marked; progress is rewritten on terminals alone.
#include <pty.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// Whether `text`, lines of --progress json and others, says of the task that so much is done.
bool says(const std::string& text, const std::string& task, double done) {
  std::istringstream in(text.substr(0, text.rfind('\n') + 1));
  for (std::string line; std::getline(in, line);)
    if (const auto o = nlohmann::json::parse(line, nullptr, false);
        o.is_object() && o["task"] == task && o["done"].get<double>() >= done)
      return true;
  return false;
}

/// A command whose messages go to a terminal; SIGINT as soon as so much of a task is done.
struct Interrupted {
  int status = -1;
  bool signalled = false;
  std::string out, shown;
};
Interrupted interrupt_at(const std::string& task, double done, std::vector<std::string> words,
                         const TempDir& dir) {
  words.insert(words.end(), {"--progress", "json"});
  words = rigor_words(std::move(words));
  std::vector<char*> argv;
  for (auto& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);
  const std::string out = (dir / "stdout").string();
  int terminal = -1;
  const pid_t pid = forkpty(&terminal, nullptr, nullptr, nullptr);
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (chdir(dir.path().c_str()) != 0 || freopen(out.c_str(), "w", stdout) == nullptr) _exit(126);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  Interrupted result;
  std::array<char, 4096> block{};
  for (ssize_t n = 0; (n = read(terminal, block.data(), block.size())) > 0;) {
    result.shown.append(block.data(), static_cast<std::size_t>(n));
    if (result.signalled || !says(result.shown, task, done)) continue;
    kill(pid, SIGINT);
    result.signalled = true;
  }
  int status = 0;
  waitpid(pid, &status, 0);
  close(terminal);
  result.status = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.out = read_file(out);
  return result;
}

class CalibrateInterrupt : public Calibrate {
 protected:
  void expect_best_so_far(const std::string& task, double done, std::vector<std::string> words,
                          const std::string& parameter) {
    words.insert(words.begin(), "calibrate");
    words.insert(words.end(), {"-o", "best.yaml", "--report", "report"});
    const Interrupted r = interrupt_at(task, done, words, dir);
    ASSERT_TRUE(r.signalled) << r.shown << r.out;
    EXPECT_EQ(r.status, 1) << r.shown << r.out;
    EXPECT_THAT(r.out, HasSubstr("INTERRUPTED"));
    EXPECT_THAT(r.out, HasSubstr(parameter));
    EXPECT_THAT(read_file(dir / "best.yaml"), HasSubstr("interrupted: true"));
    EXPECT_THAT(read_file(dir / "report/index.html"), HasSubstr("INTERRUPTED"));
    const auto result = nlohmann::json::parse(read_file(dir / "report/result.json"));
    EXPECT_TRUE(result["interrupted"].get<bool>());
  }
};

TEST_F(CalibrateInterrupt, CameraKeepsTheBoardsItHasSeen) {
  expect_best_so_far(
      "look for boards", 12,
      {"camera", CalibrationRecordings::get().board(), "--channel", "left/real", "--target", kBoard},
      "fx_px");
}

TEST_F(CalibrateInterrupt, TwinKeepsTheSamplesItHasCompared) {
  expect_best_so_far("compare", 12, {"twin", CalibrationRecordings::get().board(), "--channel", "left"},
                     "bias_dn");
}

TEST_F(CalibrateInterrupt, ExtrinsicsKeepTheBoardsTheyHaveSeen) {
  expect_best_so_far(
      "look for boards", 12,
      {"extrinsics", CalibrationRecordings::get().board(), "--camera", "left/real", "--camera-model",
       sensor("demo-camera"), "--second", "top", "--target", kBoard, "--rough", "0.2,0.22,0.02,0,-8,5"},
      "x_m");
}

TEST_F(CalibrateInterrupt, NothingIsRewrittenWhereNoTerminalIs) {
  const Said said = run({"twin", CalibrationRecordings::get().board(), "--channel", "left"});
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.err + said.out, Not(HasSubstr("\r")));
  EXPECT_THAT(said.err + said.out, Not(HasSubstr("\033")));
  const Said quiet = run({"twin", CalibrationRecordings::get().board(), "--channel", "left", "--json"});
  EXPECT_THAT(quiet.err, ::testing::IsEmpty());
}

}  // namespace
}  // namespace rigor::test

// What commands write: never onto what they read, nothing lost that was there, nothing half written, and one
// sentence where the disk or stdout takes no more.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <unistd.h>

#include <algorithm>
#include <sstream>
#include <thread>

#include "sensor-hal/record/mcap_reader.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace fs = std::filesystem;

constexpr const char* kRig = R"(name: small
clock: virtual
duration_s: 0.2
loop: { rate_hz: 100 }
channels:
  table:
    kind: registers
    backend: modbus
    emulated_by: table
    rate_hz: 50
    latency_ms: 10
    address: 127.0.0.1
    port: 15098
    registers: [{ name: position, table: input_registers, address: 0, type: s32, scale: 0.001, unit: deg }]
emulators:
  table: { backend: modbus, model: turntable }
)";
constexpr const char* kReplaying = R"(name: replaying
clock: virtual
duration_s: 0.1
loop: { rate_hz: 100 }
channels:
  table: { kind: registers, backend: replay, file: run.mcap, rate_hz: 50, latency_ms: 10 }
)";

class Outputs : public ::testing::Test {
 protected:
  void SetUp() override { write_file(dir / "rig.yaml", kRig); }
  [[nodiscard]] Said in_dir(std::vector<std::string> words) const {
    return rigor(std::move(words), dir.path());
  }
  /// By a shell, for redirections; `$R` is the command.
  [[nodiscard]] Said shell(const std::string& line) const {
    return Command({"bash", "-c", "R=" RIGOR_BINARY "; " + line}, dir.path()).wait();
  }
  void record(const std::string& name = "run.mcap") const {
    const Said said = in_dir({"run", "rig.yaml", "--record", name});
    ASSERT_EQ(said.status, 0) << said.err;
  }
  [[nodiscard]] bool is_whole(const std::string& name) const {
    const auto reader = record::McapReader::open((dir / name).string());
    return reader && (*reader)->health().good() && (*reader)->health().indexed;
  }
  [[nodiscard]] std::vector<std::string> names(const fs::path& below = {}) const {
    std::vector<std::string> all;
    for (const auto& entry : fs::directory_iterator(dir.path() / below))
      all.push_back(entry.path().filename().string());
    std::sort(all.begin(), all.end());
    return all;
  }
  /// Refused with both names, and every file as it was.
  void expect_refused(const std::vector<std::string>& words, const std::vector<std::string>& parts) const {
    std::vector<std::string> before;
    for (const auto& n : names()) before.push_back(n + read_file(dir / n));
    const Said said = in_dir(words);
    EXPECT_EQ(said.status, 2) << words[0] << ": " << said.err;
    for (const auto& part : parts) EXPECT_THAT(said.err, HasSubstr(part));
    std::vector<std::string> after;
    for (const auto& n : names()) after.push_back(n + read_file(dir / n));
    EXPECT_EQ(before, after) << words[0] << " touched something";
  }
  TempDir dir;
};

TEST_F(Outputs, NoCommandWritesOntoWhatItReads) {
  record();
  fs::create_symlink("run.mcap", dir / "link.mcap");
  fs::create_hard_link(dir / "run.mcap", dir / "hard.mcap");
  fs::create_symlink("rig.yaml", dir / "rig-link.mcap");
  write_file(dir / "replaying.yaml", kReplaying);
  for (const char* force : {"", "--force"}) {
    const auto refused = [&](std::vector<std::string> words, const std::vector<std::string>& parts) {
      if (*force) words.emplace_back(force);
      expect_refused(words, parts);
    };
    for (const char* name : {"run.mcap", "link.mcap", "hard.mcap", "./run.mcap"})
      refused({"replay", "run.mcap", "--record", name}, {name, "run.mcap", "--record"});
    refused({"replay", "link.mcap", "--record", "run.mcap"}, {"run.mcap", "link.mcap"});
    refused({"run", "replaying.yaml", "--record", "run.mcap"}, {"run.mcap", "channel `table`"});
    refused({"run", "rig.yaml", "--faults-from", "run.mcap", "--record", "hard.mcap"},
            {"hard.mcap", "--faults-from"});
    refused({"run", "rig.yaml", "--record", "rig.yaml"}, {"rig.yaml", "the rig"});
    refused({"run", "rig.yaml", "--record", "rig-link.mcap"}, {"rig-link.mcap", "the rig"});
    refused({"run", "rig.yaml", "--trace", "rig.yaml"}, {"rig.yaml", "--trace"});
    refused({"run", "rig.yaml", "--record", "new.mcap", "--trace", "new.mcap"}, {"new.mcap", "--trace"});
    refused({"inspect", "run.mcap", "--repair", "-o", "run.mcap"}, {"run.mcap", "-o"});
    refused({"inspect", "run.mcap", "--repair", "-o", "link.mcap"}, {"link.mcap", "run.mcap"});
    refused({"world", "export", config("worlds/turntable.yaml"), "-o", config("worlds/turntable.yaml")},
            {"turntable.yaml"});
    refused({"sense", config("demo.yaml"), "--channel", "right", "-o", "x.png", "--truth", "x.png"},
            {"--truth"});
  }
}

TEST_F(Outputs, RunsKeepWhatWasThereUnderANumber) {
  write_file(dir / "run.mcap", "precious");
  for (const char* kept : {"run.1.mcap", "run.2.mcap"}) {
    const Said said =
        in_dir({"run", "rig.yaml", "--record", "run.mcap", "--report", "report", "--trace", "t.json"});
    ASSERT_EQ(said.status, 0) << said.err;
    EXPECT_THAT(said.err, HasSubstr(kept));
    EXPECT_TRUE(is_whole("run.mcap"));
  }
  EXPECT_EQ(read_file(dir / "run.1.mcap"), "precious");
  EXPECT_TRUE(is_whole("run.2.mcap"));
  EXPECT_EQ(names(), (std::vector<std::string>{"report", "rig.yaml", "run.1.mcap", "run.2.mcap", "run.mcap",
                                               "t.1.json", "t.json"}));
  EXPECT_EQ(names("report"), (std::vector<std::string>{"1", "index.html", "result.json"}));
  EXPECT_EQ(names("report/1"), (std::vector<std::string>{"index.html", "result.json"}));
  const Said forced = in_dir(
      {"run", "rig.yaml", "--record", "run.mcap", "--report", "report", "--trace", "t.json", "--force"});
  EXPECT_EQ(forced.status, 0) << forced.err;
  EXPECT_EQ(names().size(), 7u) << "nothing new";
  EXPECT_EQ(names("report").size(), 3u);
  for (int i = 0; i < 2; ++i) ASSERT_EQ(in_dir({"replay", "run.mcap", "--record", "again.mcap"}).status, 0);
  EXPECT_TRUE(is_whole("again.mcap"));
  EXPECT_FALSE(fs::exists(dir / "again.2.mcap"));
  EXPECT_TRUE(is_whole("again.1.mcap"));
}

TEST_F(Outputs, WhatAnApplicationWritesKeepsWhatWasThere) {
  fs::create_directory(dir / "out");
  for (const char* name : {"result.json", "view-000.png", "mine.txt"})
    write_file(dir / "out" / name, "precious");
  // Too short for a picture: the application writes its result all the same.
  const std::vector<std::string> run{
      "run",   config("rigs/stereo.yaml"),    "--duration", "0.05",
      "--set", "application.output=out",      "--set",      "channels.left.renderer=rays",
      "--set", "channels.right.renderer=rays"};
  const Said said = in_dir(run);
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.err, HasSubstr("out/1/result.json"));
  EXPECT_EQ(names("out"), (std::vector<std::string>{"1", "mine.txt", "result.json"}));
  EXPECT_EQ(names("out/1"), (std::vector<std::string>{"result.json", "view-000.png"}));
  EXPECT_EQ(read_file(dir / "out/1/result.json"), "precious");
  EXPECT_EQ(read_file(dir / "out/mine.txt"), "precious");
  auto forced = run;
  forced.emplace_back("--force");
  EXPECT_EQ(in_dir(forced).status, 0);
  EXPECT_FALSE(fs::exists(dir / "out/2"));
}

TEST_F(Outputs, ToolsRefuseWhatIsThereUnlessForced) {
  record();
  for (const auto& words : std::vector<std::vector<std::string>>{
           {"inspect", "run.mcap", "--repair", "-o", "x.mcap"},
           {"world", "export", config("worlds/turntable.yaml"), "-o", "x.yaml"},
           {"sense", config("demo.yaml"), "--channel", "right", "-o", "x.png"},
           {"world", "render", config("worlds/turntable.yaml"), "--renderer", "rays", "--width", "32",
            "--height", "32", "-o", "y.png"}}) {
    write_file(dir / words.back(), "precious");
    const Said refused = in_dir(words);
    EXPECT_EQ(refused.status, 2) << words[0];
    EXPECT_THAT(refused.err, AllOf(HasSubstr(words.back()), HasSubstr("--force")));
    EXPECT_EQ(read_file(dir / words.back()), "precious");
    auto forced = words;
    forced.emplace_back("--force");
    const Said said = in_dir(forced);
    EXPECT_EQ(said.status, 0) << words[0] << said.err;
    EXPECT_NE(read_file(dir / words.back()), "precious");
  }
}

TEST_F(Outputs, FoldersAreMadeAndLinksAreFollowed) {
  EXPECT_EQ(in_dir({"run", "rig.yaml", "--record", "a/b/run.mcap", "--report", "c/d", "--trace", "e/t.json"})
                .status,
            0);
  EXPECT_TRUE(is_whole("a/b/run.mcap"));
  EXPECT_EQ(in_dir({"inspect", "a/b/run.mcap", "--repair", "-o", "f/g/whole.mcap"}).status, 0);
  EXPECT_TRUE(is_whole("f/g/whole.mcap"));
  EXPECT_EQ(in_dir({"sense", config("demo.yaml"), "--channel", "right", "-o", "h/i/x.png"}).status, 0);
  fs::create_symlink("elsewhere/run.mcap", dir / "link.mcap");
  EXPECT_EQ(in_dir({"run", "rig.yaml", "--record", "link.mcap"}).status, 0);
  EXPECT_TRUE(fs::is_symlink(dir / "link.mcap"));
  EXPECT_TRUE(is_whole("elsewhere/run.mcap"));
  EXPECT_EQ(in_dir({"run", "rig.yaml", "--record", "/dev/null"}).status, 0);
  EXPECT_TRUE(fs::is_character_file("/dev/null"));
}

TEST_F(Outputs, ARunThatDoesNotComeToItsFirstCycleLeavesWhatWasThere) {
  record();
  const std::string before = read_file(dir / "run.mcap");
  // Nobody listens at the port.
  const Said said = in_dir({"run", "rig.yaml", "--clock", "wall", "--no-emulators", "--record", "run.mcap",
                            "--set", "channels.table.port=15097"});
  EXPECT_NE(said.status, 0);
  EXPECT_EQ(names(), (std::vector<std::string>{"rig.yaml", "run.mcap"}));
  EXPECT_EQ(read_file(dir / "run.mcap"), before);
}

TEST_F(Outputs, ARecordingThatAnotherRunWritesIsRefused) {
  Command first(rigor_words({"run", (dir / "rig.yaml").string(), "--duration", "30", "--live", "0", "--pace",
                             "1", "--record", (dir / "run.mcap").string()}));
  for (int t = 0; t < 60000 && first.running() && !fs::exists(dir / "run.mcap"); t += 10)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  ASSERT_TRUE(first.running()) << first.err();
  for (const char* force : {"--json", "--force"}) {
    const Said second = in_dir({"run", "rig.yaml", "--record", "run.mcap", force});
    EXPECT_EQ(second.status, 2);
    EXPECT_THAT(second.err, AllOf(HasSubstr("run.mcap"), HasSubstr("another run")));
  }
  first.signal(SIGINT);
  EXPECT_EQ(first.wait().status, 0);
  EXPECT_TRUE(is_whole("run.mcap"));
  EXPECT_EQ(names(), (std::vector<std::string>{"rig.yaml", "run.mcap"}));
}

TEST_F(Outputs, RunsThatBeginAtOnceWithOneNameDoNotDamageEachOther) {
  std::vector<std::unique_ptr<Command>> runs;
  for (int i = 0; i < 6; ++i)
    runs.push_back(std::make_unique<Command>(
        rigor_words({"run", (dir / "rig.yaml").string(), "--record", (dir / "run.mcap").string()})));
  int good = 0;
  for (auto& run : runs) {
    const Said said = run->wait();
    EXPECT_TRUE(said.status == 0 || said.status == 2) << said.err;
    good += said.status == 0;
  }
  ASSERT_GE(good, 1);
  int whole = 0;
  for (const auto& name : names())
    if (name.ends_with(".mcap")) {
      ++whole;
      EXPECT_TRUE(is_whole(name)) << name;
    }
  EXPECT_EQ(whole, good) << "each run that was good has its recording";
}

// ---- no room ----

class FullDisk : public Outputs {
 protected:
  void SetUp() override {
    Outputs::SetUp();
    fs::create_directory(dir / "disk");
    if (mount("tmpfs", (dir / "disk").c_str(), "tmpfs", 0, "size=64k") != 0)
      GTEST_SKIP() << "a small disk cannot be mounted here (needs root)";
    mounted_ = true;
    // All but a few blocks, so that files can be made and not filled.
    write_file(dir / "disk/filling", std::string(56 << 10, 'x'));
  }
  void TearDown() override {
    if (mounted_) umount((dir / "disk").c_str());
  }
  bool mounted_ = false;
};

TEST_F(FullDisk, IsOneSentenceAndStatusOneInEveryCommand) {
  write_file(dir / "big.yaml", std::string(kRig) + "\n");
  record();
  for (const auto& words : std::vector<std::vector<std::string>>{
           {"run", "rig.yaml", "--duration", "20", "--record", "disk/run.mcap"},
           {"run", "rig.yaml", "--report", "disk/report"},
           {"run", "rig.yaml", "--trace", "disk/t.json"},
           {"replay", "run.mcap", "--report", "disk/report"},
           {"sense", config("demo.yaml"), "--channel", "right", "-o", "disk/x.png"},
           {"sense", config("demo.yaml"), "--channel", "right", "-o", "disk/x.exr"},
           {"world", "render", config("worlds/turntable.yaml"), "--renderer", "rays", "-o", "disk/x.png"},
           {"world", "render", config("worlds/turntable.yaml"), "--renderer", "rays", "-o", "disk/x.exr"},
           {"world", "import", config("worlds/hills.import.yaml"), "--set", "half_extent_m=60", "-o",
            "disk/w.rigor"}}) {
    const Said said = in_dir(words);
    const std::string what = words[0] + " " + words[1] + " " + words.back();
    EXPECT_EQ(said.status, 1) << what << ": " << said.err;
    EXPECT_THAT(said.err, HasSubstr("space")) << what;
    EXPECT_THAT(said.err + said.out,
                AllOf(Not(HasSubstr("libpng")), Not(HasSubstr("a step failed")), Not(HasSubstr("defect"))))
        << what;
    std::string sentences;
    std::istringstream lines(said.err);
    for (std::string line; std::getline(lines, line);)
      if (line.find("space") != std::string::npos) sentences += line + "\n";
    EXPECT_EQ(std::count(sentences.begin(), sentences.end(), '\n'), 1) << what << ":\n" << said.err;
    for (const auto& name : names("disk")) EXPECT_THAT(name, Not(HasSubstr("part"))) << what;
    if (fs::exists(dir / "disk/run.mcap")) fs::remove(dir / "disk/run.mcap");
  }
}

TEST_F(Outputs, StdoutThatTakesNothingIsOneSentenceAndStatusOne) {
  record();
  for (const char* words :
       {"inspect run.mcap", "inspect run.mcap --json", "run rig.yaml", "run rig.yaml --json",
        "replay run.mcap", "doctor", "devices", "--help", "--version"})
    for (const char* to : {">/dev/full", ">&-", "> >(exec 0<&-; sleep 1)"}) {
      const Said said = shell(std::string("sleep 0; $R ") + words + " " + to);
      const std::string what = std::string(words) + " " + to;
      if (to[1] != ' ') {  // who is quicker, the reader's end or what is printed, is open in that case
        EXPECT_EQ(said.status, 1) << what << ": " << said.err;
        EXPECT_THAT(said.err, HasSubstr("standard output")) << what;
      }
      EXPECT_THAT(said.err, Not(HasSubstr("defect"))) << what;
      EXPECT_LT(said.status, 2) << what;
    }
}

// With stdout closed, the first file that is opened would get its number, and what is printed.
TEST_F(Outputs, NothingPrintedGetsIntoAFileWhereStdoutIsClosed) {
  const Said said = shell("$R run rig.yaml --record run.mcap >&- 2>&- 0<&-");
  EXPECT_EQ(said.status, 1);
  EXPECT_TRUE(is_whole("run.mcap"));
}

}  // namespace
}  // namespace rigor::test

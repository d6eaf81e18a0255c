// An application as a process, called by a loop of the test's own: every sample accounted for, whatever
// becomes of it.
#include "bench/application/process_application.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <thread>

#include "rt-core/heartbeat.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;

/// Keeps what it was told.
class Told final : public Sink {
 public:
  Told() { description_.names = {"n"}; }
  bool command(const Command& c) noexcept override {
    if (commands.size() < commands.capacity()) commands.push_back(c);
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}
  std::vector<Command> commands;

 private:
  Status do_configure(const ChannelConfig&) override { return {}; }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }
};

class ProcessApplication : public ::testing::Test {
 protected:
  void SetUp() override {
    dir_ = fs::temp_directory_path() / ("rigor_application_" + std::to_string(getpid()));
    fs::create_directories(dir_);
    setenv("PYTHONPATH", RIGOR_CLIENTS, 1);
    told_.commands.reserve(100'000);
    values_.kind = SampleKind::register_block;
    values_.names = {"v"};
    picture_.kind = SampleKind::image;
  }
  void TearDown() override {
    std::error_code ec;
    fs::remove_all(dir_, ec);
  }
  /// Counts all that it sees, looks into each picture, and does `more` in each turn.
  void make(const std::string& clock, const std::string& keys, const std::string& more = "") {
    std::ofstream(dir_ / "app.py")
        << "import os, rigor_client, signal, time\n"
           "class App(rigor_client.Application):\n"
           "    n = turns = 0\n"
           "    def step(self, turn):\n"
           "        self.turns += 1\n"
        << more
        << "        for s in turn['values'].samples:\n"
           "            assert s.values['v'] == s.sequence, (s, s.values)\n"
           "            self.n += 1\n"
           "        for s in turn['picture'].samples:\n"
           "            assert bytes(s.bytes) == bytes([s.sequence % 256]) * 4000, s\n"
           "            self.n += 1\n"
           "        turn.command('told', n=self.n)\n"
           "rigor_client.run(App())\n";
    const std::string text = "clock: " + clock +
                             "\nloop: { rate_hz: 1000 }\nduration_s: 1\napplication: { command: [python3, " +
                             (dir_ / "app.py").string() + "], " + keys + " }\n";
    auto root = ConfigDocument::parse(text, "rig.yaml");
    ASSERT_TRUE(root) << root.error().text();
    auto rig = parse_rig(*root, "rig.yaml");
    ASSERT_TRUE(rig) << rig.error().text();
    rig_ = std::move(*rig);
    auto application = make_process_application(rig_);
    ASSERT_TRUE(application) << application.error().text();
    application_ = std::move(*application);
    pool_ = make_sample_pool(40, 4000);
    ApplicationPorts ports;
    ports.inputs["values"] = {"values", &values_, &value_port_};
    ports.inputs["picture"] = {"picture", &picture_, &picture_port_};
    ports.outputs["told"] = &out_;
    const Status s = application_->configure(rig_.application_params, ports, rig_.loop.period);
    ASSERT_TRUE(s) << s.error().text();
  }
  void push(SamplePort& port, decltype(Sample::info) info, std::uint64_t sequence, BenchTime t) {
    auto slot = pool_->try_acquire();
    if (!slot) {
      ++no_slot_;
      return;
    }
    Sample& s = *slot;
    s.stamp = {};
    s.stamp.sequence = sequence;
    s.stamp.t_capture = s.stamp.t_release = s.stamp.t_arrival = t;
    s.info = std::move(info);
    if (s.kind() == SampleKind::image) {
      s.size_bytes = 4000;
      std::fill_n(s.memory().data(), 4000, static_cast<std::byte>(sequence));
    }
    port.push(std::move(slot));
    ++pushed_;
  }
  /// A value in each cycle, a picture in every fifth.
  void cycle(std::uint64_t k) {
    const BenchTime t(static_cast<std::int64_t>(k) * 1'000'000);
    RegisterBlock block;
    block.count = 1;
    block.value[0] = static_cast<double>(k);
    push(value_port_, block, k, t);
    if (k % 5 == 0) push(picture_port_, ImageInfo{}, k / 5, t);
    value_port_.advance(t, true);
    picture_port_.advance(t, true);
    application_->step(k, t);
  }
  void expect_all_accounted_for() const {
    const ApplicationFacts f = *application_->facts();
    EXPECT_EQ(f.delivered + f.superseded + f.dropped + f.after_last, pushed_);
    EXPECT_EQ(no_slot_, 0U) << "it holds more samples than a few";
  }

  fs::path dir_;
  RigConfig rig_;
  Told told_;
  CommandPort out_{"told", told_, Duration(0)};
  ChannelDescription values_, picture_;
  std::unique_ptr<SamplePool> pool_;
  SamplePort value_port_, picture_port_;
  std::unique_ptr<Application> application_;
  std::uint64_t pushed_ = 0, no_slot_ = 0;
};

TEST_F(ProcessApplication, InVirtualTimeSeesEachValueAndTheNewestPictureOfATurn) {
  make("virtual", "rate_hz: 50");
  for (std::uint64_t k = 0; k < 1000; ++k) cycle(k);
  ASSERT_TRUE(application_->finish());
  expect_all_accounted_for();
  const ApplicationFacts f = *application_->facts();
  EXPECT_EQ(f.turns, 50U);
  EXPECT_EQ(f.answered, 50U);
  EXPECT_EQ(f.superseded, 49U * 3 + 2) << "two of them after the last turn";
  EXPECT_EQ(f.after_last, 19U + 1);
  EXPECT_EQ(f.dropped, 0U);
  ASSERT_EQ(told_.commands.size(), 50U);
  EXPECT_EQ(told_.commands[0].value[0], 2) << "the first value and the first picture";
  EXPECT_EQ(told_.commands[1].value[0], 2 + 21);
  EXPECT_EQ(told_.commands[49].t_issue, BenchTime(980'000'000));
}

TEST_F(ProcessApplication, InVirtualTimeShowsMoreThanASocketHoldsAtOnce) {
  make("virtual", "rate_hz: 0.02");
  for (std::uint64_t k = 0; k <= 50'000; ++k) cycle(k);
  ASSERT_TRUE(application_->finish());
  expect_all_accounted_for();
  EXPECT_EQ(application_->facts()->turns, 2U);
  EXPECT_EQ(told_.commands[1].value[0], 2 + 50'001);
}

TEST_F(ProcessApplication, InWallClockTimeIsBroughtBackAndEverySampleIsAccountedFor) {
  make("wall", "rate_hz: 100, on_exit: restart, answer_timeout_s: 0.3",
       "        marks = len([f for f in os.listdir('" +
           (fs::temp_directory_path() / ("rigor_application_" + std::to_string(getpid()))).string() +
           "') if f.startswith('mark')])\n"
           "        if self.turns == 20 and marks < 3:\n"
           "            open('" +
           (fs::temp_directory_path() / ("rigor_application_" + std::to_string(getpid()))).string() +
           "/mark' + str(marks), 'w').close()\n"
           "            if marks == 0: os.kill(os.getpid(), signal.SIGKILL)\n"
           "            if marks == 1: time.sleep(60)\n"
           "            if marks == 2: raise ValueError('no more')\n");
  std::uint64_t k = 0;
  const MonotonicTime until = monotonic_now() + seconds(30);
  for (; monotonic_now() < until && (application_->facts()->restarts < 3 || k % 1000 != 0); ++k) {
    cycle(k);
    EXPECT_FALSE(application_->failed());
    std::this_thread::sleep_for(
        std::chrono::milliseconds(1));  // the period of the loop that the test stands for
  }
  const Status s = application_->finish();
  EXPECT_TRUE(s) << s.error().text();
  expect_all_accounted_for();
  const ApplicationFacts f = *application_->facts();
  EXPECT_EQ(f.restarts, 3U);
  EXPECT_EQ(f.turns + f.skipped, (k + 9) / 10);
  EXPECT_GE(f.turns, f.answered + 3);
}

TEST_F(ProcessApplication, InWallClockTimeThatDiesAndIsNotWantedBackFails) {
  make("wall", "rate_hz: 100", "        if self.turns == 5: os._exit(3)\n");
  for (std::uint64_t k = 0; k < 30'000 && !application_->failed(); ++k) {
    cycle(k);
    std::this_thread::sleep_for(
        std::chrono::milliseconds(1));  // the period of the loop that the test stands for
  }
  ASSERT_TRUE(application_->failed());
  const Status s = application_->finish();
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("exit status 3"), std::string::npos) << s.error().text();
  expect_all_accounted_for();
}

}  // namespace
}  // namespace rigor

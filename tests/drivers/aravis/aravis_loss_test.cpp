// What happens to the Aravis source when packets get lost, and when cameras die and come back.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <thread>

#include "drivers/aravis/aravis_source.h"
#include "tests/drivers/aravis/aravis_test_tools.h"
#include "tests/drivers/aravis/camera_process.h"
#include "tests/paths.h"

namespace rigor {
namespace {

using gige::testing::LossRelay;
using testing::CameraProcess;
using testing::make_config;
using testing::run_for;

const std::string kProgram = rigor::test::build_dir() + "/tests/stamped_camera";
constexpr const char* kAddress = "127.0.0.55";

/// Polls until the channel says so, at most `timeout`.
bool wait_connected(const AravisSource& s, bool wanted, Duration timeout) {
  const BenchTime end = testing::now() + timeout;
  while (testing::now() < end) {
    if (s.health().connected == wanted) return true;
    usleep(2000);
  }
  return false;
}

/// How often this thread has given up the CPU of its own accord.
long times_waited() {
  rusage u{};
  getrusage(RUSAGE_THREAD, &u);
  return u.ru_nvcsw;
}

TEST(AravisLoss, ACameraThatIsKilledIsLostSoonAndComesBackWithItsSettings) {
  auto process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "640", "480");
  AravisSource source;
  ASSERT_TRUE(
      source.configure(make_config("{device: Rigor-KILL55, exposure_us: 3000, region: {x_px: 8, y_px: 8, "
                                   "width_px: 320, height_px: 240}}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(testing::now()));
  std::uint64_t last_sequence = 0;
  BenchTime last_capture;
  for (int round = 0; round < 2; ++round) {
    auto seen = run_for(source, milliseconds(1200));
    ASSERT_GE(seen.size(), 20U) << round;
    if (round > 0) {
      // The sequence went on by the time that went by.
      const auto& first = seen.front().stamp;
      EXPECT_GT(first.sequence, last_sequence + 10);
      const double periods = (first.t_capture - last_capture).seconds() / 0.04;
      EXPECT_NEAR(static_cast<double>(first.sequence - last_sequence), periods, 1.0);
      EXPECT_EQ(first.lost_before, first.sequence - last_sequence - 1);
    }
    for (const auto& s : seen) {
      EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0U);
      EXPECT_EQ(s.image.exposure, microseconds(3000));
      EXPECT_EQ(s.image.width_px, 320U);
    }
    last_sequence = seen.back().stamp.sequence;
    last_capture = seen.back().stamp.t_capture;
    const BenchTime killed = testing::now();
    process->kill_now();
    ASSERT_TRUE(wait_connected(source, false, seconds(20)));
    std::printf("lost after %.0f ms", (testing::now() - killed).seconds() * 1e3);
    while (auto lease = source.poll(testing::now())) {
      last_sequence = lease->stamp.sequence;
      last_capture = lease->stamp.t_capture;
    }
    usleep(300'000);
    const BenchTime restarted = testing::now();
    process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "640", "480");
    ASSERT_TRUE(wait_connected(source, true, seconds(30)));
    std::printf(", back %.0f ms after its restart\n", (testing::now() - restarted).seconds() * 1e3);
  }
  EXPECT_GE(run_for(source, seconds(1)).size(), 3U);
  EXPECT_EQ(source.health().reconnects, 2U);
  ASSERT_TRUE(source.stop());
}

TEST(AravisLoss, ACameraThatRestartsWithinAPeriodOrTwoIsTakenUpAgain) {
  auto process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "320", "240");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.55}")));
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(testing::now()));
  EXPECT_GE(run_for(source, milliseconds(500)).size(), 2U);
  process->kill_now();
  process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "320",
                                            "240");  // answers, but is not ours
  const BenchTime end = testing::now() + seconds(30);
  while (source.health().reconnects == 0 && testing::now() < end) usleep(5000);
  EXPECT_EQ(source.health().reconnects, 1U);
  EXPECT_GE(run_for(source, milliseconds(700)).size(), 2U);
  ASSERT_TRUE(source.stop());
}

TEST(AravisLoss, StopReturnsWhereTheCameraIsDead) {
  for (const Duration wait : {milliseconds(0), milliseconds(30), milliseconds(1500)}) {
    auto process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "320", "240");
    AravisSource source;
    ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.55}")));
    ASSERT_TRUE(source.arm({}));
    ASSERT_TRUE(source.start(testing::now()));
    EXPECT_GE(run_for(source, milliseconds(300)).size(), 1U);
    process->kill_now();
    usleep(static_cast<useconds_t>(wait.ns() / 1000));
    const BenchTime before = testing::now();
    ASSERT_TRUE(source.stop()) << "killed " << wait.seconds() << " s before";
    std::printf("stop took %.0f ms, %.0f ms after the camera's death\n",
                (testing::now() - before).seconds() * 1e3, wait.seconds() * 1e3);
  }
}

TEST(AravisLoss, TheLoopIsNeverHeldWhileTheCameraIsGone) {
  auto process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "320", "240");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.55, trigger: software}")));
  ASSERT_TRUE(source.arm({}));
  ASSERT_TRUE(source.start(testing::now()));
  EXPECT_GE(run_for(source, milliseconds(600)).size(), 2U);
  process->kill_now();
  // A call that waits, for the camera or for a lock, gives up the CPU of its own accord, which the kernel
  // counts apart from a busy machine that takes it away. The camera is looked for several times in this
  // while.
  long waits = 0;
  const BenchTime end = testing::now() + seconds(4);
  while (testing::now() < end) {
    const BenchTime t = testing::now();
    const long before = times_waited();
    source.begin_cycle(t);
    (void)source.poll(t);
    waits += times_waited() - before;
    usleep(1000);
  }
  EXPECT_EQ(waits, 0);
  EXPECT_FALSE(source.health().connected);
  process = std::make_unique<CameraProcess>(kProgram, kAddress, "KILL55", "320", "240");
  ASSERT_TRUE(wait_connected(source, true, seconds(30)));
  EXPECT_GE(run_for(source, seconds(1)).size(), 3U);
  ASSERT_TRUE(source.stop());
}

struct LossFigures {
  std::size_t whole = 0, marked = 0, torn = 0, unmarked_zero = 0;
  std::uint64_t relay_lost = 0, relay_passed = 0;
};

/// 640x480 Mono8 in packets of 1400 bytes (some 225 a frame) through a relay that loses `loss` of them.
LossFigures run_lossy(double loss, const std::string& more_keys, Duration d, AravisSource& source) {
  LossFigures f;
  auto camera = testing::start_camera("127.0.0.57", "LOSS57");
  LossRelay relay({*gige::parse_ipv4("127.0.0.58"), gige::kGvcpPort},
                  {*gige::parse_ipv4("127.0.0.57"), gige::kGvcpPort}, loss, 4711);
  EXPECT_TRUE(source.configure(make_config("{address: 127.0.0.58, packet_size: 1400" + more_keys + "}")));
  const auto armed = source.arm({});
  EXPECT_TRUE(armed) << armed.error().text();
  if (!armed) return f;
  EXPECT_TRUE(source.start(testing::now()));
  for (const auto& s : run_for(source, d)) {
    const bool marked = (s.stamp.validity & kIncomplete) != 0;
    (marked ? f.marked : f.whole) += 1;
    f.torn += s.verdict.wrong != 0;
    f.unmarked_zero += !marked && s.verdict.zero != 0;
  }
  f.relay_lost = relay.lost();
  f.relay_passed = relay.passed();
  EXPECT_TRUE(source.stop());
  return f;
}

TEST(AravisLoss, TwoPercentOfPacketsLostCostLessThanOnePercentOfFrames) {
  AravisSource source;
  const LossFigures f = run_lossy(0.02, "", seconds(10), source);
  std::printf("%zu whole, %zu marked, %zu torn, lost %llu; relay lost %llu of %llu packets; %llu resent\n",
              f.whole, f.marked, f.torn, static_cast<unsigned long long>(source.health().lost),
              static_cast<unsigned long long>(f.relay_lost),
              static_cast<unsigned long long>(f.relay_lost + f.relay_passed),
              static_cast<unsigned long long>(source.counters().resent_packets));
  EXPECT_GE(f.relay_lost, 500U);
  EXPECT_EQ(f.torn, 0U);
  EXPECT_EQ(f.unmarked_zero, 0U);
  const double sent = static_cast<double>(f.whole + f.marked + source.health().lost);
  EXPECT_GE(static_cast<double>(f.whole), 0.99 * sent);
  EXPECT_GE(sent, 235);
}

TEST(AravisLoss, WithoutResendWhatIsNotWholeIsMarkedAndReadsZero) {
  AravisSource source;
  const LossFigures f = run_lossy(0.005, ", resend: false, frame_retention_ms: 50", seconds(5), source);
  EXPECT_GE(f.marked, 30U) << "of some 125 frames, two thirds miss a packet";
  EXPECT_GE(f.whole, 10U);
  EXPECT_EQ(f.torn, 0U);
  EXPECT_EQ(f.unmarked_zero, 0U);
  EXPECT_EQ(source.health().incomplete, f.marked);
}

TEST(AravisLoss, IncompleteFramesCanBeDropped) {
  AravisSource source;
  const LossFigures f =
      run_lossy(0.005, ", resend: false, frame_retention_ms: 50, incomplete: drop", seconds(5), source);
  EXPECT_EQ(f.marked, 0U);
  EXPECT_GE(f.whole, 10U);
  EXPECT_GE(source.health().lost, 30U);
  EXPECT_EQ(f.unmarked_zero + f.torn, 0U);
}

}  // namespace
}  // namespace rigor

// The source through Aravis with a camera whose line is pulsed, which sends chunks and follows a PTP master.
#include <gmock/gmock.h>

#include <thread>

#include "drivers/aravis/aravis_source.h"
#include "tests/drivers/aravis/aravis_test_tools.h"

namespace rigor {
namespace {

using testing::collect;
using ::testing::HasSubstr;
using testing::make_config;
using testing::now;
using testing::Seen;
using testing::start_camera;

/// Polls until `enough`; false where that was not within a minute.
template <class F>
bool poll_until(Source& source, std::vector<Seen>& seen, F&& enough) {
  for (const BenchTime end = now() + seconds(60); now() < end; usleep(900)) {
    collect(source, seen);
    if (enough()) return true;
  }
  return false;
}

TEST(AravisTrigger, EachPulseOnTheLineIsASample) {
  auto camera = start_camera("127.0.0.81", "LINE81");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config(
      "{address: 127.0.0.81, exposure_us: 2000, trigger: hardware, trigger_delay_us: 500, chunks: on}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(now()));
  std::vector<Seen> seen;
  for (std::size_t i = 0; i < 10; ++i) {
    const BenchTime before = now();
    camera->pulse_line();
    const BenchTime after = now();
    ASSERT_TRUE(poll_until(source, seen, [&] { return seen.size() == i + 1; })) << "pulse " << i;
    const Seen& s = seen.back();
    EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0u) << i;
    EXPECT_EQ(s.bytes, 640u * 480u) << "chunks are no part of the picture";
    // Delay and half of the exposure behind the edge, within what the clocks are known to.
    const Duration least = (s.stamp.t_capture - after) - microseconds(1500),
                   most = (s.stamp.t_capture - before) - microseconds(1500);
    const Duration slack = s.stamp.sigma_capture * 5 + microseconds(50);
    EXPECT_LT(least, slack);
    EXPECT_GT(most, -slack);
    EXPECT_EQ(s.stamp.lost_before, 0u);
    EXPECT_EQ(s.image.exposure, microseconds(2000));
  }
  EXPECT_EQ(camera->health().line_edges, 10u);
  EXPECT_EQ(camera->health().line_missed, 0u);
  EXPECT_TRUE(source.health().connected) << "a camera that is not triggered owes no frame";
  ASSERT_TRUE(source.stop());
}

TEST(AravisTrigger, RefusesALineThatTheCameraDoesNotHave) {
  auto camera = start_camera("127.0.0.82", "LINE82");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.82, trigger: hardware, trigger_line: Line7}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_THAT(
      s.error().text(),
      HasSubstr("trigger_line: expected a source that the camera offers (Software, Line1), got Line7"));
}

TEST(AravisTrigger, ChunksFollowTheCameraWhereTheRigDoesNot) {
  auto camera = start_camera("127.0.0.83", "CHUNK83");
  AravisSource source;
  ASSERT_TRUE(
      source.configure(make_config("{address: 127.0.0.83, exposure_us: 3000, gain_db: 2, chunks: on}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(now()));
  std::vector<Seen> seen;
  ASSERT_TRUE(poll_until(source, seen, [&] { return seen.size() >= 10; }));
  for (const Seen& s : seen) {
    if (s.stamp.validity != kValid) continue;
    EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0u);
    EXPECT_EQ(s.image.exposure, microseconds(3000));
    EXPECT_EQ(s.image.gain_db, 2);
  }
  EXPECT_EQ(source.health().protocol_errors, 0u);
  ASSERT_TRUE(source.stop());
}

TEST(AravisPtp, TheOffsetIsPartOfTheUncertaintyAndAClockWithoutAMasterIsWarnedOf) {
  gige::GigeCameraConfig config;
  config.ptp = {.present = true, .settle = milliseconds(1), .offset = milliseconds(3)};
  auto camera = start_camera("127.0.0.84", "PTP84", gige::testing::fill_stamped, config);
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.84, exposure_us: 2000, ptp: on}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(now()));
  std::vector<Seen> seen;
  EXPECT_TRUE(poll_until(source, seen, [&] {
    return !seen.empty() && seen.back().stamp.sigma_capture > microseconds(300);
  })) << "sigma does not know of the offset";
  EXPECT_THAT(source.warnings(), ::testing::IsEmpty()) << "a clock that follows its master is no trouble";
  ASSERT_TRUE(source.stop());

  config.ptp.settle = seconds(3600);
  auto lost = start_camera("127.0.0.86", "PTP86", gige::testing::fill_stamped, config);
  AravisSource unsettled;
  ASSERT_TRUE(unsettled.configure(make_config("{address: 127.0.0.86, exposure_us: 2000, ptp: on}")));
  ASSERT_TRUE(unsettled.arm({}));
  ASSERT_TRUE(unsettled.start(now()));
  EXPECT_TRUE(poll_until(unsettled, seen, [&] {
    const auto said = unsettled.warnings();
    return said.size() == 1 && said[0].find("is there a master (ptp4l) on its network?") != std::string::npos;
  }));
  ASSERT_TRUE(unsettled.stop());

  auto plain = start_camera("127.0.0.85", "PTP85");
  AravisSource without;
  ASSERT_TRUE(without.configure(make_config("{address: 127.0.0.85, ptp: on}")));
  EXPECT_THAT(without.arm({}).error().text(), HasSubstr("the camera has no PTP clock"));
}

}  // namespace
}  // namespace rigor

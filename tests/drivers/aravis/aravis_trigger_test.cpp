// The source through Aravis with a camera whose line is pulsed, which sends chunks and follows a PTP master.
#include <gmock/gmock.h>

#include <algorithm>
#include <iterator>
#include <mutex>
#include <set>
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
      HasSubstr(
          "trigger_line: expected a source that the camera offers (Software, Line1, Action0), got Line7"));
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

/// A camera that follows a master, and the instants at which its exposures began.
struct ActionCamera {
  ActionCamera(const std::string& address, const std::string& serial, Duration settle = milliseconds(200)) {
    gige::GigeCameraConfig config;
    config.sensor_width_px = 320, config.sensor_height_px = 240;
    config.ptp = {.present = true, .settle = settle, .offset = {}};
    const auto fill = [this](const gige::FrameRequest& r, gige::MutableBytes out) {
      const std::lock_guard lock(mutex);
      began.insert(r.t_exposure_start.ns());
      return gige::testing::fill_stamped(r, out);
    };
    emulator = start_camera(address, serial, fill, config);
    const auto s = source.configure(make_config("{address: " + address +
                                                ", exposure_us: 2000, trigger: action, "
                                                "action: {device_key: 4711, group_key: 86, group_mask: 6}}"));
    EXPECT_TRUE(s) << s.error().text();
  }
  std::mutex mutex;
  std::set<std::int64_t> began;
  std::unique_ptr<gige::GigeEmulator> emulator;
  AravisSource source;
};

TEST(AravisAction, CamerasOfAGroupExposeAtTheSameInstant) {
  ActionCamera a("127.0.0.86", "ACT86"), b("127.0.0.87", "ACT87");
  for (ActionCamera* c : {&a, &b}) {
    const auto armed = c->source.arm({});
    ASSERT_TRUE(armed) << armed.error().text();
  }
  const BenchTime t0 = now() + milliseconds(60);
  ASSERT_TRUE(a.source.start(t0));
  ASSERT_TRUE(b.source.start(t0));
  std::vector<Seen> seen_a, seen_b;
  ASSERT_TRUE(poll_until(a.source, seen_a, [&] {
    collect(b.source, seen_b);
    return seen_a.size() >= 30 && seen_b.size() >= 30;
  }));
  ASSERT_TRUE(a.source.stop());
  ASSERT_TRUE(b.source.stop());
  std::vector<std::int64_t> both;
  std::set_intersection(a.began.begin(), a.began.end(), b.began.begin(), b.began.end(),
                        std::back_inserter(both));
  EXPECT_GE(both.size(), 25u) << "exposures that began in the same nanosecond";
  for (const auto ns : both) {
    const Duration off((BenchTime(ns) - t0).ns() % milliseconds(40).ns());
    EXPECT_LT(std::min(off, milliseconds(40) - off), microseconds(500)) << "on the bench's grid";
  }
  for (const auto* seen : {&seen_a, &seen_b})
    for (const Seen& s : *seen) EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0u);
  for (ActionCamera* c : {&a, &b}) {
    const auto s = c->source.counters().actions;
    EXPECT_GE(s.in_time, s.sent * 8 / 10);
    EXPECT_EQ(s.refused, 0u) << s.refusal;
    EXPECT_GE(s.exposed, 25u);
    EXPECT_LT(s.jitter_mean, microseconds(1));
    std::printf("%s\n", s.text().c_str());
    EXPECT_EQ(c->source.warnings().empty(), s.good());
  }
}

TEST(AravisAction, ACameraThatFollowsNoMasterIsRefused) {
  ActionCamera never("127.0.0.88", "ACT88", seconds(1000));
  const auto s =
      never.source.configure(make_config("{address: 127.0.0.88, trigger: action, action: {settle_s: 0.2}}"));
  ASSERT_TRUE(s) << s.error().text();
  const auto armed = never.source.arm({});
  ASSERT_FALSE(armed);
  EXPECT_THAT(armed.error().text(), HasSubstr("expected a PTP clock that is Slave or Master, got Listening"));
  auto plain = start_camera("127.0.0.89", "ACT89");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.89, trigger: action}")));
  EXPECT_THAT(source.arm({}).error().text(), HasSubstr("camera has no PTP clock"));
}

TEST(AravisAction, KeysThatContradictEachOtherAreRefused) {
  const auto refused = [](const std::string& keys) {
    AravisSource source;
    Status s;
    const auto made = catch_config([&] { return s = source.configure(make_config(keys)), true; });
    return !made ? made.error().text() : s ? std::string() : s.error().text();
  };
  EXPECT_THAT(refused("{address: 127.0.0.1, trigger: action, ptp: off}"), HasSubstr("ptp: expected on"));
  EXPECT_THAT(refused("{address: 127.0.0.1, trigger: action, action: {group_mask: 0}}"),
              HasSubstr("group_mask"));
  EXPECT_THAT(refused("{address: 127.0.0.1, trigger: action, action: {key: 1}}"),
              HasSubstr("action.key: unknown key"));
  EXPECT_EQ(refused("{address: 127.0.0.1, trigger: action}"), "");
}

TEST(AravisTrigger, ACameraThatWasArmedLongBeforeItsFirstTriggerIsNotTakenForLost) {
  auto camera = start_camera("127.0.0.80", "WAIT80");
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.80, exposure_us: 2000, trigger: software}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  usleep(2'200'000);  // longer than a camera may be silent that owes a frame
  ASSERT_TRUE(source.start(now()));
  std::vector<Seen> seen;
  ASSERT_TRUE(poll_until(source, seen, [&] { return seen.size() >= 3; }));
  EXPECT_EQ(source.health().reconnects, 0u);
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

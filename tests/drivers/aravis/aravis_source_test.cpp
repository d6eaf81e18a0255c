// The Aravis source against emulated GigE Vision cameras over loopback: settings, bytes, times, refusals,
// triggers. Loss, death and return of cameras: aravis_loss_test.cpp.
#include "drivers/aravis/aravis_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <mutex>

#include "drivers/aravis/aravis_backend.h"
#include "drivers/aravis/gige_channel_emulator.h"
#include "tests/drivers/aravis/aravis_test_tools.h"

namespace rigor {
namespace {

using gige::Bytes;
using gige::FrameRequest;
using gige::GigeEmulator;
using gige::MutableBytes;
using ::testing::HasSubstr;
using testing::make_config;
using testing::run_for;
using testing::start_camera;

constexpr const char* kAddress = "127.0.0.51";

class AravisSourceTest : public ::testing::Test {
 protected:
  void SetUp() override { camera = start_camera(kAddress, "SRC51"); }

  [[nodiscard]] Status arm(AravisSource& source, const std::string& keys,
                           Duration period = milliseconds(40)) {
    if (auto s = source.configure(make_config(keys, period)); !s) return s;
    return source.arm({});
  }
  std::unique_ptr<GigeEmulator> camera;
};

TEST_F(AravisSourceTest, GivesEveryFrameWholeInOrderAndAtItsTime) {
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{device: Rigor-SRC51, exposure_us: 6000}")));
  auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  EXPECT_EQ(source.describe().width_px, 640U);
  EXPECT_EQ(source.describe().frame_id, "cam_optical");
  EXPECT_TRUE(source.health().connected);
  ASSERT_TRUE(source.start(testing::now()));
  const auto seen = run_for(source, seconds(3));
  ASSERT_TRUE(source.stop());
  ASSERT_GE(seen.size(), 70U);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const auto& s = seen[i];
    EXPECT_EQ(s.stamp.validity, kValid) << i;
    EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0U) << i;
    EXPECT_EQ(s.stamp.sequence, seen[0].stamp.sequence + i);
    // The emulator stamps with CLOCK_MONOTONIC and the picture carries the instant: truth against stamp.
    const double error_ns = static_cast<double>(s.stamp.t_capture.ns()) -
                            static_cast<double>(s.verdict.exposure_start_ns + 3'000'000);
    EXPECT_LT(std::abs(error_ns), 5.0 * static_cast<double>(s.stamp.sigma_capture.ns())) << i;
    EXPECT_EQ(s.stamp.t_release, s.stamp.t_capture + milliseconds(60));
    EXPECT_GT(s.stamp.t_arrival, s.stamp.t_capture);
  }
  EXPECT_LE(source.health().received - seen.size(), 1U);  // one may come while the channel stops
  EXPECT_EQ(source.health().lost, 0U);
  EXPECT_GE(source.counters().latches, 6U);
}

TEST_F(AravisSourceTest, MapsADeviceClockThatStartsElsewhere) {
  {  // A client that resets the camera's counter and goes: it no longer counts CLOCK_MONOTONIC.
    gige::testing::UdpTransport transport({*gige::parse_ipv4(kAddress), gige::kGvcpPort},
                                          *gige::parse_ipv4("127.0.0.1"));
    gige::GigeClient client(transport);
    ASSERT_TRUE(client.connect());
    ASSERT_TRUE(client.write(gige::reg::kTimestampControl, gige::reg::kTimestampReset));
    ASSERT_TRUE(client.disconnect());
  }
  AravisSource source;
  ASSERT_TRUE(arm(source, "{device: SRC51, exposure_us: 2000}"));
  ASSERT_TRUE(source.start(testing::now()));
  const auto seen = run_for(source, seconds(2));
  ASSERT_TRUE(source.stop());
  ASSERT_GE(seen.size(), 40U);
  double worst = 0;
  for (const auto& s : seen) {
    const double error_ns = static_cast<double>(s.stamp.t_capture.ns()) -
                            static_cast<double>(s.verdict.exposure_start_ns + 1'000'000);
    worst = std::max(worst, std::abs(error_ns) / static_cast<double>(s.stamp.sigma_capture.ns()));
    EXPECT_EQ(s.stamp.validity & kClockUnsure, 0U);
  }
  EXPECT_LT(worst, 5.0) << "times the stated sigma";
}

TEST_F(AravisSourceTest, EveryFormatArrivesAsTheCameraMadeIt) {
  for (const PixelFormat wanted : kPixelFormats) {
    const std::string format(pfnc_name(wanted));
    AravisSource source;
    auto armed = arm(source, std::string("{device: SRC51, pixel_format: ") + format +
                                 ", region: {x_px: 32, y_px: 16, width_px: 200, height_px: 102}}");
    ASSERT_TRUE(armed) << armed.error().text();
    EXPECT_EQ(source.describe().max_bytes, image_bytes(wanted, 200, 102));
    ASSERT_TRUE(source.start(testing::now()));
    const auto seen = run_for(source, milliseconds(500));
    ASSERT_TRUE(source.stop());
    ASSERT_GE(seen.size(), 5U) << format;
    for (const auto& s : seen) {
      EXPECT_EQ(s.image.format, wanted);
      EXPECT_EQ(s.image.width_px, 200U);
      EXPECT_EQ(s.image.height_px, 102U);
      EXPECT_EQ(s.image.offset_x_px, 32U);
      EXPECT_EQ(s.image.offset_y_px, 16U);
      EXPECT_EQ(s.bytes, image_bytes(wanted, 200, 102));
      EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0U) << format;
    }
  }
}

TEST_F(AravisSourceTest, SettingsReachTheCamera) {
  std::mutex mutex;
  std::vector<FrameRequest> requests;
  camera.reset();
  camera = start_camera(kAddress, "SRC51", [&](const FrameRequest& r, MutableBytes out) {
    const std::lock_guard lock(mutex);
    requests.push_back(r);
    return gige::testing::fill_stamped(r, out);
  });
  AravisSource source;
  ASSERT_TRUE(
      arm(source,
          "{address: 127.0.0.51, exposure_us: 3500, gain_db: 6, packet_size: 1200, packet_delay_ns: 2000}",
          milliseconds(20)));
  ASSERT_TRUE(source.start(testing::now()));
  const auto seen = run_for(source, seconds(1));
  ASSERT_TRUE(source.stop());
  ASSERT_GE(seen.size(), 40U);
  EXPECT_EQ(seen[0].image.exposure, microseconds(3500));
  EXPECT_DOUBLE_EQ(seen[0].image.gain_db, 6.0);
  const std::lock_guard lock(mutex);
  ASSERT_GE(requests.size(), 40U);
  EXPECT_EQ(requests[5].exposure, microseconds(3500));
  EXPECT_DOUBLE_EQ(requests[5].gain_db, 6.0);
  EXPECT_EQ((requests[10].t_exposure_start - requests[0].t_exposure_start).ns(), 200'000'000);
}

struct Refusal {
  const char *keys, *says;
  ErrorCode code;
};

TEST_F(AravisSourceTest, SaysWhatTheCameraRefusesAndWhatItOffers) {
  for (const Refusal& r : {
           Refusal{"{device: SRC51, trigger: software, exposure_us: 2e6}",
                   "exposure_us: expected 10 … 1e+06 µs", ErrorCode::bad_input},
           Refusal{"{device: SRC51, gain_db: 60}", "gain_db: expected 0 … 24 dB", ErrorCode::bad_input},
           Refusal{"{device: SRC51, region: {width_px: 4000, height_px: 100}}",
                   "width_px: expected 16 … 640 px in steps of 4", ErrorCode::bad_input},
           Refusal{"{device: SRC51, region: {x_px: 600, y_px: 0, width_px: 100, height_px: 100}}",
                   "x_px: expected 0 … 540 px", ErrorCode::bad_input},
           Refusal{"{device: SRC51, region: {width_px: 101, height_px: 100}}", "steps of 4",
                   ErrorCode::bad_input},
           Refusal{"{device: SRC51, exposure_us: 50000}", "within the channel's period of 40000 µs",
                   ErrorCode::bad_input},
           Refusal{"{device: NOBODY}", "there are: Rigor-SRC51 at 127.0.0.51", ErrorCode::not_found},
           Refusal{"{address: 127.0.0.52}", "Rigor-SRC51 at 127.0.0.51", ErrorCode::not_found},
           Refusal{"{device: OTHER, address: 127.0.0.51}", "127.0.0.51", ErrorCode::not_found},
           Refusal{"{device: SRC51, interface: eth77}", "expected an interface of this machine",
                   ErrorCode::not_found},
       }) {
    AravisSource source;
    ASSERT_TRUE(source.configure(make_config(r.keys))) << r.keys;
    const auto status = source.arm({});
    ASSERT_FALSE(status) << r.keys;
    EXPECT_EQ(status.error().code, r.code) << status.error().text();
    EXPECT_THAT(status.error().text(), HasSubstr(r.says)) << r.keys;
    EXPECT_THAT(status.error().text(), HasSubstr("rig.yaml:")) << r.keys;
    EXPECT_EQ(status.error().exit_status(), 2);
    EXPECT_EQ(source.state(), ChannelState::configured);
  }
  // Nothing of these was left open: the camera can be had at once.
  AravisSource source;
  const auto status = arm(source, "{device: SRC51}");
  EXPECT_TRUE(status) << status.error().text();
}

TEST_F(AravisSourceTest, RefusesAFormatThatTheCameraDoesNotHave) {
  camera.reset();
  gige::GigeCameraConfig c;
  c.formats = {gige::PixelFormat::mono8, gige::PixelFormat::mono16};
  camera = start_camera(kAddress, "SRC51", gige::testing::fill_stamped, c);
  AravisSource source;
  const auto status = arm(source, "{device: SRC51, pixel_format: RGB8}");
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(),
              HasSubstr("pixel_format: expected a format that the camera offers (Mono8, Mono16), got RGB8"));
}

TEST_F(AravisSourceTest, SaysThatAnotherClientHasTheCamera) {
  AravisSource first, second;
  ASSERT_TRUE(arm(first, "{device: SRC51}"));
  const auto status = arm(second, "{device: SRC51}");
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().code, ErrorCode::unavailable);
  EXPECT_THAT(status.error().text(), HasSubstr("held by another client"));
}

TEST(AravisSettings, WrongKeysAreErrorsWithTheirPlace) {
  for (const auto& [keys, says] : std::map<std::string, std::string>{
           {"{device: X, exposure_us: -1}", "exposure_us"},
           {"{device: X, pixel_format: Mono9}", "Mono8"},
           {"{device: X, trigger: hardwired}", "free_run"},
           {"{exposure_us: 10}", "expected `device`"},
           {"{device: X, region: {width_px: 10}}", "height"},
           {"{device: X, region: {width_px: 10, height_px: 10, wide: 3}}", "wide"},
           {"{address: 300.1.1.1}", "expected an IPv4 address"},
           {"{device: X, expsure_us: 10}", "exposure_us"},
           {"{device: X, packet_size: 12}", "packet_size"},
           {"{device: X, buffers: 1}", "buffers"}}) {
    AravisSource source;
    const auto status = source.configure(make_config(keys));
    ASSERT_FALSE(status) << keys;
    EXPECT_EQ(status.error().code, ErrorCode::bad_input);
    EXPECT_THAT(status.error().text(), HasSubstr(says)) << keys;
    EXPECT_THAT(status.error().text(), HasSubstr("rig.yaml:1:")) << keys;
  }
}

TEST_F(AravisSourceTest, FollowsTheLifecycle) {
  AravisSource source;
  EXPECT_EQ(source.arm({}).error().code, ErrorCode::wrong_state);
  EXPECT_EQ(source.start(testing::now()).error().code, ErrorCode::wrong_state);
  EXPECT_FALSE(source.poll(testing::now()));
  ASSERT_TRUE(source.configure(make_config("{device: SRC51}")));
  EXPECT_EQ(source.arm({.virtual_time = true}).error().code, ErrorCode::bad_input);
  for (int round = 0; round < 3; ++round) {
    ASSERT_TRUE(source.arm({}));
    EXPECT_EQ(source.arm({}).error().code, ErrorCode::wrong_state);
    if (round == 1) {
      ASSERT_TRUE(source.stop());  // armed and never started
      continue;
    }
    ASSERT_TRUE(source.start(testing::now()));
    const auto seen = run_for(source, milliseconds(400));
    EXPECT_GE(seen.size(), 5U);
    EXPECT_EQ(seen.front().stamp.sequence, 0U);
    ASSERT_TRUE(source.stop());
    EXPECT_FALSE(source.health().connected);
    EXPECT_FALSE(source.poll(testing::now()));
  }
  ASSERT_TRUE(source.configure(make_config("{device: SRC51, trigger: software}")));
}

TEST_F(AravisSourceTest, LeasesThatAreHeldCostFramesAndNeverOverwriteOne) {
  AravisSource source;
  ASSERT_TRUE(
      arm(source, "{device: SRC51, buffers: 4, region: {width_px: 64, height_px: 64}}", milliseconds(10)));
  ASSERT_TRUE(source.start(testing::now()));
  std::vector<SampleLease> held;
  std::vector<std::vector<std::byte>> copies;
  const BenchTime end = testing::now() + seconds(1);
  while (testing::now() < end) {
    if (auto lease = source.poll(testing::now())) {
      copies.emplace_back(lease->bytes().begin(), lease->bytes().end());
      held.push_back(std::move(lease));
    }
    usleep(1000);
  }
  ASSERT_EQ(held.size(), 4U);
  for (std::size_t i = 0; i < held.size(); ++i)
    EXPECT_TRUE(std::equal(copies[i].begin(), copies[i].end(), held[i]->bytes().begin())) << i;
  EXPECT_GE(source.health().no_slot, 50U);
  const auto last = held.back()->stamp.sequence;
  held.clear();
  const auto seen = run_for(source, milliseconds(300));
  ASSERT_GE(seen.size(), 10U);
  EXPECT_GE(seen[0].stamp.lost_before, 50U);
  EXPECT_EQ(seen[0].stamp.sequence, last + seen[0].stamp.lost_before + 1);
  ASSERT_TRUE(source.stop());
}

TEST_F(AravisSourceTest, ASoftwareTriggerExposesOnTheBenchsGrid) {
  AravisSource source;
  ASSERT_TRUE(arm(source, "{device: SRC51, trigger: software, exposure_us: 2000}", milliseconds(50)));
  const BenchTime t0 = testing::now() + milliseconds(20);
  ASSERT_TRUE(source.start(t0));
  const auto seen = run_for(source, milliseconds(2020));
  ASSERT_TRUE(source.stop());
  ASSERT_GE(seen.size(), 38U);
  ASSERT_LE(seen.size(), 41U);
  std::size_t close = 0;
  for (const auto& s : seen) {
    // The loop here runs at 1 kHz: a cycle of 1 ms, and the way of the command.
    const Duration off = (BenchTime(static_cast<std::int64_t>(s.verdict.exposure_start_ns)) - t0);
    const std::int64_t phase_ns = off.ns() % 50'000'000;
    close += phase_ns >= 0 && phase_ns < 4'000'000;
  }
  // Exposures at any other time would be close one time in twelve; a stressed machine delays some.
  EXPECT_GE(close, seen.size() * 3 / 4);
  // The end of the acquisition may have taken the last one.
  EXPECT_LE(camera->health().frames_sent, source.counters().triggers_sent);
  EXPECT_GE(camera->health().frames_sent + 1, source.counters().triggers_sent);
  EXPECT_TRUE(seen.back().stamp.sequence >= 38U);
}

TEST_F(AravisSourceTest, TwoCamerasOnOneMachineAreTwoChannels) {
  auto other = start_camera("127.0.0.53", "SRC53");
  AravisSource a, b;
  ASSERT_TRUE(arm(a, "{device: Rigor-SRC51, interface: 127.0.0.1}"));
  ASSERT_TRUE(arm(b, "{device: Rigor-SRC53, interface: lo, exposure_us: 1000}"));
  ASSERT_TRUE(a.start(testing::now()));
  ASSERT_TRUE(b.start(testing::now()));
  std::vector<testing::Seen> seen_a, seen_b;
  const BenchTime end = testing::now() + seconds(2);
  while (testing::now() < end) {
    testing::collect(a, seen_a);
    testing::collect(b, seen_b);
    usleep(1000);
  }
  ASSERT_TRUE(a.stop());
  ASSERT_TRUE(b.stop());
  for (const auto* seen : {&seen_a, &seen_b}) {
    ASSERT_GE(seen->size(), 45U);
    for (const auto& s : *seen) EXPECT_EQ(s.verdict.wrong + s.verdict.zero, 0U);
  }
  EXPECT_EQ(seen_b[3].image.exposure, microseconds(1000));
}

TEST_F(AravisSourceTest, DevicesListsItAndTheDoctorNamesCures) {
  const Backend backend = aravis_backend();
  const auto found = backend.find_devices();
  const bool there = std::any_of(found.begin(), found.end(), [](const FoundDevice& d) {
    return d.id == "Rigor-SRC51" && d.address == kAddress && d.backend == "aravis";
  });
  EXPECT_TRUE(there);
  for (const DoctorFinding& f : backend.doctor()) {
    EXPECT_FALSE(f.what.empty());
    EXPECT_EQ(f.cure.empty(), f.level == DoctorFinding::Level::good) << f.what;
  }
}

}  // namespace
}  // namespace rigor

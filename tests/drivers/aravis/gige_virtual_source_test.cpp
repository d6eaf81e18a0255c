// The GigE Vision channel in virtual time: the same bytes each time, at the instants of the bench's grid.
#include "drivers/aravis/gige_virtual_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <vector>

namespace rigor {
namespace {

using ::testing::HasSubstr;

/// Every byte depends on the request, the joint's angle included.
class Pattern final : public ImageProvider {
 public:
  [[nodiscard]] Geometry geometry() const override {
    return {.width_px = 64,
            .height_px = 48,
            .format = PixelFormat::mono8,
            .exposure = milliseconds(4),
            .frame_id = "x"};
  }
  [[nodiscard]] Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    requests.push_back(r);
    for (std::size_t i = 0; i < pixels.size(); ++i)
      pixels[i] = static_cast<std::byte>(i * 7 + r.index * 13 + static_cast<std::size_t>(r.gain_db) +
                                         static_cast<std::size_t>(r.motion.joint[0].at(r.t_capture)));
    return {};
  }
  std::vector<ImageRequest> requests;
};

/// Knows the past and the present; a question about the future is a fault of the asker.
class Motion final : public MotionSource {
 public:
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override {
    asked_early = asked_early || t > now;
    WorldMotion m;
    m.count = 1;
    m.joint[0] = JointState{.t_ref = t, .position_rad = (t - BenchTime(0)).seconds() * 100, .rate_radps = 0};
    return m;
  }
  BenchTime now;
  mutable bool asked_early = false;
};

struct Shot {
  Stamp stamp;
  ImageInfo info;
  std::vector<std::byte> bytes;
};

struct Rig {
  std::shared_ptr<Pattern> pattern = std::make_shared<Pattern>();
  std::shared_ptr<Motion> motion = std::make_shared<Motion>();
  std::unique_ptr<GigeVirtualSource> source;

  std::string emulator = "{serial: left, rate_hz: 25}";
  [[nodiscard]] DeviceParts parts() const {
    DeviceParts p;
    p.image = pattern;
    p.motion = motion;
    return p;
  }
  Status configure(const std::string& keys, Duration period = milliseconds(40),
                   Duration latency = milliseconds(20)) {
    source = std::make_unique<GigeVirtualSource>(parts(), *ConfigDocument::parse(emulator, "rig.yaml"));
    ChannelConfig c;
    c.name = "left.real";
    c.kind = SampleKind::image;
    c.period = period;
    c.latency = latency;
    c.params = *ConfigDocument::parse(keys, "rig.yaml");
    return source->configure(c);
  }
  std::vector<Shot> run(BenchTime t0, Duration d) {
    std::vector<Shot> shots;
    EXPECT_TRUE(source->start(t0));
    for (BenchTime t = t0; t < t0 + d; t = t + milliseconds(1)) {
      motion->now = t;
      source->begin_cycle(t);
      source->complete_until(t);
      while (auto lease = source->poll(t)) {
        EXPECT_LE(lease->stamp.t_release, t);
        EXPECT_GT(lease->stamp.t_release + milliseconds(1), t)
            << "visible in the first cycle that may see it";
        shots.push_back(
            {lease->stamp, *lease->as<ImageInfo>(), {lease->bytes().begin(), lease->bytes().end()}});
      }
    }
    return shots;
  }
};

TEST(GigeVirtualSource, GivesAPictureAtEveryInstantOfTheGrid) {
  for (const int period_ms : {40, 5, 7, 33}) {
    for (const BenchTime t0 : {BenchTime(0), BenchTime(5'000'000'000)}) {
      Rig rig;
      ASSERT_TRUE(rig.configure("{device: Rigor-left, exposure_us: 1000, gain_db: 3}",
                                milliseconds(period_ms), milliseconds(5)));
      const auto armed = rig.source->arm({.virtual_time = true});
      ASSERT_TRUE(armed) << armed.error().text();
      const auto shots = rig.run(t0, seconds(1));
      ASSERT_GE(shots.size(), static_cast<std::size_t>(980 / period_ms)) << period_ms;
      for (std::size_t k = 0; k < shots.size(); ++k) {
        const Stamp& s = shots[k].stamp;
        EXPECT_EQ(s.sequence, k);
        EXPECT_EQ(s.t_capture, t0 + milliseconds(period_ms) * static_cast<std::int64_t>(k))
            << period_ms << " " << k;
        EXPECT_EQ(s.t_release, s.t_capture + milliseconds(5));
        EXPECT_EQ(s.t_arrival, s.t_release);
        EXPECT_EQ(s.validity, kValid);
        EXPECT_EQ(rig.pattern->requests[k].t_capture, s.t_capture);
        EXPECT_EQ(rig.pattern->requests[k].exposure, milliseconds(1));
        EXPECT_DOUBLE_EQ(rig.pattern->requests[k].gain_db, 3);
      }
      EXPECT_FALSE(rig.motion->asked_early);
      EXPECT_EQ(rig.source->health().lost, 0U);
      ASSERT_TRUE(rig.source->stop());
    }
  }
}

TEST(GigeVirtualSource, TwoRunsAreEqualByteForByte) {
  std::vector<std::vector<Shot>> runs;
  Rig rig;
  for (int i = 0; i < 2; ++i) {
    if (i == 0) {
      ASSERT_TRUE(rig.configure(
          "{device: left, pixel_format: Mono12p, region: {x_px: 8, y_px: 4, width_px: 32, height_px: 20}}"));
    }
    ASSERT_TRUE(rig.source->arm({.virtual_time = true}));  // the second time the same object again
    runs.push_back(rig.run(BenchTime(0), seconds(1)));
    ASSERT_TRUE(rig.source->stop());
  }
  ASSERT_EQ(runs[0].size(), 25U);
  ASSERT_EQ(runs[1].size(), 25U);
  for (std::size_t k = 0; k < 25; ++k) {
    EXPECT_EQ(runs[0][k].bytes, runs[1][k].bytes);
    EXPECT_EQ(runs[0][k].bytes.size(), image_bytes(PixelFormat::mono12p, 32, 20));
    EXPECT_EQ(runs[0][k].info.offset_x_px, 8U);
    if (k > 0) {
      EXPECT_NE(runs[0][k].bytes, runs[0][k - 1].bytes);
    }
  }
}

TEST(GigeVirtualSource, ASoftwareTriggerBeginsTheExposureOnTheGrid) {
  Rig rig;
  ASSERT_TRUE(rig.configure("{device: left, trigger: software, exposure_us: 2000}"));
  ASSERT_TRUE(rig.source->arm({.virtual_time = true}));
  const auto shots = rig.run(BenchTime(0), seconds(1));
  ASSERT_GE(shots.size(), 24U);
  for (std::size_t k = 0; k < shots.size(); ++k)
    EXPECT_EQ(shots[k].stamp.t_capture,
              BenchTime(0) + milliseconds(40) * static_cast<std::int64_t>(k) + milliseconds(1));
  EXPECT_FALSE(rig.motion->asked_early);
}

TEST(GigeVirtualSource, SaysWhatCannotBe) {
  Rig rig;
  ASSERT_TRUE(rig.configure("{device: left, exposure_us: 4000}", milliseconds(40), milliseconds(2)));
  auto status = rig.source->arm({.virtual_time = true});
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(), HasSubstr("expected at least 3 ms"));
  ASSERT_TRUE(rig.configure("{device: left, region: {width_px: 100, height_px: 20}}"));
  status = rig.source->arm({.virtual_time = true});
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(), HasSubstr("within 64x48 px"));
  ASSERT_TRUE(rig.configure("{device: left}"));
  EXPECT_FALSE(rig.source->arm({}));
  EXPECT_FALSE(rig.configure("{device: left, exposure: 3}"));
}

TEST(GigeVirtualSource, ExposesWhenTheLineSaysSo) {
  Rig rig;
  rig.emulator = "{serial: left, rate_hz: 25, trigger_line: {rate_hz: 20, phase_us: 3000}}";
  ASSERT_TRUE(rig.configure("{device: x, exposure_us: 4000, trigger: hardware, trigger_delay_us: 250}",
                            milliseconds(50)));
  ASSERT_TRUE(rig.source->arm({.virtual_time = true}));
  const auto shots = rig.run(BenchTime(0), milliseconds(400));
  ASSERT_EQ(shots.size(), 8u);
  for (std::size_t i = 0; i < shots.size(); ++i) {
    // Edge, delay, half of the exposure.
    EXPECT_EQ(shots[i].stamp.t_capture, BenchTime(0) + milliseconds(50) * static_cast<std::int64_t>(i) +
                                            microseconds(3000 + 250 + 2000));
    EXPECT_EQ(shots[i].stamp.sequence, i);
  }
  EXPECT_FALSE(rig.motion->asked_early);

  Rig falling;
  falling.emulator = rig.emulator;
  ASSERT_TRUE(falling.configure("{device: x, exposure_us: 4000, trigger: hardware, trigger_edge: falling}",
                                milliseconds(50)));
  ASSERT_TRUE(falling.source->arm({.virtual_time = true}));
  const auto later = falling.run(BenchTime(0), milliseconds(200));
  ASSERT_FALSE(later.empty());
  EXPECT_EQ(later[0].stamp.t_capture, BenchTime(0) + milliseconds(3 + 25 + 2));

  Rig unwired;
  ASSERT_TRUE(unwired.configure("{device: x, exposure_us: 4000, trigger: hardware}"));
  const auto s = unwired.source->arm({.virtual_time = true});
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), HasSubstr("give the emulator a `trigger_line`"));
}

TEST(GigeVirtualSource, ActionCommandsBeginExposuresOfSeveralCamerasTogether) {
  std::vector<std::vector<Shot>> all;
  for (const int exposure_us : {4000, 1000}) {
    Rig rig;
    rig.emulator = "{serial: left, rate_hz: 25, ptp: {settle_s: 1, offset_ns: 0}}";
    ASSERT_TRUE(rig.configure("{device: x, trigger: action, action: {lead_ms: 15}, exposure_us: " +
                              std::to_string(exposure_us) + "}"));
    const auto armed = rig.source->arm({.virtual_time = true});
    ASSERT_TRUE(armed) << armed.error().text();
    all.push_back(rig.run(BenchTime(5'000'000'000), milliseconds(430)));
    EXPECT_FALSE(rig.motion->asked_early);
    EXPECT_EQ(rig.source->health().lost, 0u);
    ASSERT_TRUE(rig.source->stop());
  }
  ASSERT_EQ(all[0].size(), 11u);
  ASSERT_EQ(all[1].size(), 11u);
  for (std::size_t k = 0; k < 11; ++k)
    for (const auto& shots : all) {
      EXPECT_EQ(shots[k].stamp.t_capture - shots[k].info.exposure / 2,
                BenchTime(5'000'000'000) + milliseconds(40) * static_cast<std::int64_t>(k));
      EXPECT_EQ(shots[k].stamp.sequence, k);
      EXPECT_EQ(shots[k].stamp.lost_before, 0u);
    }
  Rig without;
  ASSERT_TRUE(without.configure("{device: x, exposure_us: 4000, trigger: action}"));
  EXPECT_THAT(without.source->arm({.virtual_time = true}).error().text(),
              HasSubstr("give the emulator `ptp`"));
  Rig slow;
  slow.emulator = "{serial: left, ptp: {settle_s: 60}}";
  ASSERT_TRUE(slow.configure("{device: x, exposure_us: 4000, trigger: action}"));
  EXPECT_THAT(slow.source->arm({.virtual_time = true}).error().text(), HasSubstr("settles within"));
}

TEST(GigeVirtualSource, ACommandThatTheCameraCannotTakeIsALostPicture) {
  // Longer leads than the queue has places for.
  Rig rig;
  rig.emulator = "{serial: left, rate_hz: 100, ptp: {settle_s: 1}}";
  ASSERT_TRUE(rig.configure("{device: x, trigger: action, action: {lead_ms: 1000}, exposure_us: 1000}",
                            milliseconds(10)));
  ASSERT_TRUE(rig.source->arm({.virtual_time = true}));
  const auto shots = rig.run(BenchTime(5'000'000'000), seconds(1));
  EXPECT_GE(shots.size(), 16u);
  EXPECT_GT(rig.source->health().lost, 10u);
}

TEST(GigeVirtualSource, ChunksSayWhatEachPictureWasTakenWith) {
  Rig plain, chunked;
  ASSERT_TRUE(plain.configure("{device: x, exposure_us: 4000, gain_db: 3}"));
  ASSERT_TRUE(chunked.configure("{device: x, exposure_us: 4000, gain_db: 3, chunks: on}"));
  ASSERT_TRUE(plain.source->arm({.virtual_time = true}));
  ASSERT_TRUE(chunked.source->arm({.virtual_time = true}));
  const auto a = plain.run(BenchTime(0), milliseconds(300)), b = chunked.run(BenchTime(0), milliseconds(300));
  ASSERT_EQ(a.size(), b.size());
  ASSERT_FALSE(a.empty());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].bytes, b[i].bytes) << "chunks are no part of the picture";
    EXPECT_EQ(a[i].stamp.t_capture, b[i].stamp.t_capture);
    EXPECT_EQ(b[i].info.exposure, milliseconds(4));
    EXPECT_EQ(b[i].info.gain_db, 3);
  }
}

/// Range and amplitude that tell pixel and instant; every seventh pixel has no return.
class Ranges final : public SampleProvider {
 public:
  [[nodiscard]] Geometry geometry() const override {
    return {SampleKind::range_image, 64, 48, 64 * 48 * 2 * sizeof(float), "tof"};
  }
  static float range_m(std::size_t i, BenchTime t) {
    return i % 7 == 3
               ? NAN
               : 1.0F + 0.001F * static_cast<float>(i) + static_cast<float>((t - BenchTime(0)).seconds());
  }
  [[nodiscard]] Status capture(const Request& r, Sample& s) override {
    auto* f = reinterpret_cast<float*>(s.memory().data());
    for (std::size_t i = 0; i < 64 * 48; ++i)
      f[i] = range_m(i, r.t_capture), f[64 * 48 + i] = static_cast<float>(2 * i);
    s.info = RangeImageInfo{64, 48};
    s.size_bytes = 64 * 48 * 2 * sizeof(float);
    return {};
  }
};

TEST(GigeVirtualSource, A3DCameraGivesRangeAndAmplitude) {
  DeviceParts parts;
  parts.samples = std::make_shared<Ranges>();
  const auto make = [&](SampleKind kind, const std::string& keys, Status& s) {
    auto source = std::make_unique<GigeVirtualSource>(
        parts,
        *ConfigDocument::parse("{serial: tof, rate_hz: 10, range_scale_mm: 0.2, amplitude_scale: 0.5}", "r"));
    ChannelConfig c;
    c.name = "tof.real", c.kind = kind, c.period = milliseconds(100), c.latency = milliseconds(20);
    c.params = *ConfigDocument::parse(keys, "rig.yaml");
    const auto made = catch_config([&] { return s = source->configure(c), true; });
    if (!made) s = tl::unexpected<Error>(made.error());
    if (s) s = source->arm({.virtual_time = true});
    if (s) s = source->start(BenchTime(0));
    return source;
  };
  Status s;
  const auto source = make(SampleKind::range_image,
                           "{device: Rigor-tof, amplitude_scale: 0.5, exposure_us: 2000, region: {x_px: 8, "
                           "y_px: 4, width_px: 32, height_px: 16}}",
                           s);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(source->describe().kind, SampleKind::range_image);
  EXPECT_EQ(source->describe().max_bytes, 32U * 16 * 8);
  int n = 0;
  for (BenchTime t; t < BenchTime(0) + seconds(1); t = t + milliseconds(1)) {
    source->complete_until(t);
    while (const auto lease = source->poll(t)) {
      ++n;
      ASSERT_EQ(lease->kind(), SampleKind::range_image);
      ASSERT_EQ(lease->bytes().size(), 32U * 16 * 8);
      EXPECT_EQ(lease->stamp.validity, kValid);
      const auto* f = reinterpret_cast<const float*>(lease->bytes().data());
      for (std::size_t i = 0; i < 32 * 16; ++i) {
        const std::size_t full = (i / 32 + 4) * 64 + i % 32 + 8;
        const float truth = Ranges::range_m(full, lease->stamp.t_capture);
        if (std::isnan(truth))
          EXPECT_TRUE(std::isnan(f[i])) << i;
        else
          EXPECT_NEAR(f[i], truth, 0.00011) << i;  // half a count
        EXPECT_EQ(f[32 * 16 + i], static_cast<float>(2 * full)) << i;
      }
    }
  }
  EXPECT_EQ(n, 10);
  const auto grey = make(SampleKind::image, "{device: Rigor-tof, part: Intensity, pixel_format: Mono16}", s);
  ASSERT_TRUE(s) << s.error().text();
  grey->complete_until(BenchTime(0) + milliseconds(50));
  const auto picture = grey->poll(BenchTime(0) + milliseconds(50));
  ASSERT_TRUE(picture);
  ASSERT_EQ(picture->bytes().size(), 64U * 48 * 2);
  std::uint16_t raw = 0;
  std::memcpy(&raw, picture->bytes().data() + 2 * 100, 2);
  EXPECT_EQ(raw, 400);
  (void)make(SampleKind::image, "{device: Rigor-tof, part: Intensity}", s);
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), HasSubstr("Mono16, in which the camera sends this part"));
  (void)make(SampleKind::image, "{device: Rigor-tof, part: Disparity, pixel_format: Mono16}", s);
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), HasSubstr("Range (0) or Intensity (1)"));
  (void)make(SampleKind::range_image, "{device: Rigor-tof, chunks: on}", s);
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), HasSubstr("multi-part"));
}

TEST(GigeVirtualSource, AClockThatFollowsAMasterIsNoBetterThanItsOffset) {
  Rig rig;
  rig.emulator = "{serial: left, rate_hz: 25, ptp: {settle_s: 0.1, offset_ns: 5000}}";
  ASSERT_TRUE(rig.configure("{device: x, exposure_us: 4000, ptp: on}"));
  ASSERT_TRUE(rig.source->arm({.virtual_time = true}));
  const auto shots = rig.run(BenchTime(0), seconds(4));
  Duration most;
  for (const auto& s : shots) most = std::max(most, s.stamp.sigma_capture);
  EXPECT_GT(most, microseconds(2));
  EXPECT_LE(most, microseconds(5));
  Rig none;
  ASSERT_TRUE(none.configure("{device: x, exposure_us: 4000, ptp: on}"));
  EXPECT_THAT(none.source->arm({.virtual_time = true}).error().text(), HasSubstr("PTP clock"));
}

}  // namespace
}  // namespace rigor

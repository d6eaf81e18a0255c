// Camera and client in one process, without a network and without a clock.
#include "drivers/aravis/gige_memory_link.h"

#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>

#include "drivers/aravis/gige_client.h"

namespace rigor::gige {
namespace {

void fill_pattern(std::uint64_t seed, MutableBytes out) {
  std::uint64_t x = seed * 0x9E3779B97F4A7C15ULL + 1;
  for (auto& b : out) {
    x = x * 6364136223846793005ULL + 1442695040888963407ULL;
    b = static_cast<std::uint8_t>(x >> 56);
  }
}

struct Rig {
  explicit Rig(GigeCameraConfig c = {}) : model(GigeDeviceModel::create(with_formats(std::move(c))).value()) {
    link.lose = [this](Bytes) { return loss > 0 && std::uniform_real_distribution<>(0, 1)(rng) < loss; };
  }
  static GigeCameraConfig with_formats(GigeCameraConfig c) {
    c.formats = {PixelFormat::mono8,  PixelFormat::mono12p,   PixelFormat::mono12_packed,
                 PixelFormat::mono16, PixelFormat::bayer_rg8, PixelFormat::rgb8};
    return c;
  }
  /// Runs for `span` in steps of 1 ms; complete frames are compared with what was drawn.
  void run(Duration span) {
    for (const auto end = now + span; now < end; now = now + milliseconds(1)) {
      link.advance(now);
      AssembledFrame f;
      while (client.poll(now, f)) {
        ++(f.complete ? complete : incomplete);
        if (!f.complete) continue;
        const auto& r = requests.at(f.leader.timestamp_ticks);
        std::vector<std::uint8_t> expected(payload_bytes(r.region, r.format));
        fill_pattern(f.leader.timestamp_ticks, expected);
        EXPECT_EQ(f.data, expected);
        EXPECT_EQ(f.leader.region, r.region);
        EXPECT_EQ(f.leader.format, r.format);
        hash = std::accumulate(f.data.begin(), f.data.end(), hash,
                               [](std::uint64_t h, std::uint8_t b) { return (h ^ b) * 1099511628211ULL; });
      }
      if (now.ns() % 500'000'000 == 0) {
        EXPECT_TRUE(client.heartbeat());
      }
    }
  }

  GigeDeviceModel model;
  std::map<std::uint64_t, FrameRequest> requests;
  GigeMemoryLink link{model, [this](const FrameRequest& r, MutableBytes out) {
                        requests[r.timestamp_ticks] = r;
                        fill_pattern(r.timestamp_ticks, out);
                        return true;
                      }};
  GigeClient client{link};
  std::mt19937 rng{7};
  double loss = 0;
  DeviceTime now;
  std::uint64_t complete = 0, incomplete = 0, hash = 14695981039346656037ULL;
};

TEST(GigeMemoryLink, DescribesItself) {
  Rig rig;
  const auto d = rig.client.discover();
  ASSERT_TRUE(d);
  EXPECT_EQ(d->serial, "RIGOR0001");
  const auto xml = rig.client.read_genicam_xml();
  ASSERT_TRUE(xml) << xml.error().text();
  EXPECT_EQ(*xml, rig.model.genicam_xml());
  EXPECT_EQ(rig.client.set_gain(1).error().code, ErrorCode::protocol);  // without control
}

TEST(GigeMemoryLink, EveryFormatAndRegionArrivesByteForByte) {
  const auto formats = Rig::with_formats({}).formats;
  for (const auto format : formats) {
    Rig rig;
    ASSERT_TRUE(rig.client.connect());
    ASSERT_TRUE(rig.client.set_pixel_format(format));
    ASSERT_TRUE(rig.client.set_region({100, 50, 324, 202}));
    ASSERT_TRUE(rig.client.set_exposure(microseconds(1500)));
    ASSERT_TRUE(rig.client.set_gain(2.25));
    ASSERT_TRUE(rig.client.set_frame_rate(40));
    ASSERT_TRUE(rig.client.start());
    rig.run(milliseconds(1000));
    EXPECT_EQ(rig.complete, 40U);
    EXPECT_EQ(rig.incomplete, 0U);
    const auto& r = rig.requests.begin()->second;
    EXPECT_EQ(r.region, (Region{100, 50, 324, 202}));
    EXPECT_EQ(r.exposure, microseconds(1500));
    EXPECT_EQ(r.gain_db, 2.25);
  }
}

TEST(GigeMemoryLink, CountsOfSingleMultiAndTriggeredAcquisitionsAreExact) {
  Rig rig;
  ASSERT_TRUE(rig.client.connect());
  ASSERT_TRUE(rig.client.set_acquisition(AcquisitionMode::single_frame));
  ASSERT_TRUE(rig.client.start());
  rig.run(seconds(1));
  EXPECT_EQ(rig.complete, 1U);
  ASSERT_TRUE(rig.client.set_acquisition(AcquisitionMode::multi_frame, 12));
  ASSERT_TRUE(rig.client.start());
  rig.run(seconds(1));
  EXPECT_EQ(rig.complete, 13U);
  ASSERT_TRUE(rig.client.set_acquisition(AcquisitionMode::continuous));
  ASSERT_TRUE(rig.client.set_software_trigger(true));
  ASSERT_TRUE(rig.client.start());
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(rig.client.trigger());
    rig.run(milliseconds(30));
  }
  EXPECT_EQ(rig.complete, 33U);
  ASSERT_TRUE(rig.client.stop());
}

TEST(GigeMemoryLink, ResendMakesUpForLostPackets) {
  Rig rig;
  rig.loss = 0.02;
  ASSERT_TRUE(rig.client.connect());
  ASSERT_TRUE(rig.client.start());
  rig.run(seconds(8));
  EXPECT_GE(rig.complete, 199U);
  EXPECT_EQ(rig.incomplete, 0U);
  EXPECT_GT(rig.client.counters().resends_asked, 500U);
}

TEST(GigeMemoryLink, WithoutAnswersFramesAreMarkedAndNeverTorn) {
  Rig rig;
  rig.loss = 0.5;
  ASSERT_TRUE(rig.client.connect());
  ASSERT_TRUE(rig.client.start());
  rig.run(milliseconds(400));
  rig.loss = 1;
  rig.run(milliseconds(800));
  const auto c = rig.client.counters();
  EXPECT_GT(rig.incomplete, 0U);
  EXPECT_EQ(c.frames_complete, rig.complete);
}

TEST(GigeMemoryLink, TwoRunsAreEqual) {
  const auto once = [] {
    Rig rig;
    rig.loss = 0.05;
    EXPECT_TRUE(rig.client.connect());
    EXPECT_TRUE(rig.client.start());
    rig.run(seconds(2));
    return rig.hash;
  };
  EXPECT_EQ(once(), once());
}

TEST(GigeMemoryLink, SaysWhenItHasSomethingToDo) {
  Rig rig;
  EXPECT_EQ(rig.link.next_event(), DeviceTime::never());
  ASSERT_TRUE(rig.client.connect());
  ASSERT_TRUE(rig.client.start());
  EXPECT_EQ(rig.link.next_event(), DeviceTime(0));
  rig.link.advance(DeviceTime(0));
  EXPECT_EQ(rig.link.next_event(), DeviceTime(11'000'000));  // exposure and readout
  rig.link.advance(DeviceTime(11'000'000));
  EXPECT_EQ(rig.link.next_event(), DeviceTime(40'000'000));
}

TEST(GigeClientLimits, RefusesAFrameThatIsLargerThanAgreed) {
  auto model = GigeDeviceModel::create({}).value();  // 640x480 Mono8
  GigeMemoryLink link(model, [](const FrameRequest&, MutableBytes) { return true; });
  GigeClient small(link, {.max_payload_bytes = 640 * 480 - 1});
  ASSERT_TRUE(small.connect());
  const auto refused = small.start();
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("307200"), std::string::npos) << refused.error().text();
  GigeClient enough(link, {.max_payload_bytes = 640 * 480});
  ASSERT_TRUE(enough.connect());
  EXPECT_TRUE(enough.start());
}

}  // namespace
}  // namespace rigor::gige

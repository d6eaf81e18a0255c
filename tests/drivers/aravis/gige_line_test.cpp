// The emulated camera's input line, chunk data and PTP clock, register by register.
#include <gtest/gtest.h>

#include "drivers/aravis/gige_client.h"
#include "drivers/aravis/gige_memory_link.h"

namespace rigor::gige {
namespace {

struct Rig {
  explicit Rig(const GigeCameraConfig& c = {}) : model(GigeDeviceModel::create(c).value()) {
    link.advance(now);
    EXPECT_TRUE(client.connect());
    EXPECT_TRUE(client.set_exposure(milliseconds(5)));
  }
  std::vector<AssembledFrame> run(Duration span) {
    std::vector<AssembledFrame> frames;
    for (const auto end = now + span; now < end; now = now + milliseconds(1)) {
      link.advance(now);
      AssembledFrame f;
      while (client.poll(now, f)) frames.push_back(f);
    }
    return frames;
  }
  void trigger_by_line(std::uint32_t edge = reg::kRisingEdge, double delay_us = 0) {
    EXPECT_TRUE(client.write(reg::kTriggerMode, 1));
    EXPECT_TRUE(client.write(reg::kTriggerSource, reg::kTriggerSourceLine1));
    EXPECT_TRUE(client.write(reg::kTriggerActivation, edge));
    EXPECT_TRUE(client.write_double(reg::kTriggerDelay, delay_us));
  }
  DeviceTime now{1'000'000'000};
  GigeDeviceModel model;
  GigeMemoryLink link{model, [](const FrameRequest&, MutableBytes out) {
                        std::fill(out.begin(), out.end(), std::uint8_t{7});
                        return true;
                      }};
  GigeClient client{link};
};

TEST(GigeLine, EachPulseIsAnExposure) {
  Rig rig;
  rig.trigger_by_line(reg::kRisingEdge, 300);
  EXPECT_TRUE(rig.client.start());
  EXPECT_TRUE(rig.run(milliseconds(100)).empty()) << "nobody pulsed the line";
  std::vector<std::uint64_t> expected, got;
  for (int i = 0; i < 5; ++i) {
    const auto rise = rig.now + microseconds(100);
    rig.model.pulse_line(rise, rise + microseconds(50));
    expected.push_back(static_cast<std::uint64_t>((rise + microseconds(300)).ns()));
    for (const auto& f : rig.run(milliseconds(20))) got.push_back(f.leader.timestamp_ticks);
  }
  EXPECT_EQ(got, expected);
  EXPECT_EQ(rig.model.counters().line_edges, 5u);
  // A pulse while the sensor is exposed is missed; the one behind it is taken.
  const auto t = rig.now;
  for (const auto at : {microseconds(0), microseconds(2000), microseconds(9000)})
    rig.model.pulse_line(t + at, t + at + microseconds(50));
  rig.link.advance(t + milliseconds(1));
  EXPECT_EQ(rig.run(milliseconds(50)).size(), 2u);
  EXPECT_EQ(rig.model.counters().line_missed, 1u);
  EXPECT_FALSE(rig.client.trigger()) << "a software trigger while the line is the source";
}

TEST(GigeLine, WiredPulsesAreTakenAtTheirInstants) {
  GigeCameraConfig c;
  c.line_period = milliseconds(20);
  c.line_phase = milliseconds(3);
  Rig rising(c), falling(c);
  rising.trigger_by_line();
  falling.trigger_by_line(reg::kFallingEdge);
  EXPECT_TRUE(rising.client.start());
  EXPECT_TRUE(falling.client.start());
  const auto a = rising.run(milliseconds(200)), b = falling.run(milliseconds(200));
  ASSERT_GE(a.size(), 8u);
  ASSERT_GE(b.size(), 8u);
  for (const auto& f : a) EXPECT_EQ(f.leader.timestamp_ticks % 20'000'000, 3'000'000u);
  for (const auto& f : b) EXPECT_EQ(f.leader.timestamp_ticks % 20'000'000, 13'000'000u);
  // High from each rise for half a period.
  EXPECT_EQ(rising.now.ns() % 20'000'000, 0);
  for (const auto& [ms, high] : {std::pair{2, 0u}, {4, 1u}, {12, 1u}, {14, 0u}}) {
    rising.link.advance(rising.now + milliseconds(ms));
    EXPECT_EQ(rising.client.read(reg::kLineStatus).value(), high) << ms;
  }
  // Faster than the sensor: every other pulse is missed and counted.
  Rig slow(c);
  EXPECT_TRUE(slow.client.set_exposure(milliseconds(30)));
  slow.trigger_by_line();
  EXPECT_TRUE(slow.client.start());
  const auto frames = slow.run(milliseconds(420));
  ASSERT_GE(frames.size(), 8u);
  for (std::size_t i = 1; i < frames.size(); ++i)
    EXPECT_EQ(frames[i].leader.timestamp_ticks - frames[i - 1].leader.timestamp_ticks, 40'000'000u);
  EXPECT_GE(slow.model.counters().line_missed + 1, slow.model.counters().line_edges);
}

TEST(GigeChunks, StandBehindThePicture) {
  GigeCameraConfig c;
  c.frame_rate_hz = 100;
  Rig rig(c);
  EXPECT_TRUE(rig.client.write(reg::kChunkModeActive, 1));
  for (std::uint32_t id = reg::kChunkTimestamp; id <= reg::kChunkLast; ++id) {
    EXPECT_TRUE(rig.client.write(reg::kChunkSelector, id));
    EXPECT_TRUE(rig.client.write(reg::kChunkEnable, 1));
  }
  EXPECT_TRUE(rig.client.set_gain(6));
  EXPECT_TRUE(rig.client.write(reg::kWidth, 320));
  EXPECT_TRUE(rig.client.write(reg::kOffsetX, 16));
  EXPECT_TRUE(rig.client.write(reg::kHeight, 240));
  EXPECT_TRUE(rig.client.write(reg::kOffsetY, 6));
  const auto plain = 320u * 240;
  EXPECT_TRUE(rig.client.write(reg::kChunkSelector, reg::kChunkImage));
  EXPECT_TRUE(rig.client.write(reg::kChunkEnable, 0));
  EXPECT_EQ(rig.client.read(reg::kChunkEnable).value(), 1u) << "the picture is always there";
  EXPECT_EQ(rig.client.read(reg::kPayloadSize).value(), plain + 8 + (chunk_table().size() - 1) * 16);
  EXPECT_TRUE(rig.client.start());
  const auto frames = rig.run(milliseconds(100));
  ASSERT_GE(frames.size(), 5u);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const auto& f = frames[i];
    ASSERT_TRUE(f.complete);
    EXPECT_EQ(f.leader.payload_type, kImagePayload | kChunkFlag);
    EXPECT_EQ(find_chunk(f.data, reg::kChunkImage).size(), plain);
    EXPECT_EQ(load_be<std::uint64_t>(find_chunk(f.data, reg::kChunkTimestamp), 0), f.leader.timestamp_ticks);
    EXPECT_EQ(load_be<double>(find_chunk(f.data, reg::kChunkExposureTime), 0), 5000);
    EXPECT_EQ(load_be<double>(find_chunk(f.data, reg::kChunkGain), 0), 6);
    EXPECT_EQ(load_be<std::uint64_t>(find_chunk(f.data, reg::kChunkFrameId), 0), i);
    const std::pair<std::uint32_t, std::uint64_t> of_region[] = {
        {reg::kChunkOffsetX, 16},
        {reg::kChunkOffsetY, 6},
        {reg::kChunkWidth, 320},
        {reg::kChunkHeight, 240},
        {reg::kChunkPixelFormat, static_cast<std::uint64_t>(PixelFormat::mono8)}};
    for (const auto& [id, value] : of_region)
      EXPECT_EQ(load_be<std::uint64_t>(find_chunk(f.data, id)), value) << id;
    EXPECT_TRUE(find_chunk(f.data, 77).empty());
  }
  // Lengths that lie lead nowhere.
  auto broken = frames[0].data;
  for (std::size_t i = 0; i < 64; ++i) {
    broken[broken.size() - 1 - i] = 0xFF;
    EXPECT_LE(find_chunk(broken, reg::kChunkImage).size(), broken.size());
  }
}

TEST(GigePtp, SettlesAndSaysHowFarItIs) {
  GigeCameraConfig c;
  EXPECT_FALSE(Rig(c).client.read(reg::kPtpEnable).has_value());
  c.ptp = {.present = true, .settle = seconds(1), .offset = nanoseconds(300)};
  Rig rig(c);
  const auto status = [&] { return rig.client.read(reg::kPtpStatus).value(); };
  EXPECT_EQ(status(), reg::kPtpDisabled);
  EXPECT_TRUE(rig.client.write(reg::kPtpEnable, 1));
  EXPECT_EQ(status(), reg::kPtpListening);
  (void)rig.run(milliseconds(400));
  EXPECT_EQ(status(), reg::kPtpListening);
  (void)rig.run(milliseconds(200));
  EXPECT_EQ(status(), reg::kPtpUncalibrated);
  EXPECT_TRUE(rig.client.write(reg::kPtpEnable, 1)) << "what is on already does not begin anew";
  (void)rig.run(milliseconds(600));
  EXPECT_EQ(status(), reg::kPtpSlave);
  std::int64_t low = 0, high = 0;
  for (int i = 0; i < 17; ++i) {
    (void)rig.run(seconds(1));
    EXPECT_TRUE(rig.client.write(reg::kPtpLatch, 1));
    const auto offset =
        static_cast<std::int64_t>(std::uint64_t{rig.client.read(reg::kPtpOffsetHigh).value()} << 32 |
                                  rig.client.read(reg::kPtpOffsetLow).value());
    low = std::min(low, offset);
    high = std::max(high, offset);
  }
  EXPECT_GE(low, -300);
  EXPECT_LT(low, -150);
  EXPECT_LE(high, 300);
  EXPECT_GT(high, 150);
}

}  // namespace
}  // namespace rigor::gige

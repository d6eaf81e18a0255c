#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "sensor-hal/record/inspect.h"
#include "tests/sensor-hal/record/sample_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using testing::HasSubstr;

/// 100 Hz for 2 s, samples 50..59 missing (the channel knows of 10), every tenth one 2 ms late, one damaged.
std::vector<std::byte> known_recording() {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory),
                                      {.compression = Compression::lz4, .chunk_bytes = 4000}));
  SampleWriter out(*writer, channel_of(SampleKind::pose));
  for (std::uint64_t i = 0; i < 200; ++i) {
    if (i >= 50 && i < 60) continue;
    Sample s;
    s.info = Pose{};
    s.stamp.sequence = i;
    s.stamp.t_capture = BenchTime(static_cast<std::int64_t>(i) * 10'000'000);
    s.stamp.t_release = s.stamp.t_capture + milliseconds(4);
    s.stamp.t_arrival = s.stamp.t_capture + (i % 10 == 0 ? milliseconds(6) : milliseconds(3));
    s.stamp.lost_before = i == 60 ? 10 : 0;
    s.stamp.validity = i == 99 ? kCorrupt : kValid;
    out.write(s);
  }
  must(writer->add_metadata({"rig", {{"seed", "7"}}}));
  must(writer->close());
  return memory.bytes();
}

TEST(Inspect, FindsWhatIsKnownToBeInARecording) {
  const auto bytes = known_recording();
  for (const bool scan : {false, true}) {
    const RecordingReport report = must(inspect(memory_source(bytes), scan));
    EXPECT_TRUE(report.health.good());
    EXPECT_EQ(report.messages, 2 * 190u);
    EXPECT_EQ(report.compression, "lz4");
    EXPECT_GT(report.chunks, 2u);
    EXPECT_LT(report.chunk_bytes_stored, report.chunk_bytes);
    ASSERT_EQ(report.topics.size(), 2u);
    const TopicReport& t = report.topics[0];
    EXPECT_EQ(t.topic, "/dut/data");
    EXPECT_EQ(t.type, "geometry_msgs/msg/PoseStamped");
    EXPECT_EQ(t.messages, 190u);
    EXPECT_NEAR(t.rate_hz, 189 / 1.99, 1e-9);
    EXPECT_DOUBLE_EQ(t.period_s, 0.01);
    EXPECT_EQ(t.gaps, 1u);
    EXPECT_NEAR(t.longest_gap_s, 0.11, 1e-12);
    EXPECT_EQ(t.sequence_gaps, 1u);
    EXPECT_EQ(t.sequence_missing, 10u);
    ASSERT_TRUE(t.stamps);
    EXPECT_EQ(t.stamps->count, 190u);
    EXPECT_EQ(t.stamps->lost_before, 10u);
    EXPECT_EQ(t.stamps->not_valid, 1u);
    EXPECT_EQ(t.stamps->late, 19u);
    EXPECT_NEAR(t.stamps->late_max_s, 0.002, 1e-12);
    EXPECT_NEAR(t.stamps->latency_p50_s, 0.003, 1e-12);
    EXPECT_FALSE(report.topics[1].stamps);
  }
}

TEST(Inspect, JsonAndTextSayTheSame) {
  const RecordingReport report = must(inspect(memory_source(known_recording(), "x.mcap")));
  const auto json = to_json(report);
  EXPECT_EQ(json["topics"][0]["stamps"]["late"], 19);
  EXPECT_EQ(json["topics"][0]["gaps"], 1);
  EXPECT_EQ(json["metadata"]["rig"]["seed"], "7");
  EXPECT_EQ(json["health"]["good"], true);
  EXPECT_EQ(json["last_ns"], "1700000001994000000");
  const std::string text = to_text(report);
  EXPECT_THAT(text, HasSubstr("x.mcap"));
  EXPECT_THAT(text, HasSubstr("/dut/data"));
  EXPECT_THAT(text, HasSubstr("geometry_msgs/msg/PoseStamped"));
  EXPECT_THAT(text, testing::Not(HasSubstr("repair")));
}

TEST(Inspect, SaysWhatIsWrongWithADamagedFile) {
  auto bytes = known_recording();
  const RecordingReport cut = must(inspect(memory_source(Bytes(bytes).first(bytes.size() / 2))));
  EXPECT_TRUE(cut.health.truncated);
  EXPECT_THAT(to_text(cut), HasSubstr("rigor inspect --repair"));
  EXPECT_GT(cut.messages, 100u);
  const Segment chunk = open_bytes(bytes)->segments()[1];
  bytes[chunk.offset + chunk.length - 20] ^= std::byte{1};
  const RecordingReport damaged = must(inspect(memory_source(bytes)));
  EXPECT_EQ(damaged.health.damaged_chunks, 1u);
  EXPECT_FALSE(damaged.health.good());
  EXPECT_EQ(to_json(damaged)["health"]["damaged_chunks"], 1);
  EXPECT_FALSE(inspect("/nonexistent.mcap"));
}

}  // namespace
}  // namespace rigor::record

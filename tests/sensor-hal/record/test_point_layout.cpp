// Clouds as other programs read them, and back bit for bit.
#include "sensor-hal/record/point_layout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/sensor-hal/record/sample_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using testing::ElementsAre;
using testing::HasSubstr;

/// Points of a turn, some fired before t_capture, with second returns, flags and remissions that are no
/// numbers.
Sample cloud_of(std::uint32_t count, std::int32_t first_ns = -2'000'000) {
  Sample s;
  s.stamp = some_stamp(9);
  s.info = PointCloudInfo{count};
  s.reserve(std::max<std::size_t>(1, count * sizeof(LidarPoint)));
  auto* p = reinterpret_cast<LidarPoint*>(s.memory().data());
  for (std::uint32_t i = 0; i < count; ++i) {
    const auto x = static_cast<float>(i);
    p[i] = {.x_m = 1 + x / 3,
            .y_m = -x / 7,
            .z_m = 0.1F * x,
            .remission = i % 5 == 0 ? std::nanf("") : 1.7F * x,
            .t_offset_ns = first_ns + static_cast<std::int32_t>(i) * 55'297,
            .ring = static_cast<std::uint16_t>(i % 300),
            .return_index = static_cast<std::uint8_t>(i % 2),
            .flags = static_cast<std::uint8_t>(i % 251)};
  }
  s.size_bytes = count * sizeof(LidarPoint);
  return s;
}

SampleChannel cloud_channel(PointLayout layout) {
  SampleChannel c = channel_of(SampleKind::point_cloud);
  c.topic = "/dut/points";
  c.points = layout;
  return c;
}

/// A recording of one cloud; `without`: a topic that is left out.
std::vector<std::byte> recording_of(PointLayout layout, const Sample& sample,
                                    const std::string& without = {}) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory)));
  SampleEncoder encoder(cloud_channel(layout));
  std::vector<std::uint16_t> ids;
  for (const SampleStream& s : encoder.streams()) {
    const auto schema = must(writer->add_schema(std::string(s.type), "ros2msg", schema_text(s.type)));
    ids.push_back(must(writer->add_channel({.schema = schema, .topic = s.topic})));
  }
  for (const SampleMessage& m : must(encoder.encode(sample)))
    if (encoder.streams()[m.stream].topic != without)
      must(writer->write({ids[m.stream], 9, 77, 77}, m.pieces));
  must(writer->close());
  return memory.bytes();
}

Result<std::vector<std::byte>> decoded(const std::vector<std::byte>& recording, Stamp* stamp = nullptr) {
  auto reader = must(McapReader::open(memory_source(recording)));
  SampleDecoder decoder("/dut/points", kToUtc);
  auto cursor = reader->messages({.order = MessageOrder::file});
  MessageView view;
  while (must(cursor.next(view))) {
    const auto whole = decoder.take(view);
    if (!whole) return tl::unexpected<Error>(whole.error());
    if (!*whole) continue;
    Sample sample;
    sample.reserve(decoder.size_bytes() + 1);
    must(decoder.fill(sample));
    if (stamp) *stamp = sample.stamp;
    return std::vector<std::byte>(sample.bytes().begin(), sample.bytes().end());
  }
  return std::vector<std::byte>{std::byte{255}};
}

/// The message on a topic, decoded.
msg::PointCloud2 message_on(const std::string& topic, const std::vector<std::byte>& recording,
                            std::vector<std::byte>& keep) {
  auto reader = must(McapReader::open(memory_source(recording)));
  auto cursor = reader->messages({.topics = {topic}});
  MessageView view;
  EXPECT_TRUE(must(cursor.next(view)));
  keep.assign(view.data.begin(), view.data.end());
  msg::PointCloud2 cloud;
  must(CdrReader::read(keep, cloud));
  return cloud;
}

class EveryLayout : public testing::TestWithParam<PointLayout> {};
INSTANTIATE_TEST_SUITE_P(PointLayout, EveryLayout,
                         testing::Values(PointLayout::rigor, PointLayout::velodyne, PointLayout::ouster,
                                         PointLayout::livox),
                         [](const auto& layout) { return std::string(name_of(layout.param)); });

TEST_P(EveryLayout, GivesSamplesBackBitForBit) {
  for (const std::uint32_t count : {0U, 1U, 700U}) {
    const Sample sample = cloud_of(count);
    Stamp stamp;
    const auto bytes = must(decoded(recording_of(GetParam(), sample), &stamp));
    ASSERT_EQ(bytes.size(), sample.size_bytes);
    EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), sample.bytes().begin()));
    EXPECT_EQ(stamp.t_capture, sample.stamp.t_capture) << "the header's stamp may be an earlier one";
  }
}

TEST_P(EveryLayout, IsRefusedWithoutWhatItLeavesOut) {
  if (GetParam() == PointLayout::rigor) return;  // it leaves nothing out
  const auto lost = decoded(recording_of(GetParam(), cloud_of(5), "/dut/points/timing"));
  ASSERT_FALSE(lost);
  EXPECT_THAT(lost.error().text(), HasSubstr("/dut/points/timing"));
}

TEST_P(EveryLayout, HasItsFieldsInsideItsPoints) {
  std::vector<std::byte> keep;
  const msg::PointCloud2 cloud = message_on("/dut/points", recording_of(GetParam(), cloud_of(3)), keep);
  EXPECT_TRUE(check_cloud(cloud));
  EXPECT_EQ(cloud.point_step, point_step(GetParam()));
  EXPECT_EQ(cloud.data.size(), 3 * cloud.point_step);
  EXPECT_EQ(cloud.is_dense, GetParam() != PointLayout::rigor) << "LIO-SAM takes no other cloud";
}

/// Of a recording without stamps beside the clouds: what the fields say, rounded as they are.
TEST_P(EveryLayout, OfAnotherProgramIsReadByItsFields) {
  const Sample sample = cloud_of(700);
  const auto bytes = must(decoded(recording_of(GetParam(), sample, "/dut/points/stamp")));
  ASSERT_EQ(bytes.size(), sample.size_bytes);
  const auto* was = reinterpret_cast<const LidarPoint*>(sample.bytes().data());
  const auto* is = reinterpret_cast<const LidarPoint*>(bytes.data());
  const std::int32_t earlier = GetParam() == PointLayout::rigor ? 0 : -2'000'000;
  const bool narrow = GetParam() == PointLayout::ouster || GetParam() == PointLayout::livox;
  for (std::size_t i = 0; i < 700; ++i) {
    EXPECT_EQ(is[i].x_m, was[i].x_m);
    EXPECT_EQ(is[i].z_m, was[i].z_m);
    if (i % 5 != 0) {
      EXPECT_EQ(is[i].remission, was[i].remission);
    }
    EXPECT_EQ(is[i].ring, narrow ? was[i].ring % 256 : was[i].ring);
    // float32 of 0.04 s has steps of 3.7 ns; float64 of UTC in nanoseconds steps of 256 ns.
    EXPECT_NEAR(is[i].t_offset_ns, was[i].t_offset_ns - earlier, GetParam() == PointLayout::livox ? 257 : 4);
  }
}

TEST(PointLayout, OfVelodyneIsWhatLioSamReads) {
  std::vector<std::byte> keep;
  const auto recording = recording_of(PointLayout::velodyne, cloud_of(700));
  const msg::PointCloud2 cloud = message_on("/dut/points", recording, keep);
  std::vector<std::string> names;
  for (const auto& f : cloud.fields_) names.push_back(f.name);
  EXPECT_THAT(names, ElementsAre("x", "y", "z", "intensity", "ring", "time"));
  const msg::PointField *ring = field_named(cloud, "ring"), *time = field_named(cloud, "time");
  EXPECT_EQ(ring->datatype, kUint16);
  EXPECT_EQ(ring->offset, 16U);
  EXPECT_EQ(time->datatype, kFloat32);
  EXPECT_EQ(time->offset, 18U);
  EXPECT_EQ(cloud.point_step, 22U);
  // Seconds after the header's stamp, which is the first firing: from 0 up, the last point's the latest.
  EXPECT_EQ(number_at(cloud, *time, 0), 0);
  EXPECT_NEAR(number_at(cloud, *time, 699), 699 * 55'297e-9, 1e-8);
  const std::int64_t stamp_ns =
      std::int64_t{cloud.header.stamp.sec} * 1'000'000'000 + cloud.header.stamp.nanosec;
  EXPECT_EQ(stamp_ns, some_stamp(9).t_capture.ns() + kToUtc.ns() - 2'000'000);
}

TEST(PointLayout, OfOusterIsWhatFastLioReads) {
  std::vector<std::byte> keep;
  const msg::PointCloud2 cloud =
      message_on("/dut/points", recording_of(PointLayout::ouster, cloud_of(700, 0)), keep);
  const auto at = [&](const char* name, std::size_t i) {
    return number_at(cloud, *field_named(cloud, name), i);
  };
  EXPECT_EQ(field_named(cloud, "t")->datatype, kUint32);
  EXPECT_EQ(field_named(cloud, "reflectivity")->datatype, kUint16);
  EXPECT_EQ(field_named(cloud, "ring")->datatype, kUint8);
  EXPECT_EQ(field_named(cloud, "range")->datatype, kUint32);
  EXPECT_EQ(at("t", 699), 699 * 55'297);
  EXPECT_EQ(at("reflectivity", 5), 0) << "no number";
  EXPECT_EQ(at("reflectivity", 4), std::round(1.7F * 4));
  EXPECT_EQ(at("range", 21), std::round(1e3 * std::hypot(8.0, 3.0, 2.1)));
}

TEST(PointLayout, CloudsThatLieAreRefused) {
  msg::PointCloud2 cloud{{}, 1, 4, point_fields(PointLayout::velodyne), false, 22, 88, {}, true};
  std::vector<std::byte> data(88);
  cloud.data = data;
  EXPECT_TRUE(check_cloud(cloud));
  std::vector<LidarPoint> points;
  const auto refused = [&](msg::PointCloud2 wrong) {
    const bool is = !check_cloud(wrong);
    EXPECT_FALSE(unpack_points(wrong, nullptr, points));
    return is;
  };
  auto wrong = cloud;
  wrong.width = 5;
  EXPECT_TRUE(refused(wrong));
  wrong = cloud;
  wrong.width = wrong.height = 0x80000000;  // their product is 0 in 32 bits
  EXPECT_TRUE(refused(wrong));
  wrong = cloud;
  wrong.point_step = 0;
  EXPECT_TRUE(refused(wrong));
  wrong = cloud;
  wrong.fields_[5].offset = 19;  // its last byte is the next point's
  EXPECT_TRUE(refused(wrong));
  wrong.fields_[5].offset = 0xffffffff;
  EXPECT_TRUE(refused(wrong));
  wrong = cloud;
  wrong.fields_[0].datatype = kFloat64;
  EXPECT_FALSE(unpack_points(wrong, nullptr, points)) << "x as float64";
  msg::PointCloud2 timing{{}, 1, 3, timing_fields(), false, kTimingStep, 24, Bytes(data).first(24), true};
  EXPECT_FALSE(unpack_points(cloud, &timing, points)) << "of 3 points, for 4";
}

}  // namespace
}  // namespace rigor::record

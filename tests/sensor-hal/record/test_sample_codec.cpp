#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/sensor-hal/record/sample_fixture.h"

namespace rigor::record {
namespace {

using namespace test;

// Named, for g++ 12 takes `{}` in its place for uninitialized.
const msg::Header kNoHeader;
using testing::HasSubstr;

void expect_equal(const Sample& a, const Sample& b) {
  EXPECT_EQ(a.stamp.sequence, b.stamp.sequence);
  EXPECT_EQ(a.stamp.t_capture, b.stamp.t_capture);
  EXPECT_EQ(a.stamp.t_release, b.stamp.t_release);
  EXPECT_EQ(a.stamp.t_arrival, b.stamp.t_arrival);
  EXPECT_EQ(a.stamp.sigma_capture, b.stamp.sigma_capture);
  EXPECT_EQ(a.stamp.lost_before, b.stamp.lost_before);
  EXPECT_EQ(a.stamp.validity, b.stamp.validity);
  ASSERT_EQ(a.kind(), b.kind());
  ASSERT_EQ(a.size_bytes, b.size_bytes);
  EXPECT_TRUE(std::equal(a.bytes().begin(), a.bytes().end(), b.bytes().begin()));
  if (const auto* x = a.as<ImageInfo>()) {
    const auto& y = *b.as<ImageInfo>();
    EXPECT_EQ(x->format, y.format);
    EXPECT_EQ(std::tie(x->width_px, x->height_px, x->offset_x_px, x->offset_y_px),
              std::tie(y.width_px, y.height_px, y.offset_x_px, y.offset_y_px));
    EXPECT_EQ(x->exposure, y.exposure);
    EXPECT_EQ(x->gain_db, y.gain_db);
  } else if (const auto* r = a.as<RangeImageInfo>()) {
    EXPECT_EQ(r->width_px, b.as<RangeImageInfo>()->width_px);
    EXPECT_EQ(r->height_px, b.as<RangeImageInfo>()->height_px);
  } else if (const auto* p = a.as<PointCloudInfo>()) {
    EXPECT_EQ(p->count, b.as<PointCloudInfo>()->count);
  } else if (const auto* f = a.as<CanFrame>()) {
    const auto& g = *b.as<CanFrame>();
    EXPECT_EQ(std::tie(f->id, f->extended, f->remote, f->error, f->fd, f->bit_rate_switch, f->length),
              std::tie(g.id, g.extended, g.remote, g.error, g.fd, g.bit_rate_switch, g.length));
    EXPECT_EQ(f->data, g.data);
  } else if (const auto* q = a.as<RegisterBlock>()) {
    EXPECT_EQ(q->count, b.as<RegisterBlock>()->count);
    EXPECT_EQ(q->value, b.as<RegisterBlock>()->value);
  } else if (const auto* o = a.as<Pose>()) {
    EXPECT_EQ(o->position_m, b.as<Pose>()->position_m);
    EXPECT_EQ(o->orientation_wxyz, b.as<Pose>()->orientation_wxyz);
  } else if (const auto* e = a.as<EventInfo>()) {
    EXPECT_EQ(e->code, b.as<EventInfo>()->code);
    EXPECT_EQ(e->value, b.as<EventInfo>()->value);
    EXPECT_EQ(e->text, b.as<EventInfo>()->text);
  } else if (const auto* u = a.as<ImuSample>()) {
    const auto& v = *b.as<ImuSample>();
    EXPECT_EQ(u->specific_force_mps2, v.specific_force_mps2);
    EXPECT_EQ(u->angular_rate_radps, v.angular_rate_radps);
    EXPECT_TRUE(u->temperature_c == v.temperature_c ||
                (std::isnan(u->temperature_c) && std::isnan(v.temperature_c)));
  } else if (const auto* n = a.as<NavFix>()) {
    const auto& m = *b.as<NavFix>();
    EXPECT_EQ(std::tie(n->status, n->satellites, n->latitude_deg, n->longitude_deg, n->height_m),
              std::tie(m.status, m.satellites, m.latitude_deg, m.longitude_deg, m.height_m));
    EXPECT_EQ(n->covariance_enu_m2, m.covariance_enu_m2);
  } else if (const auto* d = a.as<Odometry>()) {
    const auto& g = *b.as<Odometry>();
    EXPECT_EQ(d->T_odom_base.position_m, g.T_odom_base.position_m);
    EXPECT_EQ(d->T_odom_base.orientation_wxyz, g.T_odom_base.orientation_wxyz);
    EXPECT_EQ(std::tie(d->velocity_mps, d->turn_rate_radps, d->pose_variance, d->twist_variance),
              std::tie(g.velocity_mps, g.turn_rate_radps, g.pose_variance, g.twist_variance));
    EXPECT_EQ(std::tie(d->wheel_angle_rad, d->wheel_rate_radps),
              std::tie(g.wheel_angle_rad, g.wheel_rate_radps));
  }
}

class EveryKind : public testing::TestWithParam<SampleKind> {};
INSTANTIATE_TEST_SUITE_P(Samples, EveryKind,
                         testing::Values(SampleKind::none, SampleKind::image, SampleKind::range_image,
                                         SampleKind::point_cloud, SampleKind::can_frame,
                                         SampleKind::register_block, SampleKind::pose, SampleKind::event,
                                         SampleKind::imu, SampleKind::nav_fix, SampleKind::odometry));

TEST_P(EveryKind, ComesBackFromARecordingBitForBit) {
  const auto samples = samples_of(GetParam());
  ASSERT_FALSE(samples.empty());
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory),
                                      {.compression = Compression::zstd, .chunk_bytes = 2000}));
  SampleWriter out(*writer, channel_of(GetParam()));
  for (const Sample& sample : samples) out.write(sample);
  must(writer->close());

  auto reader = open_bytes(memory.bytes());
  SampleDecoder decoder("/dut/data");
  MessageCursor cursor = reader->messages();
  MessageView m;
  std::size_t i = 0;
  // Samples of the fixture may share a sequence number and a release; they are told apart by their order in
  // the file.
  while (must(cursor.next(m))) {
    EXPECT_TRUE(decoder.wants(m.channel->topic));
    if (!must(decoder.take(m))) continue;
    ASSERT_LT(i, samples.size());
    Sample back;
    back.reserve(decoder.size_bytes());
    must(decoder.fill(back));
    expect_equal(samples[i++], back);
  }
  EXPECT_EQ(i, samples.size());
}

TEST(SampleEncoder, RefusesSamplesThatAreNotItsChannels) {
  SampleEncoder encoder(channel_of(SampleKind::pose));
  EXPECT_FALSE(encoder.encode(samples_of(SampleKind::event)[0]));
  SampleEncoder camera(channel_of(SampleKind::image));
  Sample short_image = image_sample(PixelFormat::mono8);
  short_image.size_bytes -= 1;
  const auto result = camera.encode(short_image);
  ASSERT_FALSE(result);
  EXPECT_THAT(result.error().text(), HasSubstr("expected a sample of 3072 bytes, got 3071"));
}

/// Feeds one hand-made message to a decoder.
template <class M>
Result<bool> take(SampleDecoder& decoder, const std::string& topic, const M& message,
                  std::uint32_t sequence = 0) {
  static std::vector<std::byte> bytes;
  CdrWriter writer;
  bytes.clear();
  for (const Bytes& piece : must(writer.write(message)))
    bytes.insert(bytes.end(), piece.begin(), piece.end());
  const Channel channel{1, 1, topic, "cdr", {}};
  const Schema schema{1, std::string(M::kType), "ros2msg", ""};
  return decoder.take({&channel, &schema, sequence, 2'000'000'000, 0, bytes});
}

TEST(SampleDecoder, TakesForeignMessagesWithoutStamps) {
  SampleDecoder decoder("/pose", seconds(1));
  EXPECT_TRUE(must(take(decoder, "/pose", msg::PoseStamped{{{1, 500'000'000}, "map"}, {}}, 9)));
  EXPECT_EQ(decoder.stamp().sequence, 9u);
  EXPECT_EQ(decoder.stamp().t_capture, BenchTime(500'000'000));
  EXPECT_EQ(decoder.stamp().t_release, BenchTime(1'000'000'000));
}

TEST(SampleDecoder, TakesFixesOfForeignReceivers) {
  const std::array expected{FixStatus::none, FixStatus::fix, FixStatus::sbas, FixStatus::rtk_fixed};
  for (int status = -1; status <= 2; ++status) {
    SampleDecoder decoder("/fix");
    msg::NavSatFix m;
    m.status.status = static_cast<std::int8_t>(status);
    m.latitude = 50.5;
    ASSERT_TRUE(must(take(decoder, "/fix", m)));
    Sample sample;
    must(decoder.fill(sample));
    ASSERT_TRUE(sample.as<NavFix>());
    EXPECT_EQ(sample.as<NavFix>()->status, expected[static_cast<std::size_t>(status + 1)]);
    EXPECT_EQ(sample.as<NavFix>()->latitude_deg, 50.5);
  }
}

TEST(SampleDecoder, DoesNotPairAStampWithAnotherSample) {
  SampleDecoder decoder("/pose");
  msg::SampleStamp stamp;
  stamp.kind = static_cast<std::uint8_t>(SampleKind::pose);
  stamp.t_capture_ns = 77;
  EXPECT_FALSE(must(take(decoder, "/pose/stamp", stamp, 1)));
  EXPECT_TRUE(must(take(decoder, "/pose", msg::PoseStamped{}, 2)));
  EXPECT_NE(decoder.stamp().t_capture, BenchTime(77));
  EXPECT_FALSE(must(take(decoder, "/pose/stamp", stamp, 3)));
  EXPECT_TRUE(must(take(decoder, "/pose", msg::PoseStamped{}, 3)));
  EXPECT_EQ(decoder.stamp().t_capture, BenchTime(77));
}

TEST(SampleDecoder, ChecksSizesBeforeItBelievesThem) {
  SampleDecoder decoder("/x");
  const auto pixels = noise(100, 1);
  EXPECT_FALSE(take(decoder, "/x", msg::Image{kNoHeader, 10, 11, "mono8", 0, 11, pixels}));
  EXPECT_FALSE(take(decoder, "/x", msg::Image{kNoHeader, 0xffffffff, 0xffffffff, "mono8", 0, 11, pixels}));
  EXPECT_FALSE(take(decoder, "/x", msg::Image{kNoHeader, 10, 10, "bgr8", 0, 11, pixels}));
  EXPECT_TRUE(take(decoder, "/x", msg::Image{kNoHeader, 10, 10, "mono8", 0, 10, pixels}));
  EXPECT_FALSE(
      take(decoder, "/x", msg::PointCloud2{kNoHeader, 0x10000, 0x10000, {}, false, 24, 0, pixels, false}));
  EXPECT_FALSE(take(decoder, "/x", msg::Frame{kNoHeader, 1, false, false, false, 9, {}}));
  EXPECT_FALSE(take(decoder, "/x", msg::CanFdFrame{kNoHeader, 1, false, false, false, true, false, pixels}));
  msg::RegisterBlock block;
  block.values.resize(65);
  EXPECT_FALSE(take(decoder, "/x", block));
  EXPECT_FALSE(take(decoder, "/x", msg::LaserScan{}));
  msg::SampleStamp odometry;
  odometry.kind = static_cast<std::uint8_t>(SampleKind::odometry);
  ASSERT_TRUE(take(decoder, "/x/stamp", odometry, 1));
  ASSERT_TRUE(take(decoder, "/x/wheels", msg::JointState{kNoHeader, {}, {1, 2, 3}, {1, 2}, {}}, 1));
  EXPECT_FALSE(take(decoder, "/x", msg::Odometry{}, 1));
  msg::SampleStamp fix;
  fix.kind = static_cast<std::uint8_t>(SampleKind::nav_fix);
  ASSERT_TRUE(take(decoder, "/x/stamp", fix, 2));
  ASSERT_TRUE(take(decoder, "/x/quality", msg::NavFixQuality{kNoHeader, 5, 0}, 2));
  EXPECT_FALSE(take(decoder, "/x", msg::NavSatFix{}, 2));
  ASSERT_TRUE(take(decoder, "/x", msg::Image{kNoHeader, 10, 10, "mono8", 0, 10, pixels}));
  Sample small;
  small.reserve(99);
  EXPECT_EQ(decoder.fill(small).error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::record

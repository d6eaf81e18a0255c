// Topics of ROS 2 as channels: what a program publishes is what the loop gets.
#include "bridges/ros2/ros2_source.h"

#include <gmock/gmock.h>

#include <cstring>
#include <functional>
#include <thread>

#include "bridges/ros2/names.h"
#include "bridges/ros2/payload.h"
#include "bridges/ros2/ros2_bridge.h"
#include "rt-core/epoch.h"
#include "sensor-hal/conformance/conformance.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/bridges/ros2/network.h"

namespace rigor::test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using namespace ros2;
namespace msg = record::msg;

ChannelConfig config_of(SampleKind kind, const std::string& keys) {
  auto params =
      ConfigDocument::parse("{ domain: " + std::to_string(free_domain()) + ", topic: /t, " + keys + " }");
  EXPECT_TRUE(params) << params.error().text();
  ChannelConfig c;
  c.name = "c";
  c.kind = kind;
  c.latency = milliseconds(20);
  c.params = *params;
  return c;
}

struct SourceTest : ::testing::Test {
  std::shared_ptr<Participant> peer = *Participant::open({.domain = free_domain()});
  std::unique_ptr<Source> source = ros2_backend().make_source();
  std::unique_ptr<Writer> writer;

  void publish(const std::string& type) {
    auto made = peer->write("/t", {full_type(type), definition_text(type)}, {Qos::Profile::reliable, 0});
    ASSERT_TRUE(made) << made.error().text();
    writer = std::move(*made);
  }
  void run(const ChannelConfig& config) {
    auto s = source->configure(config);
    ASSERT_TRUE(s) << s.error().text();
    s = source->arm({});
    ASSERT_TRUE(s) << s.error().text();
    s = source->start(bench_now() - seconds(1));
    ASSERT_TRUE(s) << s.error().text();
    ASSERT_TRUE(test::holds_soon([&] { return writer->peers() > 0; })) << "the source was not found";
  }
  static msg::Header header_of(BenchTime t) {
    const std::int64_t ns = read_epoch().to_utc(t).ns();
    return {{static_cast<std::int32_t>(ns / 1'000'000'000), static_cast<std::uint32_t>(ns % 1'000'000'000)},
            "there"};
  }
  template <class M>
  void send(const M& message) {
    record::CdrWriter cdr;
    const auto pieces = cdr.write(message);
    ASSERT_TRUE(pieces);
    ASSERT_TRUE(writer->send(make_message(writer->type(), *pieces, {}, {})));
  }
  SampleLease next() {
    for (int i = 0; i < 10000; ++i) {
      if (SampleLease s = source->poll(bench_now())) return s;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    ADD_FAILURE() << "no sample came: " << testing::PrintToString(source->warnings());
    return {};
  }
};

TEST_F(SourceTest, PicturesWithTheInstantOfTheirHeader) {
  publish("sensor_msgs/Image");
  run(config_of(SampleKind::image, "width_px: 100, height_px: 60, pixel_format: Mono8"));
  std::vector<std::byte> pixels(6000);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::byte>(i * 13);
  const BenchTime t = bench_now() - milliseconds(7);
  send(msg::Image{header_of(t), 60, 100, "mono8", 0, 100, pixels});
  const SampleLease sample = next();
  ASSERT_TRUE(sample && sample->as<ImageInfo>());
  EXPECT_EQ(sample->as<ImageInfo>()->width_px, 100u);
  EXPECT_THAT(sample->bytes(), ::testing::ElementsAreArray(pixels));
  EXPECT_NEAR(static_cast<double>((sample->stamp.t_capture - t).ns()), 0, 1e5);
  EXPECT_EQ(sample->stamp.t_release, sample->stamp.t_capture + milliseconds(20));
  EXPECT_GE(sample->stamp.t_arrival, t);
  EXPECT_EQ(sample->stamp.validity & kClockUnsure, 0u);
  EXPECT_EQ(sample->stamp.sequence, 0u);

  // A picture of another size is no sample of this channel.
  send(msg::Image{header_of(t), 30, 200, "mono8", 0, 200, pixels});
  send(msg::Image{header_of(t), 60, 100, "mono8", 0, 100, pixels});
  EXPECT_TRUE(next());
  EXPECT_EQ(source->health().protocol_errors, 1u);
  EXPECT_THAT(source->warnings(), ElementsAre(HasSubstr("expected 100x60 Mono8, got 200x30 Mono8")));
  EXPECT_TRUE(source->health().connected);
  EXPECT_TRUE(source->stop());
}

TEST_F(SourceTest, AStampThatCannotBeIsNotBelieved) {
  publish("sensor_msgs/Imu");
  run(config_of(SampleKind::imu, "frame_id: imu_link"));
  const BenchTime before = bench_now();
  send(msg::Imu{{{0, 0}, "x"}, {}, {}, {1, 2, 3}, {}, {4, 5, 6}, {}});
  const SampleLease sample = next();
  ASSERT_TRUE(sample && sample->as<ImuSample>());
  EXPECT_THAT(sample->as<ImuSample>()->angular_rate_radps, ElementsAre(1, 2, 3));
  EXPECT_THAT(sample->as<ImuSample>()->specific_force_mps2, ElementsAre(4, 5, 6));
  EXPECT_EQ(sample->stamp.validity & kClockUnsure, kClockUnsure);
  EXPECT_GE(sample->stamp.t_release, before);
  EXPECT_EQ(source->describe().frame_id, "imu_link");
  EXPECT_TRUE(source->stop());
}

TEST_F(SourceTest, ScansOfALineAsPoints) {
  publish("sensor_msgs/LaserScan");
  run(config_of(SampleKind::point_cloud, "type: sensor_msgs/LaserScan, max_points: 10"));
  msg::LaserScan scan;
  scan.header = header_of(bench_now());
  scan.angle_min = 0;
  scan.angle_increment = 1.5707964f;
  scan.time_increment = 0.001f;
  scan.range_min = 0.1f;
  scan.range_max = 10;
  scan.ranges = {2, std::numeric_limits<float>::infinity(), 3, 0.05f};
  scan.intensities = {7, 8, 9, 10};
  send(scan);
  const SampleLease sample = next();
  ASSERT_TRUE(sample && sample->as<PointCloudInfo>());
  ASSERT_EQ(sample->as<PointCloudInfo>()->count, 2u);
  std::array<LidarPoint, 2> points;
  std::memcpy(points.data(), sample->bytes().data(), sizeof points);
  EXPECT_FLOAT_EQ(points[0].x_m, 2);
  EXPECT_NEAR(points[1].x_m, -3, 1e-5);
  EXPECT_EQ(points[1].t_offset_ns, 2'000'000);
  EXPECT_FLOAT_EQ(points[1].remission, 9);
  EXPECT_TRUE(source->stop());
}

TEST_F(SourceTest, NumbersOfAnyMessageAsRegisters) {
  publish("sensor_msgs/JointState");
  run(config_of(SampleKind::register_block,
                "type: sensor_msgs/JointState, values: { position: position.elbow, speed: velocity.elbow }"));
  EXPECT_THAT(source->describe().names, ElementsAre("position", "speed"));
  const BenchTime t = bench_now() - milliseconds(3);
  send(msg::JointState{header_of(t), {"wrist", "elbow"}, {1, 2}, {3, 4}, {}});
  const SampleLease sample = next();
  ASSERT_TRUE(sample && sample->as<RegisterBlock>());
  ASSERT_EQ(sample->as<RegisterBlock>()->count, 2u);
  EXPECT_EQ(sample->as<RegisterBlock>()->value[0], 2);
  EXPECT_EQ(sample->as<RegisterBlock>()->value[1], 4);
  EXPECT_NEAR(static_cast<double>((sample->stamp.t_capture - t).ns()), 0, 1e5);
  EXPECT_TRUE(source->stop());
}

TEST_F(SourceTest, MistakesAreRefused) {
  const auto said = [&](SampleKind kind, const std::string& keys) {
    const auto s = ros2_backend().make_source()->configure(config_of(kind, keys));
    return s ? std::string("accepted") : s.error().text();
  };
  EXPECT_THAT(said(SampleKind::image, "width_px: 10"), HasSubstr("height_px: expected a whole number"));
  EXPECT_THAT(said(SampleKind::imu, "type: sensor_msgs/Image"),
              HasSubstr("expected sensor_msgs/msg/Imu for a channel of this kind"));
  EXPECT_THAT(said(SampleKind::register_block, "values: { a: b }"),
              HasSubstr("type: expected text, got nothing"));
  EXPECT_THAT(said(SampleKind::register_block, "type: std_msgs/Float64, values: { a: dta }"),
              HasSubstr("did you mean data?"));
  EXPECT_THAT(said(SampleKind::imu, "frame_if: x"), HasSubstr("unknown key; did you mean frame_id?"));
  EXPECT_EQ(said(SampleKind::imu, "qos: reliable"), "accepted");
}

/// The suite that every source passes, with a publisher on the other side.
class Ros2Conformance : public conformance::SourceUnderTest {
 public:
  Ros2Conformance()
      : peer_(*Participant::open({.domain = free_domain()})),
        writer_(*peer_->write("/t", {"sensor_msgs/msg/Imu", definition_text("sensor_msgs/Imu")},
                              {Qos::Profile::sensor_data, 0})),
        thread_([this] { publish(); }) {}
  ~Ros2Conformance() override {
    stopping_ = true;
    thread_.join();
  }
  std::unique_ptr<Source> make() override { return ros2_backend().make_source(); }
  ChannelConfig config() override {
    ChannelConfig c = config_of(SampleKind::imu, "slots: 8");
    c.period = milliseconds(10);
    return c;
  }
  ChannelConfig config_with_unknown_key() override { return config_of(SampleKind::imu, "no_such_key: 1"); }
  [[nodiscard]] bool virtual_time() const override { return false; }
  [[nodiscard]] std::size_t slots() const override { return 8; }
  [[nodiscard]] Duration settle() const override { return milliseconds(500); }

 private:
  void publish() {
    record::CdrWriter cdr;
    for (MonotonicTime next = monotonic_now(); !stopping_; next = next + milliseconds(10)) {
      const std::int64_t ns = realtime_now().ns();
      const msg::Imu imu{
          {{static_cast<std::int32_t>(ns / 1'000'000'000), static_cast<std::uint32_t>(ns % 1'000'000'000)},
           "x"},
          {},
          {},
          {1, 2, 3},
          {},
          {4, 5, 6},
          {}};
      if (const auto pieces = cdr.write(imu))
        (void)writer_->send(make_message(writer_->type(), *pieces, {}, {}));
      const Duration left = next + milliseconds(10) - monotonic_now();
      if (left > Duration(0)) std::this_thread::sleep_for(std::chrono::nanoseconds(left.ns()));
    }
  }
  std::shared_ptr<Participant> peer_;
  std::unique_ptr<Writer> writer_;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace
}  // namespace rigor::test

namespace rigor::conformance {
INSTANTIATE_TEST_SUITE_P(Ros2, SourceConformance,
                         testing::Values(under_test<test::Ros2Conformance>("ros2_over_dds")), name_of_case);
}

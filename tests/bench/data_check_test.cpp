// `rigor check` of data: a clean recording has no findings, and each planted defect is found where it is.
#include "bench/analysis/data_check.h"

#include <unistd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_writer.h"
#include "sensor-hal/record/point_layout.h"
#include "sensor-hal/record/ros2_time.h"

namespace rigor {
namespace {

namespace msg = record::msg;
using testing::HasSubstr;

constexpr std::int64_t kBegin = 1'600'000'000'000'000'000;
constexpr std::int64_t kMillisecond = 1'000'000;

template <class T>
T must(Result<T> result) {
  if (!result) throw std::runtime_error(result.error().text());
  return std::move(*result);
}
void must(Status status) {
  if (!status) throw std::runtime_error(status.error().text());
}

/// A robot with a LiDAR (10 Hz), an IMU (100 Hz), a camera (20 Hz) and its frames, for 4 s, with what a test
/// does to it.
class DataCheck : public testing::Test {
 protected:
  struct Change {
    std::int64_t stamp_ns = 0, log_ns = 0;
    bool skip = false;
    std::string frame;
    std::size_t points = 1000;
    float intensity = 50;
  };
  using Plant = std::function<void(std::uint32_t index, Change& change)>;

  void TearDown() override { std::remove(path_.c_str()); }

  void write(const Plant& lidar = {}, const Plant& imu = {}, const Plant& camera = {},
             const std::function<void(msg::TFMessage&, msg::TFMessage&, std::uint32_t)>& frames = {}) {
    auto writer = must(record::McapWriter::open(
        must(record::open_file_sink(path_)),
        {.compression = record::Compression::none, .chunk_bytes = 16384, .direct_bytes = 1u << 20}));
    const auto topic = [&](const char* name, std::string_view type) {
      const auto schema = must(writer->add_schema(std::string(type), "ros2msg", record::schema_text(type)));
      return must(writer->add_channel({.schema = schema, .topic = name}));
    };
    const auto points = topic("/lidar/points", msg::PointCloud2::kType),
               imus = topic("/imu/data", msg::Imu::kType),
               images = topic("/camera/image_raw", msg::Image::kType),
               tf = topic("/tf", msg::TFMessage::kType),
               tf_static = topic("/tf_static", msg::TFMessage::kType);
    record::CdrWriter cdr;
    const auto put = [&](std::uint16_t id, std::int64_t log_ns, std::uint32_t sequence, const auto& message) {
      const auto time = static_cast<std::uint64_t>(log_ns);
      must(writer->write({id, sequence, time, time}, must(cdr.write(message))));
    };
    msg::TFMessage fixed;
    for (const char* child : {"lidar", "imu", "camera_optical"})
      fixed.transforms.push_back({{record::to_time(kBegin), "base"}, child, {}});
    bool first = true;
    for (std::int64_t ms = 0; ms < 4000; ms += 10) {
      const std::int64_t t = kBegin + ms * kMillisecond;
      msg::TFMessage moving;
      moving.transforms.push_back({{record::to_time(t), "map"}, "base", {}});
      if (frames) frames(fixed, moving, static_cast<std::uint32_t>(ms / 10));
      if (std::exchange(first, false)) put(tf_static, t, 0, fixed);
      put(tf, t, static_cast<std::uint32_t>(ms / 10), moving);
      const auto each = [&](std::int64_t period_ms, const char* frame, const Plant& plant,
                            const auto& write_one) {
        if (ms % period_ms != 0) return;
        const auto k = static_cast<std::uint32_t>(ms / period_ms);
        Change c;
        c.stamp_ns = t - 3 * kMillisecond;
        c.log_ns = t;
        c.frame = frame;
        c.points = 1000 + k % 7;  // as many returns as there happen to be
        c.intensity = 50 + static_cast<float>(k % 5);
        if (plant) plant(k, c);
        if (!c.skip) write_one(k, c, msg::Header{record::to_time(c.stamp_ns), c.frame});
      };
      each(100, "lidar", lidar, [&](std::uint32_t k, const Change& c, const msg::Header& header) {
        std::vector<LidarPoint> sweep(c.points);
        for (std::size_t i = 0; i < sweep.size(); ++i) {
          const double a = 2 * M_PI * static_cast<double>(i) / 1000;
          sweep[i] = {.x_m = static_cast<float>(5 * std::cos(a)),
                      .y_m = static_cast<float>(5 * std::sin(a)),
                      .z_m = 0.1F,
                      .remission = c.intensity,
                      .t_offset_ns = static_cast<std::int32_t>(i) * 1000,
                      .ring = 0,
                      .return_index = 0,
                      .flags = 0};
        }
        std::vector<std::byte> data;
        record::pack_points(PointLayout::velodyne, sweep, 0, 0, data);
        const auto n = static_cast<std::uint32_t>(sweep.size());
        put(points, c.log_ns, k,
            msg::PointCloud2{header, 1, n, record::point_fields(PointLayout::velodyne), false, 22, 22 * n,
                             data, true});
      });
      each(10, "imu", imu, [&](std::uint32_t k, const Change& c, const msg::Header& header) {
        msg::Imu m;
        m.header = header;
        put(imus, c.log_ns, k, m);
      });
      each(50, "camera_optical", camera, [&](std::uint32_t k, const Change& c, const msg::Header& header) {
        const std::vector<std::byte> pixels(12);
        put(images, c.log_ns, k, msg::Image{header, 3, 4, "mono8", 0, 4, pixels});
      });
    }
    must(writer->close());
  }
  [[nodiscard]] DataReport check() const { return must(check_data(path_)); }
  /// All findings are of this kind on this topic; the first of them.
  static DataFinding only(const DataReport& report, const std::string& kind, const std::string& topic) {
    EXPECT_FALSE(report.findings.empty()) << "expected " << kind;
    for (const DataFinding& f : report.findings) {
      EXPECT_EQ(f.kind, kind) << f.topic << ": " << f.text;
      EXPECT_EQ(f.topic, topic) << f.text;
    }
    return report.findings.empty() ? DataFinding{} : report.findings.front();
  }

  std::string path_ = testing::TempDir() + "rigor_data_check_" + std::to_string(getpid()) + ".mcap";
};

TEST_F(DataCheck, OfACleanRecordingFindsNothing) {
  write();
  const DataReport report = check();
  EXPECT_TRUE(report.good()) << report.findings.front().kind << " " << report.findings.front().text;
  EXPECT_EQ(report.topics, 5U);
  EXPECT_EQ(report.judged, 5U);
  EXPECT_EQ(report.messages, 40U + 400 + 80 + 400 + 1);
  EXPECT_NEAR(report.duration_s, 3.99, 1e-9);
}

TEST_F(DataCheck, FindsStampsThatRepeat) {
  write({}, [](std::uint32_t k, Change& c) {
    if (k == 150) c.stamp_ns -= 10 * kMillisecond;
  });
  const DataReport report = check();
  // The stamp after it is two periods later, which is a gap of the stamps.
  ASSERT_EQ(report.findings.size(), 2U);
  EXPECT_EQ(report.findings[0].kind, "stamp_repeated");
  EXPECT_EQ(report.findings[0].topic, "/imu/data");
  EXPECT_NEAR(report.findings[0].t_s, 1.5, 1e-9);
  EXPECT_EQ(report.findings[1].kind, "gap");
}

TEST_F(DataCheck, FindsStampsThatRunBack) {
  write({}, {}, [](std::uint32_t k, Change& c) {
    if (k == 40) c.stamp_ns -= 70 * kMillisecond;
  });
  const DataReport report = check();
  ASSERT_FALSE(report.findings.empty());
  EXPECT_EQ(report.findings[0].kind, "stamp_back");
  EXPECT_EQ(report.findings[0].topic, "/camera/image_raw");
  EXPECT_NEAR(report.findings[0].value, -0.02, 1e-9);
  EXPECT_NEAR(report.findings[0].t_s, 2.0, 1e-9);
}

TEST_F(DataCheck, FindsGapsAndWhatEndsEarly) {
  write([](std::uint32_t k, Change& c) { c.skip = k == 20 || k == 21; }, {},
        [](std::uint32_t k, Change& c) { c.skip = k >= 50; });
  const DataReport report = check();
  ASSERT_EQ(report.findings.size(), 2U);
  EXPECT_EQ(report.findings[0].kind, "gap");
  EXPECT_EQ(report.findings[0].topic, "/lidar/points");
  EXPECT_NEAR(report.findings[0].value, 0.3, 1e-9);
  EXPECT_THAT(report.findings[0].text, HasSubstr("2 missing"));
  EXPECT_EQ(report.findings[1].kind, "gap");
  EXPECT_EQ(report.findings[1].topic, "/camera/image_raw");
  EXPECT_THAT(report.findings[1].text, HasSubstr("nothing comes any more"));
}

TEST_F(DataCheck, FindsAStretchAtHalfTheRate) {
  write({}, [](std::uint32_t k, Change& c) { c.skip = k >= 100 && k < 160 && k % 2 == 1; });
  const DataReport report = check();
  const DataFinding f = only(report, "half_rate", "/imu/data");
  EXPECT_EQ(report.findings.size(), 1U);
  EXPECT_NEAR(f.value, 50, 0.5);
  EXPECT_NEAR(f.t_s, 1.02, 1e-9);
  EXPECT_THAT(f.text, HasSubstr("0.600 s at 50 Hz in place of 100 Hz"));
}

TEST_F(DataCheck, FindsCloudsThatAreIncomplete) {
  write([](std::uint32_t k, Change& c) {
    if (k == 25) c.points = 750;  // the last quarter of the turn did not come
  });
  const DataFinding f = only(check(), "incomplete", "/lidar/points");
  EXPECT_EQ(f.value, 750);
  EXPECT_NEAR(f.t_s, 2.5, 1e-9);
  EXPECT_THAT(f.text, HasSubstr("of usually 360"));
}

TEST_F(DataCheck, FindsIntensitiesThatJump) {
  write([](std::uint32_t k, Change& c) {
    if (k >= 30) c.intensity *= 2;
  });
  const DataFinding f = only(check(), "intensity", "/lidar/points");
  EXPECT_NEAR(f.t_s, 3.0, 1e-9);
  EXPECT_GT(f.value, 40);
}

TEST_F(DataCheck, FindsFramesWithoutAPlace) {
  write([](std::uint32_t, Change& c) { c.frame = "velodyne"; });
  EXPECT_THAT(only(check(), "frame", "/lidar/points").text,
              HasSubstr("the frame velodyne is not in the tree"));
}

TEST_F(DataCheck, FindsTwoParentsTwoTreesAndCycles) {
  write({}, {}, {}, [](msg::TFMessage&, msg::TFMessage& moving, std::uint32_t k) {
    if (k == 200) moving.transforms[0].header.frame_id = "odom";
  });
  EXPECT_THAT(only(check(), "frame", "/tf").text, HasSubstr("two parents, map and odom"));
  write({}, {}, {}, [](msg::TFMessage& fixed, msg::TFMessage&, std::uint32_t k) {
    if (k == 0) fixed.transforms[1].header.frame_id = "elsewhere";
  });
  EXPECT_THAT(only(check(), "frame", "/imu/data").text, HasSubstr("in the tree of elsewhere"));
  write({}, {}, {}, [](msg::TFMessage& fixed, msg::TFMessage&, std::uint32_t k) {
    if (k > 0) return;
    fixed.transforms[1].header.frame_id = "lidar";
    fixed.transforms[0].header.frame_id = "imu";
  });
  bool found = false;
  const DataReport cyclic = check();
  for (const DataFinding& f : cyclic.findings) found |= f.text.find("its own ancestor") != std::string::npos;
  EXPECT_TRUE(found);
}

TEST_F(DataCheck, FindsTransformsWhoseStampsRepeatOrRunBack) {
  write({}, {}, {}, [](msg::TFMessage&, msg::TFMessage& moving, std::uint32_t k) {
    if (k == 100) moving.transforms[0].header.stamp = record::to_time(kBegin + 990 * kMillisecond);
    if (k == 300) moving.transforms[0].header.stamp = record::to_time(kBegin);
  });
  const DataReport report = check();
  ASSERT_EQ(report.findings.size(), 2U);
  EXPECT_EQ(report.findings[0].kind, "stamp_repeated");
  EXPECT_EQ(report.findings[1].kind, "stamp_back");
}

TEST_F(DataCheck, FindsClocksThatDifferAndStampsThatAreNotSet) {
  constexpr std::int64_t kUptime = kBegin - 5'000'000'000;
  write([](std::uint32_t, Change& c) { c.stamp_ns -= kUptime; });
  EXPECT_THAT(only(check(), "clock", "/lidar/points").text, HasSubstr("of different clocks"));
  write([](std::uint32_t k, Change& c) {
    if (k == 10) c.log_ns += 2000 * kMillisecond;
  });
  EXPECT_NEAR(only(check(), "clock", "/lidar/points").value, 2.003, 1e-6);
  write([](std::uint32_t k, Change& c) {
    if (k == 10) c.log_ns -= 60 * kMillisecond;
  });
  EXPECT_THAT(only(check(), "clock", "/lidar/points").text, HasSubstr("0.057 s after the log time"));
  write([](std::uint32_t, Change& c) { c.stamp_ns = 0; });
  EXPECT_EQ(only(check(), "stamp_unset", "/lidar/points").value, 40);
}

TEST_F(DataCheck, FindsDamageAndGoesOnBehindIt) {
  write();
  std::string bytes;
  {
    std::ifstream in(path_, std::ios::binary);
    bytes.assign(std::istreambuf_iterator<char>(in), {});
  }
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x20);
  std::ofstream(path_, std::ios::binary) << bytes;
  DataReport report = check();
  EXPECT_EQ(report.counts["damage"], 1U) << "one chunk";
  EXPECT_GT(report.messages, 700U);
  std::ofstream(path_, std::ios::binary) << bytes.substr(0, bytes.size() / 3);
  report = check();
  EXPECT_GE(report.counts["damage"], 1U) << "cut short";
  EXPECT_GT(report.messages, 100U);
}

TEST_F(DataCheck, ListsTheFirstOfManyAndCountsTheOthers) {
  write({}, [](std::uint32_t k, Change& c) {
    if (k % 4 == 3) c.stamp_ns -= 10 * kMillisecond;
  });
  DataReport report = check();
  EXPECT_EQ(report.counts["stamp_repeated"], 100U);
  EXPECT_EQ(report.not_listed, (100 - kListed) + (report.counts["gap"] - kListed));
}

TEST_F(DataCheck, RefusesWhatIsNoRecordingOfRos2) {
  EXPECT_EQ(check_data("no-such-file.mcap").error().code, ErrorCode::not_found);
  std::ofstream(path_) << "hello";
  EXPECT_EQ(check_data(path_).error().code, ErrorCode::bad_input);
  {
    auto writer = must(record::McapWriter::open(must(record::open_file_sink(path_))));
    const auto schema = must(writer->add_schema("a", "jsonschema", "{}"));
    const auto id = must(writer->add_channel({.schema = schema, .topic = "/a", .message_encoding = "json"}));
    const std::string text = "{}";
    must(writer->write({id, 0, 1, 1}, std::as_bytes(std::span(text))));
    must(writer->close());
  }
  EXPECT_THAT(check_data(path_).error().text(), HasSubstr("expected messages of ROS 2"));
}

}  // namespace
}  // namespace rigor

// One sample of each kind, with every field set to something of its own.
#pragma once

#include "sensor-hal/record/sample_codec.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record::test {

inline constexpr Duration kToUtc{1'700'000'000'000'000'000};

inline Stamp some_stamp(std::uint64_t sequence) {
  Stamp stamp;
  stamp.sequence = sequence;
  stamp.t_capture = BenchTime(5'000'000'001 + static_cast<std::int64_t>(sequence) * 10'000'000);
  stamp.t_release = stamp.t_capture + milliseconds(3);
  stamp.t_arrival = stamp.t_capture + microseconds(3500);
  stamp.sigma_capture = nanoseconds(1234);
  stamp.lost_before = 2;
  stamp.validity = kSaturated | kClockUnsure;
  return stamp;
}

inline void fill_noise(Sample& sample, std::size_t size, std::uint32_t seed) {
  sample.reserve(size);
  const auto bytes = noise(size, seed);
  if (size > 0) std::memcpy(sample.memory().data(), bytes.data(), size);
  sample.size_bytes = size;
}

inline Sample image_sample(PixelFormat format, std::uint32_t width = 64, std::uint32_t height = 48) {
  Sample s;
  s.stamp = some_stamp(7);
  s.info = ImageInfo{format, width, height, 16, 8, microseconds(123), 1.0 / 3};
  fill_noise(s, image_bytes(format, width, height), 11);
  return s;
}

inline std::vector<Sample> samples_of(SampleKind kind) {
  std::vector<Sample> all;
  const auto add = [&](auto info, std::size_t size) {
    Sample s;
    s.stamp = some_stamp(all.size() + 1);
    s.info = info;
    fill_noise(s, size, 3);
    all.push_back(std::move(s));
  };
  switch (kind) {
    case SampleKind::none:
      add(std::monostate{}, 0);
      break;
    case SampleKind::image:
      for (const PixelFormat f : kPixelFormats) all.push_back(image_sample(f));
      all.push_back(image_sample(PixelFormat::mono12p, 3, 3));
      add(ImageInfo{}, 0);
      break;
    case SampleKind::range_image:
      add(RangeImageInfo{20, 30}, 20 * 30 * 4 * 2);
      add(RangeImageInfo{20, 30}, 20 * 30 * 4);  // without amplitudes
      break;
    case SampleKind::point_cloud:
      add(PointCloudInfo{100}, 100 * sizeof(LidarPoint));
      add(PointCloudInfo{0}, 0);
      break;
    case SampleKind::can_frame: {
      CanFrame f{0x1abcdef0, true, false, false, false, false, 8, {}};
      for (std::uint8_t i = 0; i < 8; ++i) f.data[i] = static_cast<std::uint8_t>(i * 31);
      add(f, 0);
      add(CanFrame{0x7ff, false, true, false, false, false, 3, {}}, 0);
      add(CanFrame{0x20000001, false, false, true, false, false, 8, {1, 2}}, 0);
      f.fd = f.bit_rate_switch = true;
      f.length = 64;
      for (std::uint8_t i = 0; i < 64; ++i) f.data[i] = static_cast<std::uint8_t>(255 - i);
      add(f, 0);
      f = CanFrame{1, false, false, false, true, false, 0, {}};
      add(f, 0);
      break;
    }
    case SampleKind::register_block: {
      RegisterBlock b;
      b.count = 3;
      b.value = {0.1, -1e300, 65535};
      add(b, 0);
      add(RegisterBlock{}, 0);
      break;
    }
    case SampleKind::pose:
      add(Pose{{1e6 / 3, -2, 3}, {0.5, -0.5, 0.5, -0.5}}, 0);
      break;
    case SampleKind::event: {
      EventInfo e{42, -0.5, {}};
      std::strcpy(e.text.data(), "prüfen");
      add(e, 0);
      break;
    }
    case SampleKind::imu:
      add(ImuSample{{0.25, -1.0 / 3, 9.81}, {1e-9, -35, 2.5}, 21.5}, 0);
      add(ImuSample{{1, 2, 3}, {4, 5, 6}}, 0);  // tells no temperature
      break;
    case SampleKind::nav_fix:
      for (const FixStatus status :
           {FixStatus::none, FixStatus::fix, FixStatus::sbas, FixStatus::rtk_float, FixStatus::rtk_fixed})
        add(NavFix{status, 17, 50.123456789, -6.987654321, 512.25, {1, 2, 3, 4, 5, 6, 7, 8, 1.0 / 3}}, 0);
      break;
    case SampleKind::odometry:
      add(Odometry{{{1e3 / 3, -2, 3}, {0.5, -0.5, 0.5, -0.5}},
                   {1, 2, 3},
                   {4, 5, 6},
                   {11, 12, 13, 14, 15, 16},
                   {21, 22, 23, 24, 25, 26},
                   {-100.5, 200.25},
                   {7.5, -8.5}},
          0);
      break;
  }
  return all;
}

inline SampleChannel channel_of(SampleKind kind) {
  return {.name = "dut",
          .topic = "/dut/data",
          .frame_id = "dut_frame",
          .kind = kind,
          .register_names = {"a", "b", "c"},
          .register_units = {"V", "A", "1"},
          .to_utc = kToUtc};
}

/// Puts the streams of an encoder into a recording and writes samples to them.
class SampleWriter {
 public:
  SampleWriter(McapWriter& writer, const SampleChannel& channel) : writer_(&writer), encoder_(channel) {
    for (const SampleStream& stream : encoder_.streams()) {
      const auto schema =
          must(writer.add_schema(std::string(stream.type), "ros2msg", schema_text(stream.type)));
      channels_.push_back(must(writer.add_channel(
          {.schema = schema, .topic = stream.topic, .metadata = {{"offered_qos_profiles", ""}}})));
    }
  }
  void write(const Sample& sample) {
    for (const SampleMessage& m : must(encoder_.encode(sample))) {
      const auto t = static_cast<std::uint64_t>((sample.stamp.t_release + kToUtc).ns());
      must(writer_->write({channels_[m.stream], static_cast<std::uint32_t>(sample.stamp.sequence), t, t},
                          m.pieces));
    }
  }

 private:
  McapWriter* writer_;
  SampleEncoder encoder_;
  std::vector<std::uint16_t> channels_;
};

}  // namespace rigor::record::test

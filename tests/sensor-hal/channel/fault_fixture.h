// A source of samples of any kind whose content is a formula, and a run of it behind faults, cycle by cycle.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>

#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/stream_source.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::test {

inline constexpr SampleKind kRegisters = SampleKind::register_block;

/// In virtual time: a sample at each instant of its grid. Registers a = index, b = 100; frames of id 0x123
/// with byte i = index + i; poses, units, fixes and odometry that are as good as at rest; pictures of
/// `format` with every pixel at a value; clouds of 50 points at 10 m; range images at 5 m.
class FormulaStream final : public StreamSource {
 public:
  explicit FormulaStream(PixelFormat format = PixelFormat::mono8, std::uint32_t width = 32,
                         std::uint32_t height = 24)
      : format_(format), width_(width), height_(height) {}
  ~FormulaStream() override { (void)do_stop(); }
  static constexpr int kPixel = 100;
  static constexpr float kRange_m = 5, kPointRange_m = 10;

  void complete_until(BenchTime now) override {
    for (; running_ && next_ + config().latency <= now; next_ = next_ + config().period) {
      SampleSlot slot = take_slot();
      if (slot) fill(*slot);
      ++index_;
      hand_over(std::move(slot));
    }
  }

 protected:
  Status do_configure(const ChannelConfig& c) override {
    slots_ = static_cast<std::size_t>(c.params.integer_or("slots", 16, {.min = 1, .max = 4096}));
    description_.kind = c.kind;
    if (c.kind == SampleKind::register_block) {
      description_.names = {"a", "b"};
      description_.units = {"", "deg"};
    }
    if (c.kind == SampleKind::image) {
      description_.width_px = width_, description_.height_px = height_, description_.format = format_;
      description_.max_bytes = image_bytes(format_, width_, height_);
    }
    if (c.kind == SampleKind::range_image) {
      description_.width_px = width_, description_.height_px = height_;
      description_.max_bytes = std::size_t{width_} * height_ * 2 * sizeof(float);
    }
    if (c.kind == SampleKind::point_cloud) description_.max_bytes = 50 * sizeof(LidarPoint);
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    open_stream(slots_, description_.max_bytes, context.virtual_time);
    return {};
  }
  Status do_start(BenchTime t0) override {
    next_ = t0;
    index_ = 0;
    running_ = true;
    health_.connected = true;
    return {};
  }
  Status do_stop() override {
    running_ = false;
    health_.connected = false;
    close_stream();
    return {};
  }

 private:
  void fill(Sample& s) {
    s.stamp = Stamp{};
    s.stamp.sequence = index_;
    s.stamp.t_capture = next_;
    s.stamp.t_release = s.stamp.t_arrival = next_ + config().latency;
    s.size_bytes = description_.max_bytes;
    switch (config().kind) {
      case SampleKind::register_block: {
        RegisterBlock b;
        b.count = 2;
        b.value[0] = static_cast<double>(index_);
        b.value[1] = 100;
        s.info = b;
        break;
      }
      case SampleKind::can_frame: {
        CanFrame f;
        f.id = 0x123;
        f.length = 8;
        for (std::size_t i = 0; i < 8; ++i) f.data[i] = static_cast<std::uint8_t>(index_ + i);
        s.info = f;
        break;
      }
      case SampleKind::pose:
        s.info = Pose{};
        break;
      case SampleKind::imu:
        s.info = ImuSample{{0, 0, 9.81}, {0, 0, 0}, 20};
        break;
      case SampleKind::nav_fix:
        s.info = NavFix{FixStatus::fix, 9, 50, 6, 100, {}};
        break;
      case SampleKind::odometry:
        s.info = Odometry{};
        break;
      case SampleKind::image: {
        s.info = ImageInfo{format_, width_, height_, 0, 0, milliseconds(1), 0};
        auto* p = reinterpret_cast<std::uint8_t*>(s.memory().data());
        for (std::size_t i = 0; i < s.size_bytes; ++i) p[i] = bytes_of_pixel(i);
        break;
      }
      case SampleKind::range_image: {
        s.info = RangeImageInfo{width_, height_};
        for (std::size_t i = 0; i < std::size_t{width_} * height_ * 2; ++i) {
          const float v = i < std::size_t{width_} * height_ ? kRange_m : 1000;
          std::memcpy(s.memory().data() + i * sizeof v, &v, sizeof v);
        }
        break;
      }
      case SampleKind::point_cloud:
        s.info = PointCloudInfo{50};
        for (std::uint32_t i = 0; i < 50; ++i) {
          const LidarPoint p{kPointRange_m, 0, 0, 0.5F, static_cast<std::int32_t>(i), 0, 0, 0};
          std::memcpy(s.memory().data() + i * sizeof p, &p, sizeof p);
        }
        break;
      case SampleKind::none:
      case SampleKind::event:
        s.info = EventInfo{};
        break;
    }
  }
  /// kPixel in every sample of the format.
  [[nodiscard]] std::uint8_t bytes_of_pixel(std::size_t i) const {
    if (format_ == PixelFormat::mono12p)  // 0x064 0x064
      return std::array<std::uint8_t, 3>{0x64, 0x40, 0x06}[i % 3];
    if (has_words(format_)) return i % 2 == 0 ? kPixel : 0;
    return kPixel;
  }

  PixelFormat format_;
  std::uint32_t width_, height_;
  std::size_t slots_ = 16;
  bool running_ = false;
  BenchTime next_;
  std::uint64_t index_ = 0;
};

inline ChannelConfig fault_config(SampleKind kind, const std::string& faults, const std::string& more = "") {
  ChannelConfig c;
  c.name = "left";
  c.kind = kind;
  c.period = milliseconds(10);
  c.latency = milliseconds(5);
  c.seed = 7;
  const auto node = ConfigDocument::parse("{faults: [" + faults + "]" + more + "}", "rig.yaml");
  if (node)
    c.params = *node;
  else
    ADD_FAILURE() << node.error().text();
  return c;
}

/// A sample, copied.
struct Seen {
  Stamp stamp;
  decltype(Sample::info) info;
  std::vector<std::byte> bytes;
  BenchTime at;  ///< the cycle
};

/// One channel with faults in a loop of 1 kHz in virtual time, behind a port as runs have it.
class FaultRun {
 public:
  explicit FaultRun(SampleKind kind, const std::string& faults, WorkerPool* workers = nullptr,
                    std::unique_ptr<Source> inner = std::make_unique<FormulaStream>(),
                    const std::string& more = "")
      : source(std::move(inner), workers) {
    const auto config = fault_config(kind, faults, more);
    status = source.configure(config);
    if (!status) return;
    ArmContext context;
    context.virtual_time = true;
    status = source.arm(context);
    if (!status) return;
    bench.add(source, 0);
    PortTiming timing;
    timing.period = config.period;
    timing.tolerance = milliseconds(1);
    timing.lost_after = milliseconds(100);
    port.configure(timing, BenchTime(0));
    status = source.start(BenchTime(0));
  }
  /// Runs until this instant; appends to `seen`, `events`, `statuses`.
  void until(Duration end) {
    for (; cycle * milliseconds(1) < end; ++cycle) {
      const BenchTime now = BenchTime(0) + cycle * milliseconds(1);
      bench.begin_cycle(now);
      source.complete_until(now);
      for (FaultChange c; bench.poll_change(c);) events.push_back(c.event->as<EventInfo>()->text.data());
      while (SampleLease s = source.poll(now)) {
        seen.push_back({s->stamp, s->info, {s->bytes().begin(), s->bytes().end()}, now});
        port.push(std::move(s));
      }
      port.advance(now, source.health().connected);
      statuses.push_back(port.status());
      source.begin_cycle(now);
    }
  }
  [[nodiscard]] const Fault& fault(std::size_t i) const { return *source.faults().scheduled().at(i); }
  void expect_accounted() const {
    const auto& a = source.accounts();
    EXPECT_EQ(a.taken, a.handed_on + a.dropped + a.disconnected + a.no_slot + a.waiting);
  }
  [[nodiscard]] std::vector<std::uint64_t> sequences() const {
    std::vector<std::uint64_t> all;
    for (const Seen& s : seen) all.push_back(s.stamp.sequence);
    return all;
  }
  /// Register 0 or 1 of each sample.
  [[nodiscard]] std::vector<double> values(std::size_t i) const {
    std::vector<double> all;
    for (const Seen& s : seen) all.push_back(std::get<RegisterBlock>(s.info).value[i]);
    return all;
  }
  [[nodiscard]] bool showed(PortStatus wanted, Duration from, Duration to) const {
    for (auto k = static_cast<std::size_t>(from / milliseconds(1));
         k < static_cast<std::size_t>(to / milliseconds(1)); ++k)
      if (statuses.at(k) == wanted) return true;
    return false;
  }

  FaultySource source;
  FaultBench bench;
  Port<Sample> port;
  Status status;
  std::int64_t cycle = 0;
  std::vector<Seen> seen;
  std::vector<std::string> events;
  std::vector<PortStatus> statuses;
};

}  // namespace rigor::test

// A backend whose samples are known in advance, of any kind: number n of a channel is a function of the kind,
// of n and of the channel's size, so that whoever receives it can tell whether it is whole.
#pragma once

#include <algorithm>
#include <cstring>
#include <memory>

#include "sensor-hal/channel/registry.h"
#include "sensor-hal/channel/slot_wait.h"
#include "sensor-hal/config/rate.h"

namespace rigor::test {

/// Keys: width_px, height_px (images, range images), point_count (clouds).
class MadeSource final : public Source {
 public:
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override {
    if (t_next_ > now) return {};
    SampleSlot slot = slot_wait_.acquire(*pool_);
    const BenchTime t = t_next_;
    const std::uint64_t n = n_++;
    t_next_ = t0_ + config().period * static_cast<std::int64_t>(n_);
    if (!slot) {
      health_.no_slot.fetch_add(1, std::memory_order_relaxed);
      return {};
    }
    health_.received.fetch_add(1, std::memory_order_relaxed);
    fill(*slot, n);
    slot->stamp = {};
    slot->stamp.sequence = n;
    slot->stamp.t_capture = slot->stamp.t_arrival = t;
    slot->stamp.t_release = t + config().latency;
    return slot;
  }

  static std::uint8_t pixel(std::uint64_t n, std::size_t i) {
    return static_cast<std::uint8_t>(n * 7 + i + (i >> 8));
  }

 private:
  void fill(Sample& s, std::uint64_t n) const {
    const double v = static_cast<double>(n);
    s.size_bytes = 0;
    switch (config().kind) {
      case SampleKind::image: {
        ImageInfo info;
        info.width_px = description_.width_px;
        info.height_px = description_.height_px;
        s.info = info;
        s.size_bytes = description_.max_bytes;
        // A memset by rows: the pattern need not be costly to make.
        for (std::size_t y = 0; y < info.height_px; ++y)
          std::memset(s.memory().data() + y * info.width_px, pixel(n, y), info.width_px);
        break;
      }
      case SampleKind::range_image: {
        s.info = RangeImageInfo{description_.width_px, description_.height_px};
        s.size_bytes = description_.max_bytes;
        auto* values = reinterpret_cast<float*>(s.memory().data());
        for (std::size_t i = 0; i < s.size_bytes / sizeof(float); ++i)
          values[i] = static_cast<float>(n) + static_cast<float>(i) * 0.25f;
        break;
      }
      case SampleKind::point_cloud: {
        const std::size_t count = description_.max_bytes / sizeof(LidarPoint);
        s.info = PointCloudInfo{static_cast<std::uint32_t>(count)};
        s.size_bytes = description_.max_bytes;
        auto* points = reinterpret_cast<LidarPoint*>(s.memory().data());
        for (std::size_t i = 0; i < count; ++i)
          points[i] = {static_cast<float>(i),
                       static_cast<float>(n),
                       0.5f,
                       10.0f,
                       static_cast<std::int32_t>(i),
                       static_cast<std::uint16_t>(i % 16),
                       0,
                       0};
        break;
      }
      case SampleKind::can_frame: {
        CanFrame f;
        f.id = 0x100 + static_cast<std::uint32_t>(n % 7);
        f.length = 8;
        f.data.fill(static_cast<std::uint8_t>(n));
        s.info = f;
        break;
      }
      case SampleKind::register_block: {
        RegisterBlock b;
        b.count = 2;
        b.value[0] = v;
        b.value[1] = -v;
        s.info = b;
        break;
      }
      case SampleKind::pose:
        s.info = Pose{{v, 1, 2}, {1, 0, 0, 0}};
        break;
      case SampleKind::event: {
        EventInfo e{7, v, {}};
        std::strcpy(e.text.data(), "made");
        s.info = e;
        break;
      }
      case SampleKind::imu:
        s.info = ImuSample{{v, 0, 9.81}, {0.1, 0.2, v * 0.01}, 21.5};
        break;
      case SampleKind::nav_fix:
        s.info = NavFix{FixStatus::rtk_fixed, 12, 48.1, 11.5, 500 + v, {1, 0, 0, 0, 1, 0, 0, 0, 4}};
        break;
      case SampleKind::odometry: {
        Odometry o;
        o.T_odom_base.position_m = {v, 0, 0};
        o.velocity_mps = {1, 0, 0};
        o.wheel_angle_rad = {v, v};
        s.info = o;
        break;
      }
      case SampleKind::none:
        break;
    }
  }

  Status do_configure(const ChannelConfig& config) override {
    description_ = {};
    description_.kind = config.kind;
    description_.frame_id = config.name + "_frame";
    const auto size = [&](const char* key, std::int64_t usual) {
      return static_cast<std::uint32_t>(config.params.integer_or(key, usual, {.min = 1, .max = 1 << 20}));
    };
    const std::uint32_t width = size("width_px", 64), height = size("height_px", 48),
                        points = size("point_count", 1000);
    if (config.kind == SampleKind::image || config.kind == SampleKind::range_image) {
      description_.width_px = width;
      description_.height_px = height;
      description_.max_bytes = std::size_t{width} * height;
      if (config.kind == SampleKind::range_image) description_.max_bytes *= 2 * sizeof(float);
    }
    if (config.kind == SampleKind::point_cloud) description_.max_bytes = points * sizeof(LidarPoint);
    if (config.kind == SampleKind::register_block) {
      description_.names = {"n", "minus_n"};
      description_.units = {"", ""};
    }
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    slot_wait_.begin(context.virtual_time);
    pool_ = make_sample_pool(16, description_.max_bytes);
    return {};
  }
  Status do_start(BenchTime t0) override {
    t0_ = t_next_ = t0;
    n_ = 0;
    health_.connected = true;
    return {};
  }
  Status do_stop() override { return {}; }

  std::unique_ptr<SamplePool> pool_;
  SlotWait slot_wait_;
  BenchTime t0_, t_next_;
  std::uint64_t n_ = 0;
};

inline Backend made_backend() {
  Backend b;
  b.name = "made";
  b.summary = "samples that are known in advance";
  b.same_in_virtual_time = true;
  b.gives_typed_samples = true;
  b.make_source = [] { return std::make_unique<MadeSource>(); };
  return b;
}

}  // namespace rigor::test

// Plain parts for tests of channels: a picture that is a formula, a joint that turns, a temporary file.
#pragma once

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>

#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/channel/simulated_source.h"

namespace rigor::test {

/// Every byte depends on capture index, instant, joint and place.
class FormulaImages final : public ImageProvider {
 public:
  explicit FormulaImages(std::uint32_t width = 64, std::uint32_t height = 48, int offset_dn = 0)
      : width_(width), height_(height), offset_dn_(offset_dn) {}

  Geometry geometry() const override {
    return {width_, height_, PixelFormat::mono8, milliseconds(2), "test_optical"};
  }
  Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    if (busy_.exchange(true)) return fail(ErrorCode::internal, "test", "two threads in one provider");
    const auto slow = delay_us.load();
    if (slow > 0) std::this_thread::sleep_for(std::chrono::microseconds(slow));
    const bool broken = fail_at.load() >= 0 && r.index == static_cast<std::uint64_t>(fail_at.load());
    fill(r, pixels, offset_dn_);
    busy_ = false;
    if (broken) return fail(ErrorCode::internal, "test", "planned");
    return {};
  }
  static void fill(const ImageRequest& r, std::span<std::byte> pixels, int offset_dn) {
    const double q = r.motion.count > 0 ? r.motion.joint[0].at(r.t_capture) : 0;
    const auto seed = static_cast<std::uint64_t>(r.t_capture.ns() / 1000) * 7 +
                      static_cast<std::uint64_t>(q * 1e6) + r.index * 13;
    for (std::size_t i = 0; i < pixels.size(); ++i)
      pixels[i] = static_cast<std::byte>(static_cast<int>((seed + i * 31 + i / 64 * 5) % 200) + offset_dn);
  }

  std::atomic<int> delay_us{0};
  std::atomic<std::int64_t> fail_at{-1};

 private:
  std::uint32_t width_, height_;
  int offset_dn_;
  std::atomic<bool> busy_{false};
};

/// Point clouds of a number of points that depends on the index; range images of a fixed size.
class FormulaSamples final : public SampleProvider {
 public:
  explicit FormulaSamples(SampleKind kind) : kind_(kind) {}
  static constexpr std::uint32_t kWidth = 16, kHeight = 12, kMaxPoints = 100;

  Geometry geometry() const override {
    if (kind_ == SampleKind::point_cloud) return {kind_, 0, 0, kMaxPoints * sizeof(LidarPoint), "scanner"};
    return {kind_, kWidth, kHeight, std::size_t{kWidth} * kHeight * 2 * sizeof(float), "tof_optical"};
  }
  Status capture(const Request& r, Sample& sample) override {
    if (busy_.exchange(true)) return fail(ErrorCode::internal, "test", "two threads in one provider");
    if (const auto slow = delay_us.load(); slow > 0)
      std::this_thread::sleep_for(std::chrono::microseconds(slow));
    last = r;
    const double q = r.motion.count > 0 ? r.motion.joint[0].at(r.t_capture) : 0;
    const auto value = [&](std::size_t i) {
      return static_cast<float>(q) + static_cast<float>(i) * 0.01F + static_cast<float>(r.index);
    };
    if (kind_ == SampleKind::point_cloud) {
      const auto count = static_cast<std::uint32_t>(kMaxPoints - r.index % 7);
      for (std::uint32_t i = 0; i < count; ++i) {
        const LidarPoint p{value(i), 1, 2, 0.5F, static_cast<std::int32_t>(i), 3, 0, 0};
        std::memcpy(sample.memory().data() + i * sizeof p, &p, sizeof p);
      }
      sample.info = PointCloudInfo{count};
      sample.size_bytes = count * sizeof(LidarPoint);
    } else {
      for (std::size_t i = 0; i < std::size_t{kWidth} * kHeight * 2; ++i) {
        const float v = value(i);
        std::memcpy(sample.memory().data() + i * sizeof v, &v, sizeof v);
      }
      sample.info = RangeImageInfo{kWidth, kHeight};
      sample.size_bytes = std::size_t{kWidth} * kHeight * 2 * sizeof(float);
    }
    busy_ = false;
    return {};
  }

  std::atomic<int> delay_us{0};
  Request last;

 private:
  SampleKind kind_;
  std::atomic<bool> busy_{false};
};

class TurningJoint final : public MotionSource {
 public:
  WorldMotion motion_at(BenchTime t) const noexcept override {
    WorldMotion m;
    m.count = 1;
    m.joint[0] = {BenchTime(0), 0.25, 0.5};
    (void)t;
    return m;
  }
};

inline ChannelConfig image_config(const std::string& params, Period period = milliseconds(10),
                                  Duration latency = milliseconds(12), std::string name = "left") {
  ChannelConfig c;
  c.name = std::move(name);
  c.kind = SampleKind::image;
  c.period = period;
  c.latency = latency;
  c.seed = 1;
  if (auto node = ConfigDocument::parse(params.empty() ? "{}" : params, "test.yaml")) c.params = *node;
  return c;
}

inline ChannelConfig sample_config(SampleKind kind, const std::string& params) {
  ChannelConfig c = image_config(params);
  c.name = "scanner";
  c.kind = kind;
  return c;
}

/// A directory that goes with the object.
class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    auto name = (std::filesystem::temp_directory_path() / "rigor-test-XXXXXX").string();
    if (mkdtemp(name.data())) path_ = name;
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  [[nodiscard]] std::string file(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

}  // namespace rigor::test

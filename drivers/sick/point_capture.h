// The points of one scan of an emulated scanner, from whatever measures for it.
#pragma once

#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "sensor-hal/channel/emulator.h"

namespace rigor::sick {

/// One thread. Takes its memory when it is made.
class PointCapture {
 public:
  explicit PointCapture(const DeviceParts& parts) : samples_(parts.samples), motion_(parts.motion) {
    sample_.reserve(samples_->geometry().max_bytes);
  }
  /// Blocks. Valid until the next call; empty when the sensor failed.
  [[nodiscard]] std::optional<std::span<const LidarPoint>> points(std::uint64_t index, BenchTime t_capture,
                                                                  BenchTime t_start) {
    SampleProvider::Request r;
    r.index = index;
    r.t_capture = t_capture;
    r.t_start = t_start;
    if (motion_) r.motion = motion_->motion_at(t_capture);
    if (!samples_->capture(r, sample_)) return std::nullopt;
    const Sample& s = sample_;
    const auto* info = s.as<PointCloudInfo>();
    if (!info || s.bytes().size() < info->count * sizeof(LidarPoint)) return std::nullopt;
    points_.resize(info->count);
    if (info->count > 0) std::memcpy(points_.data(), s.bytes().data(), info->count * sizeof(LidarPoint));
    return std::span<const LidarPoint>(points_);
  }

 private:
  std::shared_ptr<SampleProvider> samples_;
  std::shared_ptr<const MotionSource> motion_;
  Sample sample_;
  std::vector<LidarPoint> points_;
};

}  // namespace rigor::sick

#include "sim/sensors/camera/exposure_timing.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace rigor {
namespace {
constexpr int kPoses = 17;
}

ExposureTiming::ExposureTiming(const CameraModel& camera, const OpticsRequest& request)
    : rows_before_centre_(0.5 * (camera.height_px - 1)),
      line_time_s_(camera.shutter.line_time_s),
      t_capture_(request.measure.t_capture) {
  const double exposure_s = camera.shutter.motion_blur ? request.exposure_s : 0.0;
  const double half_s = rows_before_centre_ * line_time_s_ + 0.5 * exposure_s;
  begin_ = t_capture_ - seconds_from(half_s);
  end_ = t_capture_ + seconds_from(half_s);
  span_s_ = (end_ - begin_).seconds();
  if (span_s_ > 0) exposure_share_ = std::min(exposure_s / span_s_, 1.0);
}

double ExposureTiming::middle_of(int row) const {
  if (!(span_s_ > 0)) return 0;
  return std::clamp(0.5 + (row - rows_before_centre_) * line_time_s_ / span_s_, 0.0, 1.0);
}
BenchTime ExposureTiming::instant_of(int row) const {
  return t_capture_ + seconds_from((row - rows_before_centre_) * line_time_s_);
}
BenchTime ExposureTiming::at(double share) const { return begin_ + seconds_from(share * span_s_); }

Result<SensorMotion> SensorMotion::of(const render::PoseFunction& pose, const ExposureTiming& timing) {
  SensorMotion m;
  const int n = timing.one_instant() ? 1 : kPoses;
  for (int i = 0; i < n; ++i) {
    m.poses_.push_back(pose(n == 1 ? timing.begin() : timing.at(static_cast<double>(i) / (n - 1))));
    const Eigen::Matrix3d r = m.poses_.back().linear();
    if (!m.poses_.back().matrix().allFinite() || !(r.transpose() * r).isIdentity(1e-6))
      return fail(ErrorCode::bad_input, "T_world_sensor", "expected a finite place and a rotation");
  }
  if (std::all_of(m.poses_.begin(), m.poses_.end(),
                  [&](const Eigen::Isometry3d& p) { return p.matrix() == m.poses_.front().matrix(); }))
    m.poses_.resize(1);
  return m;
}

Eigen::Isometry3d SensorMotion::at(double share) const {
  if (still()) return poses_.front();
  const double x = std::clamp(share, 0.0, 1.0) * static_cast<double>(poses_.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(x), poses_.size() - 2);
  const double w = x - static_cast<double>(i);
  const Eigen::Isometry3d &a = poses_[i], &b = poses_[i + 1];
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  t.linear() = Eigen::Quaterniond(a.linear()).slerp(w, Eigen::Quaterniond(b.linear())).toRotationMatrix();
  t.translation() = (1 - w) * a.translation() + w * b.translation();
  return t;
}

Result<OpticsRequest::Region> region_of(const CameraModel& camera, const OpticsRequest::Region& region) {
  if (region.width_px == 0) return OpticsRequest::Region{0, 0, camera.width_px, camera.height_px};
  if (region.x_px < 0 || region.y_px < 0 || region.width_px < 1 || region.height_px < 1 ||
      region.x_px > camera.width_px - region.width_px || region.y_px > camera.height_px - region.height_px)
    return fail(ErrorCode::bad_input, "region",
                "expected a region within " + std::to_string(camera.width_px) + "x" +
                    std::to_string(camera.height_px) + " px, got " + std::to_string(region.width_px) + "x" +
                    std::to_string(region.height_px) + " at " + std::to_string(region.x_px) + ", " +
                    std::to_string(region.y_px));
  return region;
}

}  // namespace rigor

// When the rows of a picture expose, and where the sensor is meanwhile. Internal to sim/sensors/camera.
#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "sensor-hal/models/camera_model.h"
#include "sim/render/engine/content_window.h"
#include "sim/sensors/camera/camera_optics_picture.h"

namespace rigor {

/// Row i of the full sensor exposes around t_capture + (i − (height − 1)/2)·line_time, for the whole exposure
/// where motion blurs, else in one instant.
class ExposureTiming {
 public:
  ExposureTiming(const CameraModel& camera, const OpticsRequest& request);

  [[nodiscard]] BenchTime begin() const { return begin_; }
  [[nodiscard]] BenchTime end() const { return end_; }
  [[nodiscard]] bool one_instant() const { return !(end_ > begin_); }
  /// Middle of a row's exposure: 0 at begin … 1 at end.
  [[nodiscard]] double middle_of(int row) const;
  /// Length of an exposure as a share of the window.
  [[nodiscard]] double exposure_share() const { return exposure_share_; }
  [[nodiscard]] BenchTime instant_of(int row) const;
  [[nodiscard]] BenchTime at(double share) const;

 private:
  double rows_before_centre_, line_time_s_, span_s_ = 0, exposure_share_ = 0;
  BenchTime t_capture_, begin_, end_;
};

/// The sensor's pose over an exposure, from a few calls of the pose function: linear between them, rotations
/// by slerp.
class SensorMotion {
 public:
  /// `pose` is called on this thread. Errors: bad_input (a pose that is not finite).
  [[nodiscard]] static Result<SensorMotion> of(const render::PoseFunction& pose,
                                               const ExposureTiming& timing);

  [[nodiscard]] bool still() const { return poses_.size() == 1; }
  /// At a share of the window, 0 to 1.
  [[nodiscard]] Eigen::Isometry3d at(double share) const;
  [[nodiscard]] Eigen::Vector3d middle() const { return at(0.5).translation(); }

 private:
  std::vector<Eigen::Isometry3d> poses_;
};

/// The rows and columns asked for, resolved. Errors: bad_input (not within the sensor).
[[nodiscard]] Result<OpticsRequest::Region> region_of(const CameraModel& camera,
                                                      const OpticsRequest::Region& region);

}  // namespace rigor

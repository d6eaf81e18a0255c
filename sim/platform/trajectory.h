// A body on a path through poses at instants: positions by a spline, orientations between.
//
// Velocity, acceleration and turn rate are derivatives of the pose itself, exactly: what an inertial sensor
// on the body measures belongs to what a camera on it sees. Acceleration of the position and turn rate are
// continuous, the acceleration of turning is not at the poses: there the rotation vector from the pose
// before, which is a cubic polynomial within each span, passes into the next.
//
//   cubic     velocities at the poses by a natural cubic spline: acceleration is continuous, zero at the ends
//   quintic   velocities and accelerations at the poses as the cubic spline has them, and a polynomial of
//   fifth
//             degree between; ends at rest: for vehicles that set out and stop softly
#pragma once

#include <atomic>
#include <filesystem>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "sim/platform/platform.h"

namespace rigor {

struct TimedPose {
  double t_s = 0;  ///< since the start of the run
  Pose T_world_body;
};

enum class PathSpline : std::uint8_t { cubic, quintic };

/// Immutable once made; any thread, no allocation after setup.
class Trajectory {
 public:
  /// bad_input: fewer than two poses, times that do not grow, values that are not finite.
  [[nodiscard]] static Result<Trajectory> make(std::span<const TimedPose> poses,
                                               PathSpline spline = PathSpline::cubic);
  /// Before the first pose and after the last it stands there.
  [[nodiscard]] BodyState at(double t_s, BenchTime t) const noexcept;
  [[nodiscard]] double length_s() const noexcept { return t_s_.back(); }

 private:
  std::vector<double> t_s_;
  std::vector<Eigen::Vector3d> position_m_, velocity_mps_, acceleration_mps2_;
  std::vector<Eigen::Quaterniond> q_;
  std::vector<Eigen::Vector3d> turn_rate_radps_;  ///< at the poses, in the body's axes
  PathSpline spline_ = PathSpline::cubic;
};

/// A path from lines `t_s,x_m,y_m,z_m,qw,qx,qy,qz` or `t_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg` under a
/// line that names the columns; `#` begins a remark. not_found; bad_input with file and line.
[[nodiscard]] Result<std::vector<TimedPose>> read_poses_csv(const std::filesystem::path& file);

/// A body that nobody commands. Signals: the truth x_m, y_m, z_m [m], roll_deg, pitch_deg, yaw_deg [deg].
/// No joints. Its past is as exact as its presence.
class TrajectoryPlatform final : public Platform {
 public:
  explicit TrajectoryPlatform(Trajectory trajectory);
  void start(BenchTime t0) override;
  [[nodiscard]] PlatformMotion motion_at(BenchTime t) const noexcept override;
  [[nodiscard]] const std::vector<std::string>& joint_names() const override;
  [[nodiscard]] std::vector<PlatformPart> parts() const override { return {}; }
  [[nodiscard]] const std::vector<Signal>& signals() const override;
  [[nodiscard]] double read(std::size_t signal, BenchTime t) override;
  [[nodiscard]] bool write(std::size_t, double, BenchTime) override { return false; }
  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override;
  [[nodiscard]] bool write(RegisterTable, std::uint16_t, std::span<const std::uint16_t>, BenchTime) override {
    return false;
  }

 private:
  Trajectory trajectory_;
  std::atomic<std::int64_t> t0_;
};

}  // namespace rigor

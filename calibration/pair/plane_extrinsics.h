// Where one sensor sits relative to another, from boards that both saw: the camera knows the
// board's plane, the sensor (LiDAR, time-of-flight camera) has points on it.
//
// Residual of a point p of the sensor on view v, in standard deviations:
//
//   (n_v · (R p + t) − d_v) / sigma_p,        n_v · x = d_v the board's plane in the camera's frame
//
// The planes themselves are uncertain: each is solved for (two tilts and a distance) and tied to what the
// camera said of it by its covariance. Source of the constraint: Zhang & Pless, IROS 2004.
//
// A scanner measures while the board moves: a point is compared with the board where it was at the point's
// own instant, by the rate with which the camera saw it move.
//
// One plane leaves three directions free, two that meet leave one (along their common line), and all planes
// with normals in one plane leave one: they are named, with the view that would help.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

/// What both sensors saw of one board.
struct PlaneObservation {
  std::string name;
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();  ///< its plane is z = 0
  /// Of T_camera_board's plane: rotations about its own x and y [rad], shift along its z [m].
  Eigen::Matrix3d plane_covariance = Eigen::Matrix3d::Zero();
  std::vector<Eigen::Vector3d> points_m;  ///< of the board, in the sensor's frame
  std::vector<double> t_s;                ///< of each point, after the camera's picture; empty: all at it
  /// How the board moves in its own frame: rotation vector [rad/s], then shift [m/s].
  Eigen::Matrix<double, 6, 1> rate = Eigen::Matrix<double, 6, 1>::Zero();
  Eigen::Matrix3d plane_rate_covariance = Eigen::Matrix3d::Zero();  ///< as plane_covariance, per second
};
/// From the camera's frame to the board where it was when point i was measured.
[[nodiscard]] Eigen::Isometry3d T_board_camera_at(const PlaneObservation& observation, std::size_t i);

/// A board's pose at an instant, and how sure its plane is.
struct BoardAt {
  double t_s = 0;
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();
  Eigen::Matrix3d plane_covariance = Eigen::Matrix3d::Zero();
};
/// Fills `rate` and `plane_rate_covariance` of a sighting by straight lines through the poses (at least two
/// instants; else nothing is known to move and the rates stay zero). The board may also have been seen turned
/// by half a turn about its middle (at `middle_m` in its frame): patterns repeat. The covariance grows with
/// what the lines do not describe.
void set_rate(PlaneObservation& observation, double t_s, const std::vector<BoardAt>& poses,
              const Eigen::Vector3d& middle_m);

struct PlaneExtrinsicsOptions {
  double sigma_point_m = 0;  ///< noise across the plane; 0: from how flat the points of each view lie
  double reject_sigmas = 4;
  /// Standard uncertainty of a factor on all distances of the camera alike (corners that are all pulled one
  /// way, the focal length), relative; no number of views lowers it.
  double camera_scale_sigma = 0;
  std::optional<Eigen::Isometry3d> start{};  ///< T_camera_sensor; none: from the planes' normals
  StopToken stop{};
};

struct PlaneExtrinsics {
  FitResult result;  ///< x_m, y_m, z_m, and the rotation vector rx_rad, ry_rad, rz_rad
  Eigen::Isometry3d T_camera_sensor = Eigen::Isometry3d::Identity();
  double sigma_point_m = 0;        ///< that was used
  double plane_scale = 1;          ///< the planes were taken as so many times as uncertain as the camera says
  std::vector<double> view_rms_m;  ///< distance of a view's points from its plane
  std::vector<double> view_mean_m;  ///< signed; a bias of the sensor shows here
};

/// bad_input: no view, a view with fewer than three points or points that are not finite. Any thread.
[[nodiscard]] Result<PlaneExtrinsics> fit_plane_extrinsics(const std::vector<PlaneObservation>& observations,
                                                           const PlaneExtrinsicsOptions& options = {});

/// T_camera_sensor that brings the planes' normals and distances together, by Kabsch and linear least
/// squares; what the planes leave free is taken as zero. Exposed for tests.
[[nodiscard]] Eigen::Isometry3d extrinsics_from_normals(const std::vector<PlaneObservation>& observations);

/// Which points are on the board: of `cloud_m` (the sensor's frame) those that lie over the board's
/// outline (board frame: 0 … width, 0 … height, grown by `outline_margin_m`, shrunk where that is negative)
/// and within `margin_m` of its plane as a rough T_camera_sensor has it, and then within 4 robust standard
/// deviations of the plane that most of them make; their indices, increasing. Empty where fewer than `least`
/// are left.
[[nodiscard]] std::vector<std::size_t> points_on_board(const std::vector<Eigen::Vector3d>& cloud_m,
                                                       const Eigen::Isometry3d& T_camera_board,
                                                       const Eigen::Isometry3d& T_camera_sensor,
                                                       const Eigen::Vector2d& size_m, double margin_m,
                                                       double outline_margin_m, std::size_t least = 8);

}  // namespace rigor::calibration

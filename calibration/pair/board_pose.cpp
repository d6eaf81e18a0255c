#include "calibration/pair/board_pose.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/rotation.h>

#include <array>
#include <cmath>

#include "calibration/camera/camera_start.h"
#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

/// A point of the board on the plane z = 1 of the camera, in pixels of its focal lengths.
struct OnUnitPlane {
  double x_m, y_m, xn, yn, fx_px, fy_px;
  template <class T>
  bool operator()(const T* pose, T* residual) const {
    const T p[3] = {T(x_m), T(y_m), T(0)};
    T q[3];
    ceres::AngleAxisRotatePoint(pose, p, q);
    const T z = q[2] + pose[5];
    residual[0] = ((q[0] + pose[3]) / z - xn) * fx_px;
    residual[1] = ((q[1] + pose[4]) / z - yn) * fy_px;
    return true;
  }
};

Eigen::Isometry3d isometry(const std::array<double, 6>& pose) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  const Eigen::Vector3d r(pose[0], pose[1], pose[2]);
  if (r.norm() > 0) T.linear() = Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
  T.translation() = Eigen::Vector3d(pose[3], pose[4], pose[5]);
  return T;
}

/// The plane's change in its own frame: rotations about x and y, shift along z.
Eigen::Vector3d plane_change(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
  const Eigen::Isometry3d d = from.inverse() * to;
  const Eigen::AngleAxisd turn(d.linear());
  return {turn.axis().x() * turn.angle(), turn.axis().y() * turn.angle(), d.translation().z()};
}

}  // namespace

Result<BoardPose> pose_of_board(const BoardView& view, const CameraModel& camera) {
  if (view.width_px != camera.width_px || view.height_px != camera.height_px)
    return fail(ErrorCode::bad_input, view.name,
                "expected a picture of the sensor model's size " + std::to_string(camera.width_px) + "x" +
                    std::to_string(camera.height_px) + ", got " + std::to_string(view.width_px) + "x" +
                    std::to_string(view.height_px));
  BoardView ideal = view;
  ideal.points.clear();
  for (const BoardPoint& p : view.points) {
    const auto n = unproject(camera, {p.u_px, p.v_px});
    if (!n) continue;
    BoardPoint q = p;
    q.u_px = camera.cx_px + camera.fx_px * n->x;
    q.v_px = camera.cy_px + camera.fy_px * n->y;
    ideal.points.push_back(q);
  }
  if (ideal.points.size() < 4)
    return fail(ErrorCode::bad_input, view.name,
                "expected at least 4 points of the board within reach of the lens, got " +
                    std::to_string(ideal.points.size()));
  std::array<double, 6> pose{};
  if (!pose_from_view(ideal, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, false, pose))
    return fail(ErrorCode::bad_input, view.name, "its points are no view of a board by this camera");
  LeastSquares fit;
  fit.add_block(pose.data(), {{"rx", 0.1}, {"ry", 0.1}, {"rz", 0.1}, {"tx", 1}, {"ty", 1}, {"tz", 1}});
  std::uint32_t id = 0;
  for (const BoardPoint& p : ideal.points)
    fit.add(new ceres::AutoDiffCostFunction<OnUnitPlane, 2, 6>(
                new OnUnitPlane{p.x_m, p.y_m, (p.u_px - camera.cx_px) / camera.fx_px,
                                (p.v_px - camera.cy_px) / camera.fy_px, camera.fx_px, camera.fy_px}),
            {pose.data()}, id++);
  FitOptions options;
  options.unit = "px";
  options.threads = 1;
  auto solved = fit.solve(options);
  if (!solved) return tl::unexpected<Error>(solved.error());
  BoardPose out;
  out.T_camera_board = isometry(pose);
  out.rms_px = solved->fit.residuals.rms;
  out.points = static_cast<int>(ideal.points.size() - solved->fit.rejected.size());
  Eigen::Matrix<double, 3, 6> jacobian;
  for (int i = 0; i < 6; ++i) {
    auto forward = pose, back = pose;
    constexpr double kStep = 1e-6;
    forward[static_cast<std::size_t>(i)] += kStep;
    back[static_cast<std::size_t>(i)] -= kStep;
    jacobian.col(i) = (plane_change(out.T_camera_board, isometry(forward)) -
                       plane_change(out.T_camera_board, isometry(back))) /
                      (2 * kStep);
  }
  out.plane_covariance = jacobian * solved->fit.covariance * jacobian.transpose();
  if (!out.plane_covariance.allFinite())
    return fail(ErrorCode::bad_input, view.name, "its points do not determine the board's plane");
  return out;
}

}  // namespace rigor::calibration

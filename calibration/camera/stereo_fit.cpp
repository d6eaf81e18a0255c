#include "calibration/camera/stereo_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/camera/camera_fit_internal.h"
#include "calibration/camera/camera_start.h"
#include "calibration/camera/view_cost.h"
#include "calibration/core/held_parameters.h"
#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

Pose pose_of(const Eigen::Isometry3d& t) {
  const Eigen::AngleAxisd turn(t.rotation());
  const Eigen::Vector3d w = turn.angle() * turn.axis(), p = t.translation();
  return {w.x(), w.y(), w.z(), p.x(), p.y(), p.z()};
}

std::vector<BoardView> one_side(const std::vector<StereoPair>& pairs, bool right) {
  std::vector<BoardView> views;
  for (const StereoPair& p : pairs) views.push_back(right ? p.right : p.left);
  return views;
}

/// Median over the corners of the squared distance in the picture.
double median_square(const BoardView& view, const CameraModel& camera,
                     const Eigen::Isometry3d& T_camera_board) {
  std::vector<double> squares;
  // Without a look for the fold, which costs more than all the rest: the median does not mind.
  const CameraParameters values = camera_parameters(camera);
  for (const BoardPoint& p : view.points) {
    const Eigen::Vector3d at = T_camera_board * Eigen::Vector3d(p.x_m, p.y_m, 0);
    double u = 0, v = 0;
    const bool seen = project_point(values.data(), at.data(), camera.projection == Projection::kannala_brandt,
                                    kThetaMax, 1.0, u, v);
    squares.push_back(seen ? std::pow(u - p.u_px, 2) + std::pow(v - p.v_px, 2) : 1e12);
  }
  if (squares.empty()) return 1e12;
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  return *middle;
}

struct Start {
  Eigen::Isometry3d T_left_right = Eigen::Isometry3d::Identity();
  std::vector<Pose> T_right_board;
};

/// Of the transforms that single pairs give the one that suits most of the others best.
Result<Start> start_of(const std::vector<StereoPair>& pairs, const CameraModel& left,
                       const CameraModel& right) {
  std::vector<std::vector<Pose>> in_left, in_right;
  for (const StereoPair& p : pairs) {
    in_left.push_back(poses_from_view(p.left, left));
    in_right.push_back(poses_from_view(p.right, right));
  }
  Start best;
  double least = std::numeric_limits<double>::infinity();
  const std::size_t stride = std::max<std::size_t>(1, pairs.size() / 20);
  for (std::size_t i = 0; i < pairs.size(); i += stride)
    for (const Pose& l : in_left[i])
      for (const Pose& r : in_right[i]) {
        const Eigen::Isometry3d T_left_right = transform_of(l) * transform_of(r).inverse();
        std::vector<double> each;
        Start start{T_left_right, {}};
        for (std::size_t k = 0; k < pairs.size(); ++k) {
          double square = 1e12;
          Pose pose{0, 0, 0, 0, 0, 1};
          for (const Pose& other : in_right[k]) {
            const double s = median_square(pairs[k].left, left, T_left_right * transform_of(other)) +
                             median_square(pairs[k].right, right, transform_of(other));
            if (s < square) square = s, pose = other;
          }
          each.push_back(square);
          start.T_right_board.push_back(pose);
        }
        const auto middle = each.begin() + static_cast<std::ptrdiff_t>(each.size() / 2);
        std::nth_element(each.begin(), middle, each.end());
        if (*middle < least) least = *middle, best = std::move(start);
      }
  if (best.T_right_board.empty() || !(std::sqrt(least) < 0.03 * left.width_px))
    return fail(ErrorCode::bad_input, "",
                "expected pairs of views of one board at the same instants, got views that no one transform "
                "between the cameras explains: are the pictures of both sides in the same order, and is the "
                "board's origin at the same corner in both?");
  return best;
}

void name_side(std::vector<Parameter>& parameters, std::size_t first, const std::string& side) {
  for (std::size_t i = first; i < first + kCameraParameters; ++i)
    parameters[i].name = side + "." + parameters[i].name;
}

}  // namespace

Result<StereoFit> fit_stereo(const std::vector<StereoPair>& pairs, const StereoFitOptions& options) {
  if (pairs.size() < 2)
    return fail(ErrorCode::bad_input, "",
                "expected at least 2 pairs of views, got " + std::to_string(pairs.size()));
  StereoFit out;
  out.left_model = options.left_model, out.right_model = options.right_model;
  CameraModel cameras[2];
  LensModel models[2] = {options.left_model, options.right_model};
  const std::optional<CameraModel>* given[2] = {&options.left, &options.right};
  for (std::size_t side = 0; side < 2; ++side) {
    if (*given[side]) {
      cameras[side] = **given[side];
      models[side] =
          cameras[side].projection == Projection::kannala_brandt ? LensModel::fisheye4 : LensModel::opencv8;
      for (const StereoPair& p : pairs) {
        const BoardView& v = side == 0 ? p.left : p.right;
        if (v.width_px != cameras[side].width_px || v.height_px != cameras[side].height_px)
          return fail(ErrorCode::bad_input, v.name,
                      "expected the picture size of the sensor model, " +
                          std::to_string(cameras[side].width_px) + "x" +
                          std::to_string(cameras[side].height_px) + ", got " + std::to_string(v.width_px) +
                          "x" + std::to_string(v.height_px));
      }
      continue;
    }
    auto alone = fit_camera(one_side(pairs, side == 1), {.models = {models[side]},
                                                         .robust = options.robust,
                                                         .reject_sigmas = options.reject_sigmas,
                                                         .threads = options.threads,
                                                         .stop = options.stop});
    if (!alone) return tl::unexpected<Error>(alone.error());
    cameras[side] = alone->camera;
  }
  auto start = start_of(pairs, cameras[0], cameras[1]);
  if (!start) return tl::unexpected<Error>(start.error());

  Pose rig = pose_of(start->T_left_right);
  CameraParameters values[2] = {camera_parameters(cameras[0]), camera_parameters(cameras[1])};
  double distance = 0;
  for (const Pose& p : start->T_right_board) distance += p[5] / static_cast<double>(pairs.size());
  LeastSquares problem;
  {
    // A hundredth of the picture, as with the intrinsics.
    const double angle = 0.01 * cameras[0].width_px / cameras[0].fx_px, length = angle * distance;
    problem.add_block(rig.data(), {{"rotation_x_rad", angle},
                                   {"rotation_y_rad", angle},
                                   {"rotation_z_rad", angle},
                                   {"x_m", length},
                                   {"y_m", length},
                                   {"z_m", 10 * length}});
  }
  for (std::size_t side = 0; side < 2; ++side)
    problem.add_block(values[side].data(), camera_infos(models[side], values[side][0], cameras[side].width_px,
                                                        cameras[side].height_px, given[side]->has_value()));
  struct Corner {
    std::size_t view, point;
  };
  std::vector<Corner> corners;
  std::vector<Pose>& poses = start->T_right_board;
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    problem.add_nuisance(poses[k].data(), 6);
    for (std::size_t side = 0; side < 2; ++side) {
      const BoardView& view = side == 0 ? pairs[k].left : pairs[k].right;
      std::vector<std::uint32_t> ids;
      for (std::size_t p = 0; p < view.points.size(); ++p) {
        ids.push_back(static_cast<std::uint32_t>(corners.size()));
        corners.push_back({2 * k + side, p});
      }
      if (ids.empty()) continue;
      const bool fisheye = models[side] == LensModel::fisheye4;
      std::vector<double*> blocks{values[side].data()};
      if (side == 0) blocks.push_back(rig.data());
      blocks.push_back(poses[k].data());
      problem.add_batch(view_cost(view.points, {.fisheye = fisheye, .rig = side == 0}), blocks, ids);
    }
  }
  FitOptions fit_options;
  fit_options.robust = options.robust;
  fit_options.reject_sigmas = options.reject_sigmas;
  fit_options.threads = options.threads;
  fit_options.unit = "px";
  fit_options.stop = options.stop;
  fit_options.progress = options.progress;
  auto solved = problem.solve(fit_options);
  if (!solved) return tl::unexpected<Error>(solved.error());

  out.result = std::move(solved->fit);
  out.result.model =
      "stereo " + std::string(lens_model_name(models[0])) + " " + std::string(lens_model_name(models[1]));
  out.T_left_right = transform_of(rig);
  for (std::size_t side = 0; side < 2; ++side) {
    const bool fisheye = models[side] == LensModel::fisheye4;
    CameraModel& camera = side == 0 ? out.left : out.right;
    camera = *given[side] ? **given[side]
                          : camera_of(values[side], fisheye, cameras[side].width_px, cameras[side].height_px);
    name_side(out.result.parameters, 6 + side * kCameraParameters, side == 0 ? "left" : "right");
  }
  out.left_model = models[0], out.right_model = models[1];
  for (WeakDirection& w : out.result.weak)
    w.cure =
        "record views with the board tilted by 30 to 45 degrees, near and far, over all of both pictures";
  // What was held is not reported: it is an input.
  drop_held(out.result);

  std::vector<bool> used(corners.size(), true);
  const auto view_of = [&](std::size_t v) -> const BoardView& {
    return v % 2 == 0 ? pairs[v / 2].left : pairs[v / 2].right;
  };
  for (std::size_t k = 0; k < solved->rejected_ids.size(); ++k) {
    const Corner& c = corners[solved->rejected_ids[k]];
    const BoardPoint& p = view_of(c.view).points[c.point];
    used[solved->rejected_ids[k]] = false;
    out.result.rejected[k].what = (c.view % 2 == 0 ? "left " : "right ") + view_of(c.view).name +
                                  " corner (" + std::to_string(p.column) + ", " + std::to_string(p.row) + ")";
  }
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Corner& c = corners[i];
    const BoardPoint& p = view_of(c.view).points[c.point];
    const Eigen::Isometry3d T_right_board = transform_of(poses[c.view / 2]);
    const bool left = c.view % 2 == 0;
    const Eigen::Vector3d at =
        (left ? out.T_left_right * T_right_board : T_right_board) * Eigen::Vector3d(p.x_m, p.y_m, 0);
    double u = 0, v = 0;
    const std::size_t side = left ? 0 : 1;
    if (!project_point(values[side].data(), at.data(), models[side] == LensModel::fisheye4, kThetaMax, 1.0, u,
                       v))
      u = v = std::numeric_limits<double>::quiet_NaN();
    out.residuals.push_back({c.view, p.u_px, p.v_px, u - p.u_px, v - p.v_px, used[i]});
    if (!used[i]) continue;
    sum += std::pow(u - p.u_px, 2) + std::pow(v - p.v_px, 2);
    ++count;
  }
  out.rms_per_corner_px = count > 0 ? std::sqrt(sum / static_cast<double>(count)) : 0;
  double nearest = 1e300, farthest = 0;
  for (const Pose& p : poses) {
    const double d = Eigen::Vector3d(p[3], p[4], p[5]).norm();
    nearest = std::min(nearest, d), farthest = std::max(farthest, d);
  }
  out.result.validity = {{"board_distance_m", nearest, farthest}};
  if (options.left || options.right)
    out.result.warnings.push_back("the intrinsics of " +
                                  std::string(options.left && options.right ? "both cameras"
                                              : options.left                ? "the left camera"
                                                                            : "the right camera") +
                                  " were held: what is not known of them is not in the covariance");
  return out;
}

}  // namespace rigor::calibration

#include "calibration/camera/rolling_shutter.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "calibration/camera/camera_fit_internal.h"
#include "calibration/camera/moving_view_cost.h"
#include "calibration/camera/projection_uncertainty.h"
#include "calibration/core/held_parameters.h"

namespace rigor::calibration {
namespace {

constexpr const char* kLineTime = "line_time_s";
constexpr std::size_t kLongest = 60;      // views in a run: beyond it a new one begins, for the memory
constexpr double kLargestTurn_rad = 1.0;  // between neighbours: a board that was counted from its other end

Eigen::Vector3d turn_of(const Eigen::Isometry3d& t) {
  const Eigen::AngleAxisd turn(t.rotation());
  return turn.angle() * turn.axis();
}

/// Views in the order of time that follow each other closely enough.
using Run = std::vector<std::size_t>;
std::vector<Run> runs_of(const std::vector<BoardView>& views, const CameraFit& start, double longest_gap_s) {
  std::vector<std::size_t> order;
  for (std::size_t v = 0; v < views.size(); ++v)
    if (std::isfinite(views[v].t_s) && std::isfinite(start.view_rms_px[v])) order.push_back(v);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return views[a].t_s < views[b].t_s; });
  std::vector<Run> runs(1);
  for (const std::size_t v : order) {
    if (!runs.back().empty()) {
      const std::size_t before = runs.back().back();
      const double dt = views[v].t_s - views[before].t_s;
      if (dt <= 0) continue;  // the same picture again
      const Eigen::AngleAxisd between(
          (start.T_camera_board[before].rotation().transpose() * start.T_camera_board[v].rotation()).eval());
      if (dt > longest_gap_s || std::abs(between.angle()) > kLargestTurn_rad ||
          runs.back().size() >= kLongest)
        runs.emplace_back();
    }
    runs.back().push_back(v);
  }
  std::erase_if(runs, [](const Run& r) { return r.size() < 3; });
  return runs;
}

/// One view of a run: its place among all, and the window around it.
struct Moving {
  std::size_t view;
  MotionWindow window{};
  std::array<std::size_t, MotionWindow::kMost> pose{};  ///< index of the views in the window
};

struct Trajectory {
  std::vector<Moving> moving;
  std::vector<Pose> pose;  ///< of every moving view, in order
  double interval_s = 0;   ///< median
};

Trajectory trajectory_of(const std::vector<BoardView>& views, const CameraFit& start,
                         const std::vector<Run>& runs) {
  Trajectory t;
  std::vector<double> intervals;
  for (const Run& run : runs) {
    const std::size_t first = t.moving.size();
    for (std::size_t i = 0; i < run.size(); ++i) {
      Moving m{run[i]};
      m.window.count = std::min(run.size(), MotionWindow::kMost);
      const std::size_t from = std::min(i - std::min(i, m.window.count / 2), run.size() - m.window.count);
      for (std::size_t k = 0; k < m.window.count; ++k) {
        m.pose[k] = first + from + k;
        m.window.t_s[k] = views[run[from + k]].t_s - views[run[i]].t_s;
      }
      const Eigen::Isometry3d& T = start.T_camera_board[run[i]];
      Eigen::Vector3d w = turn_of(T);
      if (i > 0) {
        intervals.push_back(views[run[i]].t_s - views[run[i - 1]].t_s);
        // Of the vectors that mean this rotation the one nearest to the neighbour's: the path is smooth.
        const Eigen::Vector3d last(t.pose.back()[0], t.pose.back()[1], t.pose.back()[2]);
        const Eigen::Vector3d axis = w.norm() > 0 ? Eigen::Vector3d(w.normalized()) : last.normalized();
        const Eigen::Vector3d plain = w;
        for (const int turns : {-1, 1}) {
          const Eigen::Vector3d other = plain + turns * 2 * std::numbers::pi * axis;
          if ((other - last).norm() < (w - last).norm()) w = other;
        }
      }
      t.pose.push_back({w.x(), w.y(), w.z(), T.translation().x(), T.translation().y(), T.translation().z()});
      t.moving.push_back(m);
    }
  }
  if (!intervals.empty()) {
    const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2);
    std::nth_element(intervals.begin(), middle, intervals.end());
    t.interval_s = *middle;
  }
  return t;
}

struct Solved {
  CameraFit fit;
  bool determined = false;
  double sigma_s = 0;
  /// Views without what the motion did to their corners.
  std::vector<BoardView> still;
};

Result<Solved> solve(const std::vector<BoardView>& views, const CameraFit& start, Trajectory path,
                     const CameraFitOptions& options) {
  const int width = start.camera.width_px, height = start.camera.height_px;
  const bool fisheye = start.camera.projection == Projection::kannala_brandt;
  const double middle_row = 0.5 * (height - 1);
  CameraParameters camera = camera_parameters(start.camera);
  double line_us = 0;
  // The readout of a picture is known then to a tenth of the time between two.
  const double resolution_s = 0.1 * path.interval_s / height;
  LeastSquares problem;
  problem.add_block(camera.data(), camera_infos(start.lens_model, camera[0], width, height, false));
  problem.add_block(&line_us, {{.name = kLineTime, .resolution = resolution_s / kUs}});
  for (Pose& p : path.pose) problem.add_nuisance(p.data(), 6);
  struct SeenCorner {
    std::size_t moving, point;
  };
  std::vector<SeenCorner> corners;
  for (std::size_t m = 0; m < path.moving.size(); ++m) {
    const Moving& moving = path.moving[m];
    const BoardView& view = views[moving.view];
    std::vector<std::uint32_t> ids;
    for (std::size_t p = 0; p < view.points.size(); ++p) {
      ids.push_back(static_cast<std::uint32_t>(corners.size()));
      corners.push_back({m, p});
    }
    std::vector<double*> blocks{camera.data(), &line_us};
    for (std::size_t k = 0; k < moving.window.count; ++k) blocks.push_back(path.pose[moving.pose[k]].data());
    problem.add_batch(moving_view_cost(view.points, fisheye, moving.window, middle_row), blocks, ids);
  }
  FitOptions o;
  o.robust = options.robust;
  o.reject_sigmas = options.reject_sigmas;
  o.threads = options.threads;
  o.unit = "px";
  o.stop = options.stop;
  o.progress = options.progress;
  auto solved = problem.solve(o);
  if (!solved) return tl::unexpected<Error>(solved.error());

  Solved out;
  CameraFit& fit = out.fit;
  fit.lens_model = start.lens_model;
  fit.result = std::move(solved->fit);
  fit.result.model = start.result.model;
  fit.result.candidates = start.result.candidates;
  fit.camera = camera_of(camera, fisheye, width, height);
  fit.uncertainty =
      uncertainty_map(fit.camera, fit.result.covariance.topLeftCorner(kCameraParameters, kCameraParameters));
  // From microseconds, in which the solver works.
  Parameter& line = fit.result.parameters.back();
  line.value *= kUs, line.sigma *= kUs, line.resolution *= kUs;
  const Eigen::Index last = kCameraParameters;
  fit.result.covariance.row(last) *= kUs;
  fit.result.covariance.col(last) *= kUs;
  out.sigma_s = line.sigma;
  out.determined = line.sigma <= resolution_s;
  fit.camera.shutter.line_time_s = std::max(0.0, line.value);
  drop_held(fit.result);

  std::vector<bool> used(corners.size(), true);
  for (std::size_t k = 0; k < solved->rejected_ids.size(); ++k) {
    const SeenCorner& c = corners[solved->rejected_ids[k]];
    const BoardView& view = views[path.moving[c.moving].view];
    const BoardPoint& p = view.points[c.point];
    used[solved->rejected_ids[k]] = false;
    fit.result.rejected[k].what =
        view.name + " corner (" + std::to_string(p.column) + ", " + std::to_string(p.row) + ")";
  }
  fit.T_camera_board = start.T_camera_board;
  fit.view_rms_px.assign(views.size(), std::numeric_limits<double>::quiet_NaN());
  out.still = views;
  double all = 0, nearest = 1e300, farthest = 0;
  std::size_t count = 0, i = 0;
  for (const Moving& moving : path.moving) {
    const double* poses[MotionWindow::kMost] = {};
    for (std::size_t k = 0; k < moving.window.count; ++k) poses[k] = path.pose[moving.pose[k]].data();
    const Pose middle = moving.window.pose_at(0, poses);
    double sum = 0;
    std::size_t in_view = 0;
    for (BoardPoint& p : out.still[moving.view].points) {
      const Pose then = moving.window.pose_at(kUs * line_us * (p.v_px - middle_row), poses);
      double r[2] = {NAN, NAN}, at_middle[2] = {NAN, NAN};
      const Reprojection seen{p.x_m, p.y_m, p.u_px, p.v_px, fisheye};
      if (seen(camera.data(), then.data(), r)) {
        if (seen(camera.data(), middle.data(), at_middle))
          p.u_px += at_middle[0] - r[0], p.v_px += at_middle[1] - r[1];
      }
      const BoardPoint& q =
          views[moving.view].points[static_cast<std::size_t>(&p - out.still[moving.view].points.data())];
      fit.residuals.push_back({moving.view, q.u_px, q.v_px, r[0], r[1], used[i]});
      if (used[i++]) sum += r[0] * r[0] + r[1] * r[1], ++in_view;
    }
    if (in_view > 0) fit.view_rms_px[moving.view] = std::sqrt(sum / static_cast<double>(in_view));
    all += sum, count += in_view;
    fit.T_camera_board[moving.view] = transform_of(middle);
    const double distance = fit.T_camera_board[moving.view].translation().norm();
    nearest = std::min(nearest, distance), farthest = std::max(farthest, distance);
  }
  fit.rms_per_corner_px = count > 0 ? std::sqrt(all / static_cast<double>(count)) : 0;
  fit.result.validity = {{"board_distance_m", nearest, farthest}};
  return out;
}

CameraFit without(CameraFit fit, const std::string& why) {
  fit.result.not_identifiable.emplace_back(kLineTime, why);
  return fit;
}

}  // namespace

Result<CameraFit> fit_rolling_shutter(const std::vector<BoardView>& views, const CameraFitOptions& options,
                                      const RollingShutterOptions& shutter) {
  auto start = fit_camera(views, options);
  if (!start) return start;
  if (start->result.interrupted) return without(*start, "interrupted before the line time was fitted");
  std::size_t timed = 0;
  for (const BoardView& v : views) timed += std::isfinite(v.t_s);
  if (timed == 0)
    return without(*start,
                   "the pictures have no times, and without them twice the speed and half the line time look "
                   "the same; record with times (MCAP), or say how many pictures a second there are");
  const auto runs = runs_of(views, *start, shutter.longest_gap_s);
  char text[320];
  if (runs.empty()) {
    std::snprintf(text, sizeof text,
                  "no three views follow each other within %g s, so nothing says how the board moved while "
                  "the rows were read; record a sequence in which the board moves",
                  shutter.longest_gap_s);
    return without(*start, text);
  }
  const auto path = trajectory_of(views, *start, runs);
  if (path.moving.size() * 6 + 13 >= [&] {
        std::size_t residuals = 0;
        for (const Moving& m : path.moving) residuals += 2 * views[m.view].points.size();
        return residuals;
      }())
    return without(*start, "too few corners in views that follow each other");
  auto solved = solve(views, *start, path, options);
  if (!solved) return tl::unexpected<Error>(solved.error());
  if (solved->determined && options.models.size() != 1 && !solved->fit.result.interrupted) {
    // What the motion did to the corners must not speak for or against a lens model.
    auto again = fit_camera(solved->still, options);
    if (again && !again->result.interrupted) {
      auto better = solve(views, *again, trajectory_of(views, *again, runs), options);
      if (better) solved = std::move(better);
    }
  }
  if (!solved->determined) {
    if (std::isfinite(solved->sigma_s))
      std::snprintf(
          text, sizeof text,
          "too little moved while the rows were read: its standard uncertainty is %.3g µs, and %.3g "
          "µs for all rows together; record a sequence in which the board moves fast, across and "
          "along the rows",
          1e6 * solved->sigma_s, 1e6 * solved->sigma_s * start->camera.height_px);
    else
      std::snprintf(text, sizeof text,
                    "nothing moved while the rows were read; record a sequence in which the board moves");
    return without(*start, text);
  }
  CameraFit& fit = solved->fit;
  std::vector<bool> in(views.size(), false);
  for (const Moving& m : path.moving) in[m.view] = true;
  for (std::size_t v = 0; v < views.size(); ++v)
    if (!in[v])
      fit.result.warnings.push_back(views[v].name +
                                    ": left out, no two views near it in time say how the board moved");
  const Parameter& line = fit.result.parameters.back();
  if (line.value < -4 * line.sigma)
    fit.result.warnings.push_back(
        "line_time_s is negative: the rows were read from the last to the first (a picture that was turned "
        "round?); the simulator reads from the first, and its sensor model gets 0");
  else if (line.value < 4 * line.sigma)
    fit.result.warnings.push_back(
        "line_time_s is not told apart from 0: this looks like a global shutter; draws from the covariance "
        "leave the sensor model's value as it is");
  return fit;
}

}  // namespace rigor::calibration

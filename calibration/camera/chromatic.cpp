#include "calibration/camera/chromatic.h"

#include <cmath>
#include <limits>

#include "calibration/camera/camera_fit_internal.h"
#include "calibration/camera/projection_uncertainty.h"
#include "calibration/camera/view_cost.h"
#include "calibration/core/held_parameters.h"

namespace rigor::calibration {
namespace {}

Result<CameraFit> fit_chromatic(const std::vector<ColourViews>& views, const CameraFitOptions& options) {
  std::vector<BoardView> green;
  for (const ColourViews& v : views) green.push_back(v[1]);
  auto start = fit_camera(green, options);
  if (!start) return start;
  if (start->result.interrupted) {
    for (const char* name : {"magnification_red", "magnification_blue"})
      start->result.not_identifiable.emplace_back(name, "interrupted before the colours were fitted");
    return start;
  }
  const int width = start->camera.width_px, height = start->camera.height_px;
  const bool fisheye = start->camera.projection == Projection::kannala_brandt;
  CameraParameters camera = camera_parameters(start->camera);
  double factor[3] = {1, 1, 1};
  std::vector<Pose> poses;
  for (const auto& t : start->T_camera_board) {
    const Eigen::AngleAxisd turn(t.rotation());
    const Eigen::Vector3d w = turn.angle() * turn.axis(), p = t.translation();
    poses.push_back({w.x(), w.y(), w.z(), p.x(), p.y(), p.z()});
  }
  LeastSquares problem;
  problem.add_block(camera.data(), camera_infos(start->lens_model, camera[0], width, height, false));
  // The corner of the picture moves by a hundredth of its width.
  const double resolution = 0.01 * width / (0.5 * std::hypot(width, height));
  problem.add_block(&factor[0], {{.name = "magnification_red", .resolution = resolution}});
  problem.add_block(&factor[2], {{.name = "magnification_blue", .resolution = resolution}});
  struct Corner {
    std::size_t view, colour, point;
  };
  std::vector<Corner> corners;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!std::isfinite(start->view_rms_px[v])) continue;  // a copy
    problem.add_nuisance(poses[v].data(), 6);
    for (std::size_t c = 0; c < 3; ++c) {
      std::vector<std::uint32_t> ids;
      for (std::size_t p = 0; p < views[v][c].points.size(); ++p) {
        ids.push_back(static_cast<std::uint32_t>(corners.size()));
        corners.push_back({v, c, p});
      }
      if (ids.empty()) continue;
      const bool magnified = c != 1;
      std::vector<double*> blocks{camera.data()};
      if (magnified) blocks.push_back(&factor[c]);
      blocks.push_back(poses[v].data());
      problem.add_batch(view_cost(views[v][c].points, {.fisheye = fisheye, .magnified = magnified}), blocks,
                        ids);
    }
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

  CameraFit fit;
  fit.lens_model = start->lens_model;
  fit.result = std::move(solved->fit);
  fit.result.model = start->result.model;
  fit.result.candidates = start->result.candidates;
  fit.result.validity = start->result.validity;
  fit.result.warnings.insert(fit.result.warnings.end(), start->result.warnings.begin(),
                             start->result.warnings.end());
  fit.camera = camera_of(camera, fisheye, width, height);
  fit.camera.chromatic.magnification = {factor[0], 1, factor[2]};
  fit.uncertainty =
      uncertainty_map(fit.camera, fit.result.covariance.topLeftCorner(kCameraParameters, kCameraParameters));
  drop_held(fit.result);

  std::vector<bool> used(corners.size(), true);
  for (std::size_t k = 0; k < solved->rejected_ids.size(); ++k) {
    const Corner& c = corners[solved->rejected_ids[k]];
    const BoardPoint& p = views[c.view][c.colour].points[c.point];
    used[solved->rejected_ids[k]] = false;
    fit.result.rejected[k].what = views[c.view][c.colour].name + " corner (" + std::to_string(p.column) +
                                  ", " + std::to_string(p.row) + ")";
  }
  std::vector<double> square(views.size(), 0);
  std::vector<std::size_t> count(views.size(), 0);
  double all = 0;
  std::size_t n = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Corner& c = corners[i];
    const BoardPoint& p = views[c.view][c.colour].points[c.point];
    CameraParameters scaled = camera;
    scaled[0] *= factor[c.colour], scaled[1] *= factor[c.colour];
    double r[2];
    if (!Reprojection{p.x_m, p.y_m, p.u_px, p.v_px, fisheye}(scaled.data(), poses[c.view].data(), r))
      r[0] = r[1] = std::numeric_limits<double>::quiet_NaN();
    fit.residuals.push_back({c.view, p.u_px, p.v_px, r[0], r[1], used[i]});
    if (!used[i]) continue;
    const double s = r[0] * r[0] + r[1] * r[1];
    square[c.view] += s, ++count[c.view];
    all += s, ++n;
  }
  fit.rms_per_corner_px = n > 0 ? std::sqrt(all / static_cast<double>(n)) : 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    fit.view_rms_px.push_back(count[v] > 0 ? std::sqrt(square[v] / static_cast<double>(count[v]))
                                           : std::numeric_limits<double>::quiet_NaN());
    const Eigen::Vector3d w(poses[v][0], poses[v][1], poses[v][2]);
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    if (w.norm() > 0) t.linear() = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
    t.translation() = Eigen::Vector3d(poses[v][3], poses[v][4], poses[v][5]);
    fit.T_camera_board.push_back(t);
  }
  return fit;
}

}  // namespace rigor::calibration

#include "calibration/procedures/stereo_calibration.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "calibration/camera/stereo_fit.h"
#include "calibration/procedures/board_views.h"
#include "sensor-hal/models/camera_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

/// Pairs of one instant: of recordings by their time, of files by their order.
Result<std::vector<StereoPair>> pairs_of(const BoardViews& left, const BoardViews& right, double within_s) {
  std::vector<StereoPair> pairs;
  for (std::size_t i = 0; i < left.seen.size(); ++i) {
    const BoardView* nearest = nullptr;
    double apart = within_s;
    for (std::size_t k = 0; k < right.seen.size(); ++k) {
      const bool timed = std::isfinite(left.seen[i].t_s) && std::isfinite(right.seen[k].t_s);
      const double d = timed                                 ? std::abs(left.seen[i].t_s - right.seen[k].t_s)
                       : left.picture[i] == right.picture[k] ? 0
                                                             : 1e300;
      if (d <= apart) apart = d, nearest = &right.seen[k];
    }
    if (nearest != nullptr) pairs.push_back({left.seen[i], *nearest});
  }
  if (pairs.size() >= 2) return pairs;
  return fail(
      ErrorCode::bad_input, "--right",
      fmt::format("expected at least 2 instants at which both cameras saw the whole board, got {} of {} "
                  "views left and {} right; pictures are paired by their order, those of recordings by "
                  "their time (--within-ms)",
                  pairs.size(), left.seen.size(), right.seen.size()));
}

Result<std::optional<CameraModel>> held(const std::filesystem::path& sensor_model) {
  if (sensor_model.empty()) return std::optional<CameraModel>{};
  auto model = load_camera(sensor_model);
  if (!model) return tl::unexpected<Error>(model.error());
  return std::optional<CameraModel>{model->model};
}

void put_camera(SensorModelRecipe& r, const std::string& side, const CameraModel& m) {
  const auto put = [&](const std::string& path, double v) {
    r.set.emplace_back(side + "." + path, exact_text(v));
  };
  r.set.emplace_back(side + ".width_px", std::to_string(m.width_px));
  r.set.emplace_back(side + ".height_px", std::to_string(m.height_px));
  put("intrinsics.fx_px", m.fx_px), put("intrinsics.fy_px", m.fy_px);
  put("intrinsics.cx_px", m.cx_px), put("intrinsics.cy_px", m.cy_px);
  if (m.projection == Projection::kannala_brandt) {
    r.set.emplace_back(side + ".projection", "kannala_brandt");
    put("fisheye.k1", m.fisheye.k1), put("fisheye.k2", m.fisheye.k2);
    put("fisheye.k3", m.fisheye.k3), put("fisheye.k4", m.fisheye.k4);
    return;
  }
  const auto& l = m.lens;
  for (const auto& [name, v] : {std::pair{"k1", l.k1},
                                {"k2", l.k2},
                                {"p1", l.p1},
                                {"p2", l.p2},
                                {"k3", l.k3},
                                {"k4", l.k4},
                                {"k5", l.k5},
                                {"k6", l.k6}})
    put(std::string("lens.") + name, v);
}

SensorModelRecipe recipe_of(const StereoFit& fit) {
  SensorModelRecipe r;
  r.kind = "stereo";
  r.remove = {"left", "right", "T_left_right"};
  const auto list = [](std::initializer_list<double> values) {
    std::string s = "[";
    for (const double v : values) s += (s.size() > 1 ? ", " : "") + exact_text(v);
    return s + "]";
  };
  const Eigen::Vector3d t = fit.T_left_right.translation();
  const Eigen::AngleAxisd turn(fit.T_left_right.rotation());
  const Eigen::Vector3d w = turn.angle() * turn.axis();
  r.set.emplace_back("T_left_right.position_m", list({t.x(), t.y(), t.z()}));
  r.set.emplace_back("T_left_right.rotation_vector_rad", list({w.x(), w.y(), w.z()}));
  put_camera(r, "left", fit.left);
  put_camera(r, "right", fit.right);
  for (const Parameter& p : fit.result.parameters) {
    const std::size_t dot = p.name.find('.');
    std::string path;
    if (dot != std::string::npos) {
      const std::string side = p.name.substr(0, dot + 1), name = p.name.substr(dot + 1);
      const bool fisheye = (side == "left." ? fit.left : fit.right).projection == Projection::kannala_brandt;
      path = side + (name.ends_with("_px") ? "intrinsics." : fisheye ? "fisheye." : "lens.") + name;
    } else if (p.name.starts_with("rotation_")) {
      path = std::string("T_left_right.rotation_vector_rad.") + std::to_string(p.name[9] - 'x');
    } else {
      path = std::string("T_left_right.position_m.") + std::to_string(p.name[0] - 'x');
    }
    r.places.push_back({p.name, path, 1});
  }
  return r;
}

/// What is known of one camera alone: its parameters, and its part of the covariance.
FitResult side_result(const FitResult& all, const std::string& side, LensModel model) {
  FitResult one = all;
  one.model = std::string(lens_model_name(model));
  one.parameters.clear();
  one.candidates.clear();
  one.weak.clear();
  one.rejected.clear();
  std::vector<Eigen::Index> kept;
  for (std::size_t i = 0; i < all.parameters.size(); ++i) {
    if (!all.parameters[i].name.starts_with(side + ".")) continue;
    one.parameters.push_back(all.parameters[i]);
    one.parameters.back().name.erase(0, side.size() + 1);
    kept.push_back(static_cast<Eigen::Index>(i));
  }
  one.covariance = all.covariance(kept, kept);
  return one;
}

SensorModelPart part_of(const StereoFit& fit, const std::string& side) {
  const bool left = side == "left";
  const CameraModel& m = left ? fit.left : fit.right;
  SensorModelPart part{side, side_result(fit.result, side, left ? fit.left_model : fit.right_model), {}};
  SensorModelRecipe rig;
  put_camera(rig, side, m);
  part.recipe.kind = "camera";
  for (auto& [path, value] : rig.set) part.recipe.set.emplace_back(path.substr(side.size() + 1), value);
  const bool fisheye = m.projection == Projection::kannala_brandt;
  for (const Parameter& p : part.fit.parameters)
    part.recipe.places.push_back({p.name,
                                  (p.name.ends_with("_px") ? "intrinsics."
                                   : fisheye               ? "fisheye."
                                                           : "lens.") +
                                      p.name,
                                  1});
  return part;
}

std::vector<Figure> figures_of(const StereoFit& fit) {
  std::vector<Figure> figures;
  Series scalar;
  for (std::size_t side = 0; side < 2; ++side) {
    const CameraModel& m = side == 0 ? fit.left : fit.right;
    Figure arrows{.kind = Figure::Kind::arrows,
                  .title = side == 0 ? "Residuals of the left camera" : "Residuals of the right camera",
                  .caption = "Each corner that was used, its residual drawn 50 times as long.",
                  .x_label = "u [px]",
                  .y_label = "v [px]",
                  .x_to = static_cast<double>(m.width_px),
                  .y_to = static_cast<double>(m.height_px),
                  .stretch = 50};
    Series at, by;
    for (const auto& r : fit.residuals) {
      if (!r.used || r.view % 2 != side) continue;
      at.x.push_back(r.u_px), at.y.push_back(r.v_px);
      by.x.push_back(r.du_px), by.y.push_back(r.dv_px);
      scalar.y.push_back(r.du_px), scalar.y.push_back(r.dv_px);
    }
    arrows.series = {at, by};
    figures.push_back(arrows);
  }
  Figure quantiles{.kind = Figure::Kind::quantiles,
                   .title = "Q–Q plot",
                   .caption = "On the line the residuals are normal; ends that bend away are outliers."};
  quantiles.series = {scalar};
  figures.push_back(quantiles);
  return figures;
}

}  // namespace

Result<CalibrationResult> calibrate_stereo(const StereoCalibrationOptions& o, const StopToken& stop) {
  const auto board = parse_board(o.target);
  if (!board) return tl::unexpected<Error>(board.error());
  StereoFitOptions options;
  if (o.model != "auto") {
    const auto model = parse_lens_model(o.model);
    if (!model) return tl::unexpected<Error>(model.error());
    options.left_model = options.right_model = *model;
  }
  const auto left_held = held(o.left_model_file), right_held = held(o.right_model_file);
  if (!left_held) return tl::unexpected<Error>(left_held.error());
  if (!right_held) return tl::unexpected<Error>(right_held.error());
  options.left = *left_held, options.right = *right_held;
  options.stop = stop;
  BoardViewsOptions from{
      .inputs = o.inputs, .channel = o.channel, .size = o.size, .report = o.looked_for_folder, .stop = stop};
  const auto left = read_board_views(from, *board);
  if (!left) return tl::unexpected<Error>(left.error());
  // One recording has both.
  if (!o.right.empty()) from.inputs = o.right;
  from.channel = o.right_channel;
  const auto right = read_board_views(from, *board);
  if (!right) return tl::unexpected<Error>(right.error());
  const auto pairs = pairs_of(*left, *right, 1e-3 * o.within_ms);
  if (!pairs) return tl::unexpected<Error>(pairs.error());
  ProgressTask fitting("fit", 1);
  options.progress = [&](double share, double rms) {
    fitting.set(share);
    fitting.note(fmt::format("RMS {:.3g} px", rms));
  };
  auto fit = fit_stereo(*pairs, options);
  if (!fit) return tl::unexpected<Error>(fit.error());
  fitting.finish();

  CalibrationResult result;
  result.title = "Stereo calibration";
  nlohmann::json& details = result.details.json();
  result.inputs = left->files;
  if (!o.right.empty()) result.inputs.insert(result.inputs.end(), right->files.begin(), right->files.end());
  result.fit = fit->result;
  result.fit.interrupted = result.fit.interrupted || left->interrupted || right->interrupted;
  for (const BoardViews* side : {&*left, &*right})
    result.fit.warnings.insert(result.fit.warnings.end(), side->notes.begin(), side->notes.end());
  result.recipe = recipe_of(*fit);
  result.figures = figures_of(*fit);
  const Eigen::Quaterniond q(fit->T_left_right.rotation());
  const Eigen::Vector3d t = fit->T_left_right.translation();
  details["rms_per_corner_px"] = fit->rms_per_corner_px;
  details["pairs"] = pairs->size();
  details["baseline_m"] = t.norm();
  details["T_left_right"] = {{"position_m", {t.x(), t.y(), t.z()}},
                             {"quaternion_wxyz", {q.w(), q.x(), q.y(), q.z()}}};
  // A camera whose intrinsics were held has a sensor model already.
  if (o.left_model_file.empty()) result.parts.push_back(part_of(*fit, "left"));
  if (o.right_model_file.empty()) result.parts.push_back(part_of(*fit, "right"));
  result.base = o.base;
  return result;
}

}  // namespace rigor

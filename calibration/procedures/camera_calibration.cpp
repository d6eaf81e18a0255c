#include "calibration/procedures/camera_calibration.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "calibration/camera/camera_fit.h"
#include "calibration/camera/chromatic.h"
#include "calibration/camera/rolling_shutter.h"
#include "calibration/procedures/board_twin.h"
#include "calibration/procedures/board_views.h"

namespace rigor {
namespace {

using namespace calibration;

SensorModelRecipe recipe_of(const CameraFit& fit) {
  SensorModelRecipe r;
  r.kind = "camera";
  const CameraModel& m = fit.camera;
  const auto put = [&](const std::string& path, double value) {
    r.set.emplace_back(path, exact_text(value));
  };
  r.remove = {"lens", "fisheye", "projection"};
  r.set = {{"width_px", std::to_string(m.width_px)}, {"height_px", std::to_string(m.height_px)}};
  const bool fisheye = m.projection == Projection::kannala_brandt;
  if (fisheye) r.set.emplace_back("projection", "kannala_brandt");
  for (const Parameter& p : fit.result.parameters) {
    if (p.name == "line_time_s") {
      put("shutter.line_time_us", 1e6 * m.shutter.line_time_s);
      // A draw below 0 would be no camera.
      if (p.value > 4 * p.sigma) r.places.push_back({p.name, "shutter.line_time_us", 1e6});
      continue;
    }
    if (p.name == "magnification_red" || p.name == "magnification_blue") {
      const auto& each = m.chromatic.magnification;
      r.set.emplace_back("chromatic.magnification", "[" + exact_text(each[0]) + ", " + exact_text(each[1]) +
                                                        ", " + exact_text(each[2]) + "]");
      r.places.push_back(
          {p.name, std::string("chromatic.magnification.") + (p.name.ends_with("red") ? "0" : "2"), 1});
      continue;
    }
    const std::string path = p.name.ends_with("_px") ? "intrinsics." + p.name
                             : fisheye               ? "fisheye." + p.name
                                                     : "lens." + p.name;
    put(path, p.value);
    r.places.push_back({p.name, path, 1});
  }
  return r;
}

std::vector<Figure> figures_of(const CameraFit& fit, const std::vector<BoardView>& views) {
  const double w = fit.camera.width_px, h = fit.camera.height_px;
  std::vector<Figure> figures;
  Figure arrows{
      .kind = Figure::Kind::arrows,
      .title = "Residuals over the picture",
      .caption =
          "Each corner that was used, its residual drawn 50 times as long. A pattern is what the lens "
          "model does not know.",
      .x_label = "u [px]",
      .y_label = "v [px]",
      .x_to = w,
      .y_to = h,
      .stretch = 50};
  Figure coverage{
      .kind = Figure::Kind::series,
      .title = "Coverage",
      .caption = "Where in the picture corners were seen. The model is unproven where there are none.",
      .x_label = "u [px]",
      .y_label = "−v [px]",
      .x_to = w,
      .y_from = -h};
  Series at, by, used{"used", {}, {}, false}, rejected{"rejected", {}, {}, false};
  Series scalar;
  for (const auto& r : fit.residuals) {
    (r.used ? used : rejected).x.push_back(r.u_px);
    (r.used ? used : rejected).y.push_back(-r.v_px);
    if (!r.used) continue;
    at.x.push_back(r.u_px), at.y.push_back(r.v_px);
    by.x.push_back(r.du_px), by.y.push_back(r.dv_px);
    scalar.y.push_back(r.du_px), scalar.y.push_back(r.dv_px);
  }
  arrows.series = {at, by};
  coverage.series = {used, rejected};
  figures.push_back(arrows);
  figures.push_back(coverage);
  figures.push_back(
      {.kind = Figure::Kind::map,
       .title = "Uncertainty of projection",
       .caption = "Standard deviation of where a ray falls, in its worst direction, from the covariance "
                  "of the intrinsics.",
       .x_label = "u [px]",
       .y_label = "v [px]",
       .values = fit.uncertainty.sigma_px,
       .columns = fit.uncertainty.columns,
       .x_to = w,
       .y_to = h,
       .value_label = "px"});
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Residuals",
                   .caption = "u and v of all corners that were used.",
                   .x_label = "residual [px]",
                   .y_label = "number"};
  histogram.series = {scalar};
  figures.push_back(histogram);
  Figure quantiles{
      .kind = Figure::Kind::quantiles,
      .title = "Q–Q plot",
      .caption = "On the line the residuals are normal; ends that bend away are outliers that stayed."};
  quantiles.series = {scalar};
  figures.push_back(quantiles);
  Figure views_rms{.kind = Figure::Kind::series,
                   .title = "RMS by view",
                   .caption = "Per corner, in the order of the inputs.",
                   .x_label = "view",
                   .y_label = "RMS [px]"};
  Series rms{"", {}, {}, false};
  for (std::size_t v = 0; v < views.size(); ++v) {
    rms.x.push_back(static_cast<double>(v));
    rms.y.push_back(fit.view_rms_px[v]);
  }
  views_rms.series = {rms};
  figures.push_back(views_rms);
  return figures;
}

}  // namespace

Result<CalibrationResult> calibrate_camera(const CameraCalibrationOptions& options, const StopToken& stop) {
  if (options.rolling_shutter && options.chromatic)
    return fail(ErrorCode::bad_input, "--chromatic",
                "expected one of --rolling-shutter and --chromatic at a time: fit the one with -o, and the "
                "other with that sensor model as --base");
  const auto board = parse_board(options.target);
  if (!board) return tl::unexpected<Error>(board.error());
  CameraFitOptions fit_options;
  fit_options.robust = !options.all_corners;
  fit_options.start_fx_px = options.start_fx_px;
  fit_options.stop = stop;
  if (options.model != "auto") {
    const auto model = parse_lens_model(options.model);
    if (!model) return tl::unexpected<Error>(model.error());
    fit_options.models = {*model};
  }
  const auto views = read_board_views({.inputs = options.inputs,
                                       .channel = options.channel,
                                       .size = options.size,
                                       .report = options.looked_for_folder,
                                       .colours = options.chromatic,
                                       .rate_hz = options.rate_hz,
                                       .stop = stop},
                                      *board);
  if (!views) return tl::unexpected<Error>(views.error());
  ProgressTask fitting("fit", 1);
  fit_options.progress = [&](double share, double rms) {
    fitting.set(share);
    fitting.note(fmt::format("RMS {:.3g} px", rms));
  };
  auto fit = options.chromatic         ? fit_chromatic(views->colours, fit_options)
             : options.rolling_shutter ? fit_rolling_shutter(views->seen, fit_options,
                                                             {.longest_gap_s = 1e-3 * options.longest_gap_ms})
                                       : fit_camera(views->seen, fit_options);
  if (!fit) return tl::unexpected<Error>(fit.error());
  fitting.finish();

  CalibrationResult result;
  result.title = "Camera calibration";
  nlohmann::json& details = result.details.json();
  result.inputs = views->files;
  result.fit = fit->result;
  result.fit.interrupted = result.fit.interrupted || views->interrupted;
  for (const std::string& why : views->notes) result.fit.warnings.push_back(why);
  result.recipe = recipe_of(*fit);
  result.figures = figures_of(*fit, views->seen);
  if (options.twin) {
    const auto twin = simulate_board_twin(*fit, views->seen, *board, stop);
    if (twin) {
      for (Figure& figure : twin_figures(*fit, *twin)) result.figures.push_back(std::move(figure));
      details["twin"] = {{"rms_per_corner_px", twin->fit.rms_per_corner_px},
                         {"views", twin->views},
                         {"black_dn", twin->black_dn},
                         {"white_dn", twin->white_dn},
                         {"noise_dn", twin->noise_dn},
                         {"levels_measured", twin->measured}};
    } else {
      result.fit.warnings.push_back("no simulated twin: " + twin.error().text());
    }
  }
  details["rms_per_corner_px"] = fit->rms_per_corner_px;
  details["views"] = nlohmann::json::array();
  for (std::size_t v = 0; v < views->seen.size(); ++v) {
    const double rms = fit->view_rms_px[v];
    details["views"].push_back(
        {{"name", views->seen[v].name},
         {"corners", views->seen[v].points.size()},
         {"rms_px", std::isfinite(rms) ? nlohmann::json(rms) : nlohmann::json(nullptr)}});
  }
  result.base = options.base;
  return result;
}

}  // namespace rigor

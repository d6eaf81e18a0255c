#include <fmt/format.h>

#include <cmath>
#include <memory>

#include "bench/console/progress.h"
#include "calibration/camera/camera_fit.h"
#include "calibration/camera/chromatic.h"
#include "calibration/camera/rolling_shutter.h"
#include "cli/calibrate/board_twin.h"
#include "cli/calibrate/board_views.h"
#include "cli/calibrate/calibrate.h"
#include "rt-core/stop.h"

namespace rigor {
namespace {

using namespace calibration;

struct CalibrateCameraOptions : CalibrateOptions {
  std::string target;
  std::string size;  ///< WIDTHxHEIGHT of the pictures that a corner list is about
  double start_fx_px = 0;
  bool all_corners = false;  ///< no outlier is left out
  bool rolling_shutter = false, chromatic = false, twin = false;
  double rate_hz = 0, longest_gap_ms = 200;
};

SheetRecipe recipe_of(const CameraFit& fit) {
  SheetRecipe r;
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

int calibrate_camera(const CalibrateCameraOptions& options) {
  const auto wrong = [&](const Error& e) { return report_error(e, options.json); };
  if (options.rolling_shutter && options.chromatic)
    return wrong({ErrorCode::bad_input, "--chromatic",
                  "expected one of --rolling-shutter and --chromatic at a time: fit the one with -o, and the "
                  "other with that sheet as --base"});
  if (auto s = check_outputs(options); !s) return wrong(s.error());
  const auto board = parse_board(options.target);
  if (!board) return wrong(board.error());
  StopSource stop;
  CameraFitOptions fit_options;
  fit_options.robust = !options.all_corners;
  fit_options.start_fx_px = options.start_fx_px;
  fit_options.stop = stop.token();
  if (options.model != "auto") {
    const auto model = parse_lens_model(options.model);
    if (!model) return wrong(model.error());
    fit_options.models = {*model};
  }
  SignalStop signals(stop);
  const auto views = read_board_views({.inputs = options.inputs,
                                       .channel = options.channel,
                                       .size = options.size,
                                       .report = options.report,
                                       .colours = options.chromatic,
                                       .rate_hz = options.rate_hz,
                                       .stop = stop.token()},
                                      *board);
  if (!views) return wrong(views.error());
  ProgressTask fitting("fit", 1);
  fit_options.progress = [&](double share, double rms) {
    fitting.set(share);
    fitting.note(fmt::format("RMS {:.3g} px", rms));
  };
  auto fit = options.chromatic         ? fit_chromatic(views->colours, fit_options)
             : options.rolling_shutter ? fit_rolling_shutter(views->seen, fit_options,
                                                             {.longest_gap_s = 1e-3 * options.longest_gap_ms})
                                       : fit_camera(views->seen, fit_options);
  if (!fit) return wrong(fit.error());
  fitting.finish();

  CalibrationProduct product;
  product.title = "Camera calibration";
  product.inputs = views->files;
  product.fit = fit->result;
  product.fit.interrupted = product.fit.interrupted || views->interrupted;
  for (const std::string& why : views->notes) product.fit.warnings.push_back(why);
  product.recipe = recipe_of(*fit);
  product.figures = figures_of(*fit, views->seen);
  if (options.twin) {
    const auto twin = simulate_board_twin(*fit, views->seen, *board, stop.token());
    if (twin) {
      for (Figure& figure : twin_figures(*fit, *twin)) product.figures.push_back(std::move(figure));
      product.more["twin"] = {{"rms_per_corner_px", twin->fit.rms_per_corner_px},
                              {"views", twin->views},
                              {"black_dn", twin->black_dn},
                              {"white_dn", twin->white_dn},
                              {"noise_dn", twin->noise_dn},
                              {"levels_measured", twin->measured}};
    } else {
      product.fit.warnings.push_back("no simulated twin: " + twin.error().text());
    }
  }
  product.more["rms_per_corner_px"] = fit->rms_per_corner_px;
  product.more["views"] = nlohmann::json::array();
  for (std::size_t v = 0; v < views->seen.size(); ++v) {
    const double rms = fit->view_rms_px[v];
    product.more["views"].push_back(
        {{"name", views->seen[v].name},
         {"corners", views->seen[v].points.size()},
         {"rms_px", std::isfinite(rms) ? nlohmann::json(rms) : nlohmann::json(nullptr)}});
  }
  return finish_calibration(options, std::move(product));
}

}  // namespace

CalibrateSubcommand add_calibrate_camera(CLI::App& calibrate) {
  CommandOptions app(calibrate, "camera", "Intrinsics and lens from pictures of a board");
  auto options = std::make_shared<CalibrateCameraOptions>();
  add_common_options(
      app, *options,
      "Pictures, folders of pictures, recordings (.mcap), or lists of corners (.vnl, with --size)");
  app.add_option("--target", options->target,
                 "chessboard:9x6:0.025 (inner corners, square in metres), circles:…, asymmetric:…, "
                 "charuco:8x6:0.04:0.03[:DICTIONARY]")
      .required();
  app.add_option("--size", options->size, "WIDTHxHEIGHT of the pictures of a list of corners");
  app.add_option("--start-fx", options->start_fx_px, "Focal length in pixels to begin with").positive();
  app.add_flag("--all-corners", options->all_corners, "Leave no outlier out");
  app.add_flag("--rolling-shutter", options->rolling_shutter,
               "Fit the line time too, of a sequence in which the board or the camera moves; needs times: a "
               "recording, or --rate");
  app.add_option("--rate", options->rate_hz,
                 "Pictures a second, of a folder of pictures in the order of their names")
      .positive();
  app.add_option("--longest-gap-ms", options->longest_gap_ms,
                 "Views further apart do not say how the board moved between them (--rolling-shutter)")
      .positive();
  app.add_flag("--twin", options->twin,
               "Draw the same views with the fitted camera, find and fit them, and show both residuals");
  app.add_flag("--chromatic", options->chromatic,
               "Fit the magnification of red and blue too: colour pictures of a chessboard");
  app.footer(
      "Example: rigor calibrate camera left*.jpg --target chessboard:9x6:0.025 -o left.yaml --report report");
  return {app, [options] { return calibrate_camera(*options); }};
}

}  // namespace rigor

#include "calibration/procedures/lidar_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <numbers>

#include "bench/console/progress.h"
#include "calibration/lidar/lidar_fit.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recording_input.h"
#include "calibration/tof/twin.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

/// walls: [{ name: east, normal: [1, 0, 0], distance_m: 4.2, reflectance: 0.8 }, …] in the sensor's frame.
Result<std::vector<LidarPlane>> read_targets(const std::filesystem::path& file) {
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] {
    std::vector<LidarPlane> planes;
    for (const ConfigNode& n : root->list("walls")) {
      LidarPlane p;
      p.name = n.text("name");
      const auto normal = n.numbers("normal", 3);
      Eigen::Vector3d v(normal[0], normal[1], normal[2]);
      if (!(v.norm() > 0)) throw n.error("normal", "expected a direction, got zeros");
      p.q_per_m = v.normalized() / n.number("distance_m", {.min = 0, .exclusive_min = true});
      p.reflectance = n.number_or("reflectance", 0, {.min = 0, .max = 1});
      n.finish();
      planes.push_back(p);
    }
    root->finish();
    if (planes.empty()) throw root->error("walls", "expected at least one wall");
    return planes;
  });
}

struct Input {
  LidarReturns returns;
  std::vector<std::filesystem::path> files;
  std::vector<std::string> warnings;
};

Result<Input> read_returns(const LidarCalibrationOptions& options, const models::LidarScan& scan,
                           const StopToken& stop) {
  Input in;
  auto files = input_files(options.inputs, {".mcap", ".pcap", ".pcapng", ".cap", ".json"});
  if (!files) return tl::unexpected<Error>(files.error());
  in.files = *files;
  ReturnCollector collector(scan);
  for (const auto& file : in.files) {
    auto read = read_samples(file, options.channel, SampleKind::point_cloud, [&](const Sample& s) {
      const auto* info = s.as<PointCloudInfo>();
      if (!info || s.bytes().size() < info->count * sizeof(LidarPoint)) return true;
      std::vector<LidarPoint> points(info->count);
      std::memcpy(points.data(), s.bytes().data(), info->count * sizeof(LidarPoint));
      collector.add(points);
      return !stop.stop_requested();
    });
    if (!read) return tl::unexpected<Error>(read.error());
    in.warnings.insert(in.warnings.end(), read->warnings.begin(), read->warnings.end());
  }
  in.returns = collector.take();
  return in;
}

template <class Get>
std::string list_of(const models::LidarModel& m, const Get& get) {
  std::string s = "[";
  for (const auto& b : m.scan.beams) s += (s.size() > 1 ? ", " : "") + exact_text(get(b));
  return s + "]";
}

SensorModelRecipe recipe_of(const LidarFit& fit) {
  SensorModelRecipe r;
  r.kind = "lidar";
  constexpr double kDegrees = 180 / std::numbers::pi;
  const models::LidarModel& m = fit.model;
  const FitResult& f = fit.result;
  const auto place = [&](const std::string& parameter, const std::string& path, double scale, bool held_too) {
    const Parameter* p = f.find(parameter);
    if (!p || !std::isfinite(p->value)) return;
    if (!p->held) r.places.push_back({parameter, path, scale});
    if (!p->held || held_too) r.set.emplace_back(path, exact_text(p->value * scale));
  };
  for (const auto& [parameter, path, scale] : {std::tuple{"noise_floor_m", "noise.floor_mm", 1e3},
                                               {"noise_scale_m", "noise.scale_mm", 1e3},
                                               {"noise_offset", "noise.offset", 1.0},
                                               {"noise_exponent", "noise.exponent", 1.0},
                                               {"retro_sigma_m", "noise.retro_sigma_mm", 1e3},
                                               {"remission_noise", "remission.noise", 1.0},
                                               {"remission_scale", "remission.scale", 1.0},
                                               {"remission_bias_m", "range.remission_bias_mm", 1e3},
                                               {"incidence_bias_m", "range.incidence_bias_mm", 1e3},
                                               {"range_scale", "range.scale", 1.0},
                                               {"limit_remission", "detection.limit_remission", 1.0},
                                               {"minimum_remission", "detection.minimum_remission", 1.0}})
    place(parameter, path, scale, true);
  if (f.find("limit_remission"))
    r.set.emplace_back("detection.limit_range_m", exact_text(m.detection.limit_range_m));
  if (!fit.bias) return r;
  if (!f.find("remission_bias_m")) r.remove.emplace_back("range.remission_bias_mm");
  if (!f.find("incidence_bias_m")) r.remove.emplace_back("range.incidence_bias_mm");
  const BiasModel& k = fit.bias->model;
  if (k.offset) {
    r.remove.emplace_back("beams.bias_mm");
    r.set.emplace_back("range.bias_mm", exact_text(fit.bias->errors.front().bias_m * 1e3));
    r.places.push_back({"range_bias_m", "range.bias_mm", 1e3});
  }
  const auto each = [&](const char* name, const std::string& path, double scale) {
    for (std::size_t b = 0; b < m.scan.beams.size(); ++b) {
      const std::string parameter = fmt::format("{}[{}]", name, b);
      const Parameter* p = f.find(parameter);
      if (p && std::isfinite(p->sigma)) r.places.push_back({parameter, fmt::format("{}.{}", path, b), scale});
    }
  };
  if (k.beams) {
    r.remove.emplace_back("range.bias_mm");
    r.set.emplace_back("beams.bias_mm", list_of(m, [](const auto& b) { return b.range_bias_m * 1e3; }));
    each("beam_bias_m", "beams.bias_mm", 1e3);
  }
  if (k.angles) {
    r.set.emplace_back("beams.elevation_deg",
                       list_of(m, [&](const auto& b) { return b.elevation_rad * kDegrees; }));
    r.set.emplace_back("beams.azimuth_deg",
                       list_of(m, [&](const auto& b) { return b.azimuth_rad * kDegrees; }));
    each("beam_elevation_rad", "beams.elevation_deg", kDegrees);
    each("beam_azimuth_rad", "beams.azimuth_deg", kDegrees);
  }
  if (f.find("remission_gain[0]")) {
    r.set.emplace_back("beams.remission_gain", list_of(m, [](const auto& b) { return b.remission_gain; }));
    each("remission_gain", "beams.remission_gain", 1);
  }
  return r;
}

/// Counts of the twin in the bars that the histogram of the device has.
Series twin_curve(const std::vector<double>& device, const std::vector<double>& twin) {
  std::vector<double> v = device;
  std::sort(v.begin(), v.end());
  const auto at = [&](double q) {
    return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
  };
  double a = at(0.002), b = at(0.998);
  const double margin = 0.04 * (b - a);
  a -= margin, b += margin;
  const std::size_t bars = std::clamp<std::size_t>(v.size() / 8, 8, 80);
  Series s{"twin", {}, std::vector<double>(bars, 0), true};
  const double width = (b - a) / static_cast<double>(bars);
  for (std::size_t i = 0; i < bars; ++i) s.x.push_back(a + (static_cast<double>(i) + 0.5) * width);
  for (const double x : twin)
    if (x >= a && x < b) s.y[std::min(bars - 1, static_cast<std::size_t>((x - a) / width))] += 1;
  return s;
}

void noise_figures(const LidarFit& fit, std::vector<Figure>& figures) {
  const auto device = in_mm(fit.shots_m), twin = in_mm(fit.twin_m);
  if (!device.empty()) {
    Figure h{.kind = Figure::Kind::histogram,
             .title = "Noise of single shots, and of the simulated twin",
             .caption =
                 "Bars: the device, each shot about the mean of its spot. Line: its twin with the fitted "
                 "sensor model, shot for shot at the same remission.",
             .x_label = "range against the mean of its spot [mm]",
             .y_label = "shots"};
    h.series = {{"device", {}, device, false}, twin_curve(device, twin)};
    figures.push_back(h);
    Figure q{.kind = Figure::Kind::series,
             .title = "Quantiles of the noise, device and twin",
             .caption = "On the line both spread alike; ends that bend are tails that the model has not.",
             .x_label = "twin [mm]",
             .y_label = "device [mm]"};
    auto a = device, b = twin;
    std::sort(a.begin(), a.end()), std::sort(b.begin(), b.end());
    Series points{"quantiles", {}, {}, false}, line{"equal", {}, {}, true};
    for (int i = 1; i < 400; ++i) {
      const auto k = static_cast<std::size_t>(i * static_cast<double>(a.size()) / 400);
      points.x.push_back(b[k]), points.y.push_back(a[k]);
    }
    line.x = line.y = {points.x.front(), points.x.back()};
    q.series = {points, line};
    figures.push_back(q);
  }
  if (!fit.noise || fit.noise->bands.empty()) return;
  Figure n{.kind = Figure::Kind::series,
           .title = "Noise against remission",
           .caption =
               "Measured in bands with its uncertainty, rounding taken out; the model, and what it says of "
               "a band when it has not seen that band.",
           .x_label = "remission (1: a white matt plate)",
           .y_label = "standard deviation [mm]"};
  Series measured{"measured", {}, {}, false}, withheld{"withheld", {}, {}, false},
      model{"model", {}, {}, true};
  for (const NoiseBand& b : fit.noise->bands) {
    const double x = 0.5 * (b.from + b.to);
    for (const double k : {-1.0, 0.0, 1.0})
      measured.x.push_back(x), measured.y.push_back(1e3 * (b.measured_m + k * b.sigma_m));
    withheld.x.push_back(x), withheld.y.push_back(1e3 * b.withheld_m);
  }
  const double from = std::max(0.02, fit.noise->bands.front().from), to = fit.noise->bands.back().to;
  for (int i = 0; i <= 100; ++i) {
    const double x = from + (to - from) * i / 100;
    model.x.push_back(x), model.y.push_back(1e3 * fit.noise->model.sigma_m(x));
  }
  n.series = {measured, withheld, model};
  figures.push_back(n);
}

void bias_figures(const LidarFit& fit, const LidarReturns& returns, std::vector<Figure>& figures) {
  if (!fit.bias) return;
  const BiasFit& b = *fit.bias;
  if (b.model.beams) {
    Figure f{.kind = Figure::Kind::series,
             .title = "Range bias of each beam",
             .caption = "With bars of two standard uncertainties.",
             .x_label = "beam",
             .y_label = "bias [mm]"};
    Series value{"bias", {}, {}, false};
    std::vector<Series> bars;
    for (std::size_t i = 0; i < b.errors.size(); ++i) {
      const Parameter* p = fit.result.find(fmt::format("beam_bias_m[{}]", i));
      if (!p || !std::isfinite(p->sigma)) continue;
      for (int k = -20; k <= 20; ++k)
        value.x.push_back(static_cast<double>(i)),
            value.y.push_back(1e3 *
                              (p->value + 2 * p->sigma * k / 20 * (k % 20 == 0 || b.errors.size() < 40)));
    }
    f.series = {value};
    figures.push_back(f);
  }
  Figure before{
      .kind = Figure::Kind::series,
      .title = "Before and after",
      .caption = "Mean residual of each beam on each degree of the walls, without biases and with them.",
      .x_label = "azimuth [deg]",
      .y_label = "residual [mm]"};
  Series was{"before", {}, {}, false}, is{"after", {}, {}, false};
  std::map<std::tuple<int, int, int>, std::array<double, 2>> cells;
  for (std::size_t i = 0; i < returns.all.size(); ++i) {
    if (!b.used[i]) continue;
    auto& c = cells[{fit.planes.label[i], returns.all[i].beam,
                     static_cast<int>(std::floor(static_cast<double>(returns.all[i].azimuth_rad) * 180 /
                                                 std::numbers::pi))}];
    c[0] += 1e3 * static_cast<double>(b.residual_m[i]), c[1] += 1;
  }
  double mean = 0;
  for (const BeamErrors& e : b.errors) mean += e.bias_m / static_cast<double>(b.errors.size());
  for (const auto& [key, c] : cells) {
    const BeamErrors& e = b.errors[static_cast<std::size_t>(std::get<1>(key))];
    is.x.push_back(std::get<2>(key)), is.y.push_back(c[0] / c[1]);
    was.x.push_back(std::get<2>(key)), was.y.push_back(c[0] / c[1] + 1e3 * (e.bias_m - mean));
  }
  before.series = {was, is};
  figures.push_back(before);
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Residuals on the walls",
                   .caption =
                       "Bars: single returns, noise and the walls' own unevenness. Line: the simulated "
                       "twin by the fitted sensor model where its beams meet the fitted walls.",
                   .x_label = "residual [mm]",
                   .y_label = "returns"};
  const auto residuals = in_mm(fit.walls_m);
  if (residuals.empty()) return;
  histogram.series = {{"device", {}, residuals, false}, twin_curve(residuals, in_mm(fit.walls_twin_m))};
  figures.push_back(histogram);
  Figure quantiles{.kind = Figure::Kind::quantiles,
                   .title = "Q–Q plot of the residuals on the walls",
                   .caption = "On the line the residuals are normal."};
  quantiles.series = {{"", {}, residuals, false}};
  figures.push_back(quantiles);
}

nlohmann::json more_of(const LidarFit& fit, const LidarReturns& returns) {
  nlohmann::json j = {{"returns", returns.all.size()},
                      {"scans", returns.scans},
                      {"duplicate_scans", returns.duplicate_scans}};
  const auto number = [](double v) { return std::isfinite(v) ? nlohmann::json(v) : nlohmann::json(nullptr); };
  j["walls"] = nlohmann::json::array();
  if (fit.bias) {
    for (std::size_t k = 0; k < fit.bias->planes.size(); ++k) {
      const LidarPlane& p = fit.bias->planes[k];
      const Eigen::Vector3d n = p.q_per_m.normalized();
      j["walls"].push_back({{"name", p.name},
                            {"normal", {n.x(), n.y(), n.z()}},
                            {"distance_m", 1 / p.q_per_m.norm()},
                            {"returns", p.returns},
                            {"uneven_m", fit.bias->plane_sigma_m[k]}});
    }
    j["held_out_rms_m"] = number(fit.bias->held_out_rms_m);
    j["held_out_uncorrected_rms_m"] = number(fit.bias->held_out_uncorrected_m);
    j["held_out_ratio"] = number(fit.bias->held_out_rms_m / fit.bias->held_out_uncorrected_m);
    j["neighbour_correlation"] = fit.bias->neighbour_correlation;
    j["column_correlation"] = fit.bias->column_correlation;
    if (fit.bias->beams_differ_sigma_m > 0) j["beams_differ_sigma_m"] = fit.bias->beams_differ_sigma_m;
  }
  if (fit.noise) {
    j["shot_sigma_m"] = fit.noise->sigma_m;
    if (fit.noise->rounded_sigma_m > 0)
      j["shot_sigma_by_rounded_likelihood_m"] = {{"value", fit.noise->rounded_sigma_m},
                                                 {"sigma", number(fit.noise->rounded_sigma_uncertainty_m)}};
    j["noise_withheld_error"] = fit.noise->withheld_error;
    j["noise_bands"] = nlohmann::json::array();
    for (const NoiseBand& b : fit.noise->bands)
      j["noise_bands"].push_back({{"remission", {b.from, b.to}},
                                  {"measured_m", b.measured_m},
                                  {"sigma_m", b.sigma_m},
                                  {"model_m", b.model_m},
                                  {"withheld_m", b.withheld_m},
                                  {"shots", b.shots}});
  }
  return j;
}

/// Quantiles of the device's deviations and of its twin's.
nlohmann::json twin_of(const std::vector<double>& device, const std::vector<double>& twin) {
  const auto d = quantiles_of(device), t = quantiles_of(twin);
  return {{"quantiles", kTwinQuantiles}, {"device_m", d}, {"twin_m", t}};
}

}  // namespace

Result<CalibrationResult> calibrate_lidar(const LidarCalibrationOptions& options, const StopToken& stop) {
  if (options.base.empty())
    return fail(ErrorCode::bad_input, "--base",
                "expected the sensor model of this LiDAR's model (its beams and their angles), as in "
                "configs/sensors/velodyne-vlp16.yaml, got none");
  const auto sensor_model = load_lidar_model(options.base);
  if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
  LidarFitOptions fit_options;
  fit_options.model = options.model;
  fit_options.noise_model = options.noise_model;
  fit_options.stop = stop;
  if (!options.targets.empty()) {
    auto walls = read_targets(options.targets);
    if (!walls) return tl::unexpected<Error>(walls.error());
    fit_options.surveyed = *walls;
  }
  auto input = read_returns(options, sensor_model->scan, stop);
  if (!input) return tl::unexpected<Error>(input.error());
  ProgressTask fitting("fit", 1);
  fit_options.progress = [&](double share, double rms) {
    fitting.set(share);
    fitting.note(fmt::format("RMS {:.2f} mm", 1e3 * rms));
  };
  auto fit = fit_lidar(input->returns, *sensor_model, fit_options);
  if (fit) fitting.finish();
  if (!fit) {
    Error e = fit.error();
    if (e.where.empty()) e.where = input->files.front().string();
    return tl::unexpected<Error>(e);
  }
  CalibrationResult result;
  result.title = "LiDAR calibration";
  nlohmann::json& details = result.details.json();
  result.inputs = input->files;
  if (!options.targets.empty()) result.inputs.push_back(options.targets);
  result.fit = fit->result;
  result.fit.warnings.insert(result.fit.warnings.begin(), input->warnings.begin(), input->warnings.end());
  result.recipe = recipe_of(*fit);
  bias_figures(*fit, input->returns, result.figures);
  noise_figures(*fit, result.figures);
  details = more_of(*fit, input->returns);
  if (!fit->shots_m.empty()) details["twin_of_noise"] = twin_of(fit->shots_m, fit->twin_m);
  if (!fit->walls_m.empty()) details["twin_on_walls"] = twin_of(fit->walls_m, fit->walls_twin_m);
  for (const WeakDirection& w : fit->result.weak)
    if (!w.cure.empty() &&
        std::find(result.record_next.begin(), result.record_next.end(), w.cure) == result.record_next.end())
      result.record_next.push_back(w.cure);
  result.base = options.base;
  return result;
}

}  // namespace rigor

#include "calibration/procedures/tof_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/console/progress.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/tof_figures.h"
#include "calibration/procedures/tof_inputs.h"
#include "calibration/procedures/tof_lens.h"
#include "calibration/procedures/tof_sensor_model.h"
#include "calibration/tof/drift_fit.h"
#include "calibration/tof/range_fit.h"
#include "calibration/tof/saturation.h"
#include "calibration/tof/twin.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

/// Which of the models that `--model` names belongs to what.
struct Chosen {
  std::optional<RangeModel> range;
  std::optional<NoiseLaw> noise;
  std::string drift = "auto";
};

Result<Chosen> parse_models(const std::string& text) {
  Chosen out;
  if (text == "auto") return out;
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    const std::string name = text.substr(at, end - at);
    at = end + 1;
    if (const auto r = parse_range_model(name)) {
      out.range = *r;
    } else if (const auto n = parse_noise_law(name)) {
      out.noise = *n;
    } else if (name == "white" || name == "random_walk" || name == "correlated" ||
               name == "correlated+random_walk") {
      out.drift = name;
    } else {
      std::string laws;
      for (const NoiseLaw law : kNoiseLaws) laws += ", " + std::string(noise_law_name(law));
      return fail(
          ErrorCode::bad_input, "--model",
          "expected auto, or names with commas between them: of the wiggling (none, harmonics1 … harmonics4, "
          "bspline, each with +amplitude), of the noise (" +
              laws.substr(2) +
              "), of a series (white, random_walk, correlated, correlated+random_walk); got " + name);
    }
  }
  return out;
}

void merge(FitResult& into, const FitResult& part, const std::string& what) {
  const Eigen::Index n = static_cast<Eigen::Index>(into.parameters.size()),
                     m = static_cast<Eigen::Index>(part.parameters.size());
  Eigen::MatrixXd c = Eigen::MatrixXd::Zero(n + m, n + m);
  if (n > 0) c.topLeftCorner(n, n) = into.covariance;
  if (m > 0) c.bottomRightCorner(m, m) = part.covariance;
  into.covariance = c;
  into.parameters.insert(into.parameters.end(), part.parameters.begin(), part.parameters.end());
  for (Candidate k : part.candidates) {
    k.name = what + ": " + k.name;
    into.candidates.push_back(std::move(k));
  }
  const auto append = [](auto& a, const auto& b) { a.insert(a.end(), b.begin(), b.end()); };
  append(into.weak, part.weak);
  append(into.warnings, part.warnings);
  append(into.rejected, part.rejected);
  for (const auto& span : part.validity)
    if (std::none_of(into.validity.begin(), into.validity.end(),
                     [&](const auto& s) { return s.name == span.name; }))
      into.validity.push_back(span);
  append(into.not_identifiable, part.not_identifiable);
  if (!part.model.empty()) into.model += (into.model.empty() ? "" : ",") + part.model;
  if (into.residuals.count == 0) into.residuals = part.residuals;
  into.interrupted = into.interrupted || part.interrupted;
}

nlohmann::json quantile_json(const std::vector<double>& real, const std::vector<double>& twin) {
  nlohmann::json out;
  const auto a = quantiles_of(real), b = quantiles_of(twin);
  for (std::size_t i = 0; i < kTwinQuantiles.size(); ++i) {
    out["quantile"].push_back(kTwinQuantiles[i]);
    out["recording_m"].push_back(a[i]);
    out["twin_m"].push_back(b[i]);
  }
  return out;
}

void add_drift(CalibrationResult& result, const DriftFit& fit, const std::string& where) {
  FitResult part = fit.result;
  part.model = "";
  merge(result.fit, part, "over time");
  result.fit.model += (result.fit.model.empty() ? "" : ",") + fit.result.model;
  const std::vector<double> twin = twin_of_series(fit, fit.series.size(), 1);
  for (Figure& f : drift_figures(fit, twin)) result.figures.push_back(std::move(f));
  std::vector<double> real(fit.series), other(twin);
  about_own_mean(real, fit.step_m), about_own_mean(other, fit.step_m);
  auto& j = result.details.json()["drift"];
  j = {{"series", where},
       {"readings", fit.series.size()},
       {"period_s", fit.period_s},
       {"step_m", fit.step_m},
       {"averaging_limit_readings", fit.averaging_limit},
       {"minimum_allan_deviation_m", fit.minimum_deviation_m},
       {"minimum_at_s", fit.minimum_tau_s},
       {"twin", quantile_json(real, other)}};
  j["allan"] = nlohmann::json::array();
  for (const AllanPoint& p : fit.allan)
    j["allan"].push_back({{"tau_s", p.tau_s},
                          {"readings", p.averaged},
                          {"deviation_m", p.deviation},
                          {"low_m", p.low},
                          {"high_m", p.high},
                          {"degrees_of_freedom", p.freedom},
                          {"noise_exponent", p.exponent}});
  if (fit.averaging_limit == 0)
    result.record_next.push_back(
        "a longer recording at rest: averaging still helps at its end, so that drift is not "
        "seen yet");
}

/// Mean of each frame over the pixels that all frames of the scene have.
std::vector<double> frame_means(const TofScenes& scenes, const TofScene& scene) {
  std::vector<double> sum(scene.frames.size(), 0);
  std::size_t count = 0;
  for (std::size_t p = 0; p < scenes.pixels(); ++p) {
    const bool all = std::all_of(scene.frames.begin(), scene.frames.end(),
                                 [&](std::size_t i) { return std::isfinite(scenes.frames[i].range_m[p]); });
    if (!all) continue;
    ++count;
    for (std::size_t k = 0; k < scene.frames.size(); ++k) sum[k] += scenes.frames[scene.frames[k]].range_m[p];
  }
  if (count == 0) return {};
  for (double& v : sum) v /= static_cast<double>(count);
  return sum;
}

/// Depths become ranges where the rays are known.
void to_ranges(std::vector<TofFrame>& frames, const models::TofModel& model) {
  const CameraModel camera = model.camera();
  for (TofFrame& f : frames)
    for (std::size_t p = 0; p < f.range_m.size(); ++p) {
      const auto width = static_cast<std::size_t>(f.width_px);
      const auto ray =
          unproject_ray(camera, {static_cast<double>(p % width), static_cast<double>(p / width)});
      f.range_m[p] = ray && ray->z > 0.05
                         ? static_cast<float>(f.range_m[p] * std::hypot(ray->x, ray->y, ray->z) / ray->z)
                         : std::numeric_limits<float>::quiet_NaN();
    }
}

Result<CalibrationResult> series_calibration(const TofCalibrationOptions& o, const Chosen& chosen,
                                             const std::vector<std::filesystem::path>& files,
                                             const StopToken& stop) {
  CalibrationResult result;
  result.title = "Time of flight: readings over time";
  result.recipe.kind = "tof";
  if (files.size() != 1)
    return fail(ErrorCode::bad_input, "INPUT",
                "expected one series of readings at a time, got several CSV files");
  const auto series = read_series(files[0], o.unit, o.period_s);
  if (!series) return tl::unexpected<Error>(series.error());
  std::optional<ProgressTask> fitting(std::in_place, fmt::format("fit {} readings", series->range_m.size()));
  const auto fit = fit_drift(series->range_m, series->period_s,
                             {.model = chosen.drift, .name = files[0].filename().string(), .stop = stop});
  fitting.reset();
  if (!fit) return tl::unexpected<Error>(fit.error());
  result.inputs = files;
  add_drift(result, *fit, files[0].filename().string());
  result.fit.residuals = fit->result.residuals;
  for (const std::string& w : series->warnings) result.fit.warnings.push_back(w);
  result.fit.not_identifiable.emplace_back(
      "noise against amplitude",
      "the series has no amplitudes; record them, on surfaces of several remissions");
  result.base = o.base;
  return result;
}

/// The model's rays become those of the lens that was found.
void use_lens(const TofLens& lens, models::TofModel& model, CalibrationResult& result) {
  const CameraModel& c = lens.fit.camera;
  model.fx_px = c.fx_px, model.fy_px = c.fy_px, model.cx_px = c.cx_px, model.cy_px = c.cy_px;
  model.lens = c.lens;
  merge(result.fit, lens.fit.result, "lens");
  result.fit.residuals = lens.fit.result.residuals;
  for (const std::string& n : lens.notes) result.fit.warnings.push_back(n);
  for (const Figure& f : lens.figures) result.figures.push_back(f);
  auto& j = result.details.json()["lens"];
  j = {{"model", lens.fit.result.model},
       {"rms_per_corner_px", lens.fit.rms_per_corner_px},
       {"pictures", lens.frames},
       {"with_board", lens.boards}};
  for (std::size_t v = 0; v < lens.view_names.size(); ++v)
    j["views"].push_back(
        {{"name", lens.view_names[v]},
         {"rms_px", std::isfinite(lens.fit.view_rms_px[v]) ? nlohmann::json(lens.fit.view_rms_px[v])
                                                           : nlohmann::json(nullptr)}});
}

}  // namespace

Result<CalibrationResult> calibrate_tof(const TofCalibrationOptions& o, const StopToken& stop) {
  const auto chosen = parse_models(o.model);
  if (!chosen) return tl::unexpected<Error>(chosen.error());
  std::vector<std::filesystem::path> recordings, series;
  if (!o.inputs.empty()) {
    const auto files = input_files(o.inputs, {".mcap", ".csv"});
    if (!files) return tl::unexpected<Error>(files.error());
    for (const auto& f : *files) (f.extension() == ".csv" ? series : recordings).push_back(f);
  }
  if (o.board.empty() != o.target.empty())
    return fail(ErrorCode::bad_input, "--board",
                "expected --board RECORDING… and --target chessboard:9x6:0.03 together");
  if (!o.board.empty() && o.base.empty())
    return fail(ErrorCode::bad_input, "--board",
                "expected --base with it: the sensor model whose lens it replaces");
  if (recordings.empty() && o.raw.empty() && o.board.empty()) {
    if (series.empty())
      return fail(ErrorCode::bad_input, "INPUT",
                  "expected recordings (.mcap), a series (.csv), --raw or --board, got none");
    return series_calibration(o, *chosen, series, stop);
  }

  std::optional<models::TofModel> base;
  if (!o.base.empty()) {
    auto loaded = load_tof_model(o.base);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    base = *loaded;
  }
  CalibrationResult result;
  result.title = "Time-of-flight calibration";
  nlohmann::json& details = result.details.json();
  FitResult& fit = result.fit;
  std::optional<TofLens> lens;
  if (!o.board.empty()) {
    auto made = fit_tof_lens({.recordings = o.board,
                              .channel = o.channel,
                              .target = o.target,
                              .width_px = base->width_px,
                              .height_px = base->height_px,
                              .stop = stop});
    if (!made) return tl::unexpected<Error>(made.error());
    lens = std::move(*made);
    use_lens(*lens, *base, result);
    if (recordings.empty() && o.raw.empty()) {
      result.inputs = o.board;
      set_tof_model(result.recipe, fit, {.lens = &lens->fit});
      result.base = o.base;
      return result;
    }
  }
  TofInputs inputs;
  bool depth = false;
  std::optional<ProgressTask> progress(std::in_place, "read");
  if (auto s = add_recordings(recordings, o.channel, o.distances, inputs); !s)
    return tl::unexpected<Error>(s.error());
  for (const std::string& raw : o.raw)
    if (auto s = add_raw(raw, inputs, depth); !s) return tl::unexpected<Error>(s.error());
  if (base && depth) {
    for (const TofFrame& f : inputs.frames)
      if (f.width_px != base->width_px || f.height_px != base->height_px)
        return fail(ErrorCode::bad_input, f.name,
                    fmt::format("expected pictures of {}x{} px as the base sensor model has them, got {}x{}",
                                base->width_px, base->height_px, f.width_px, f.height_px));
    to_ranges(inputs.frames, *base);
  }
  progress.emplace("fit the noise");
  auto scenes = sort_scenes(std::move(inputs.frames), inputs.scene_of);
  if (!scenes) return tl::unexpected<Error>(scenes.error());

  result.inputs = inputs.files;
  result.inputs.insert(result.inputs.end(), o.board.begin(), o.board.end());
  for (const std::string& w : inputs.warnings) fit.warnings.push_back(w);
  for (const std::string& w : scenes->notes) fit.warnings.push_back(w);
  details["quantity"] = depth && !base ? "depth" : "range";

  // ---- noise against amplitude; once the wiggling is known, once more with it
  const bool counts = o.amplitude_unit.empty() ? !o.raw.empty() : o.amplitude_unit == "counts";
  bool repeated = false;
  for (const TofScene& s : scenes->scenes) repeated = repeated || s.frames.size() > 1;
  const bool temporal = o.noise == "temporal" || (o.noise == "auto" && repeated);
  models::TofModel model = base.value_or(models::TofModel{});
  if (!base) model.modulation.frequencies_hz = {1e5};  // where ranges wrap is not known: nowhere near
  model.modulation.waveform = models::TofWaveform::sine;
  model.modulation.harmonics = {};
  const auto measure = [&] {
    return temporal ? temporal_noise(*scenes, model)
                    : spatial_noise(scenes->frames, {.window_px = o.window_px});
  };
  auto noise = measure();
  NoiseLawOptions law_options;
  if (chosen->noise) law_options.laws = {*chosen->noise};
  Result<NoiseLawFit> law = fail(ErrorCode::bad_input, "", "");
  if (noise) law = fit_noise_law(noise->bins, law_options);

  // ---- planes at known distances
  const bool placed = std::any_of(scenes->scenes.begin(), scenes->scenes.end(),
                                  [](const TofScene& s) { return std::isfinite(s.distance_m); });
  std::optional<RangeFit> ranges;
  if (placed && !base)
    return fail(
        ErrorCode::bad_input, "--distances",
        "expected --base with it: where rays go and where ranges wrap stands in the camera's sensor model");
  if (placed) {
    RangeFitOptions ro;
    if (chosen->range) ro.models = {*chosen->range};
    ro.distance_sigma_m = o.distance_sigma_m;
    ro.stop = stop;
    progress.emplace("fit the ranges", 1);
    ro.progress = [&](double share, double) { progress->set(share); };
    models::TofModel start = *base;
    auto r = fit_ranges(*scenes, start, law ? &law->noise : nullptr, ro);
    if (!r) return tl::unexpected<Error>(r.error());
    ranges = std::move(*r);
    progress.emplace("fit");
    merge(fit, ranges->result, "wiggling");
    fit.residuals = ranges->result.residuals;
    fit.scale = ranges->result.scale;
    details["distance_sigma_m"] = ranges->distance_sigma_m;
    for (const SceneFit& s : ranges->scenes)
      details["scenes"].push_back({{"name", s.name},
                                   {"distance_m", s.distance_m},
                                   {"error_m", s.error_m},
                                   {"rms_m", s.rms_m},
                                   {"samples", s.samples},
                                   {"rejected", s.rejected},
                                   {"wrapped", s.wrapped},
                                   {"used", s.used}});
    if (!ranges->model.spline && temporal && law) {
      model.modulation.waveform = models::TofWaveform::harmonics;
      model.modulation.harmonics = ranges->harmonics;
      noise = measure();
      if (noise) law = fit_noise_law(noise->bins, law_options);
    }
    for (Figure& f : range_figures(*ranges, scenes->width_px)) result.figures.push_back(std::move(f));
    if (ranges->scenes.size() == 1)
      result.record_next.push_back(
          "the plane at eight distances or more, over an eighth of the modulation's "
          "wavelength (1.25 m at 30 MHz) and beyond");
  } else {
    fit.not_identifiable.emplace_back(
        "wiggling, range_offset_m",
        "no distances are known; record a plane at known distances (--distances)");
  }

  if (law) {
    merge(fit, law->result, "noise");
    if (!ranges) fit.residuals = law->result.residuals;
    details["noise"] = {{"estimator", noise->estimator + (depth && !base ? "; of depth, not range" : "")},
                        {"law", noise_law_name(law->noise.law)},
                        {"residual", law->misfit},
                        {"unexplained", law->tau},
                        {"amplitude_unit", counts ? "counts" : "electrons"}};
    if (!temporal) details["noise"]["window_px"] = o.window_px;
    for (std::size_t i = 0; i < law->all.size(); ++i)
      details["noise"]["laws"].push_back({{"name", noise_law_name(law->all[i].law)},
                                          {"residual", law->misfits[i]},
                                          {"coefficients", law->all[i].c}});
    for (const NoiseBin& b : noise->bins)
      details["noise"]["groups"].push_back(
          {{"amplitude", b.amplitude}, {"sigma_m", std::sqrt(b.variance_m2)}, {"samples", b.samples}});
    // What the model's pixel needs: its own law, whichever describes the recording best.
    PixelNoise pixel;
    FitResult physical;
    if (base) {
      Result<NoiseLawFit> own = law;
      if (law->noise.law != NoiseLaw::shot_read && law->noise.law != NoiseLaw::shot_read_floor)
        own = fit_noise_law(noise->bins,
                            {.laws = {temporal ? NoiseLaw::shot_read : NoiseLaw::shot_read_floor}});
      if (own && !temporal && !o.raw.empty() && own->noise.law == NoiseLaw::shot_read_floor)
        fit.warnings.push_back(
            "of the noise's floor 0.289 mm is the rounding of the ranges to whole millimetres");
      if (own) physical = pixel_noise(*own, *base, counts, pixel, o.raw.empty() ? 0 : 1e-3);
      merge(fit, physical, "pixel");
    }
    const std::vector<double> twin = pixel.contrast > 0 && pixel.contrast <= 1
                                         ? twin_of_pixel(noise->samples, pixel, *base, 1)
                                         : twin_of_law(noise->samples, law->noise, 1);
    std::vector<double> real;
    for (const NoiseSample& s : noise->samples) real.push_back(s.deviation_m);
    details["noise"]["twin"] = quantile_json(real, twin);
    for (Figure& f : noise_figures(*noise, *law, twin)) result.figures.push_back(std::move(f));
  } else {
    fit.not_identifiable.emplace_back("noise against amplitude",
                                      noise ? law.error().message : noise.error().message);
  }

  // ---- saturation
  if (placed && !counts) {
    const Parameter* c = fit.find("contrast");
    models::TofModel own = *base;
    if (!ranges->model.spline) {
      own.modulation.waveform = models::TofWaveform::harmonics;
      own.modulation.harmonics = ranges->harmonics;
    }
    merge(fit,
          full_well(*scenes, own, c && c->value > 0 && c->value <= 1 ? c->value : base->modulation.contrast),
          "saturation");
  }
  if (std::isfinite(scenes->ceiling)) details["saturation_amplitude"] = scenes->ceiling;
  details["saturated"] = scenes->saturated;
  details["duplicates"] = scenes->duplicates;
  details["without_range"] = scenes->empty;

  // ---- over time: the longest scene at rest
  const TofScene* longest = nullptr;
  for (const TofScene& s : scenes->scenes)
    if (!longest || s.frames.size() > longest->frames.size()) longest = &s;
  if (longest && longest->frames.size() >= 100) {
    const std::vector<double> means = frame_means(*scenes, *longest);
    const double span =
        scenes->frames[longest->frames.back()].t_s - scenes->frames[longest->frames.front()].t_s;
    const double period =
        o.period_s > 0 ? o.period_s : span / static_cast<double>(longest->frames.size() - 1);
    if (!means.empty() && period > 0) {
      const auto drift =
          fit_drift(means, period, {.model = chosen->drift, .name = longest->name, .stop = stop});
      if (drift)
        add_drift(result, *drift, longest->name + ", mean over the picture");
      else
        fit.warnings.push_back(drift.error().text());
    }
  } else {
    fit.not_identifiable.emplace_back("drift",
                                      "expected at least 100 frames of one scene at rest to tell it, got " +
                                          std::to_string(longest ? longest->frames.size() : 0));
  }
  progress.reset();
  fit.interrupted = stop.stop_requested();
  const Parameter* electrons = fit.find("electrons_per_count");
  set_tof_model(result.recipe, fit,
                {.ranges = ranges ? &*ranges : nullptr,
                 .lens = lens ? &lens->fit : nullptr,
                 .electrons_per_amplitude = !counts     ? 1
                                            : electrons ? electrons->value
                                                        : std::numeric_limits<double>::quiet_NaN()});
  result.base = o.base;
  return result;
}

}  // namespace rigor

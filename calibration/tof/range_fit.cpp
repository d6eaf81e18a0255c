#include "calibration/tof/range_fit.h"

#include <fmt/format.h>
#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/chi_squared.h"
#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/tof/range_problem.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

/// Standard deviation of values whose own variances are known: maximum likelihood for independent normal
/// values of variance s² + v, by Newton's method; and its uncertainty.
std::pair<double, double> spread_beyond(const std::vector<double>& x, const std::vector<double>& v) {
  double square = 0;
  for (std::size_t i = 0; i < x.size(); ++i) square += (x[i] * x[i] - v[i]) / static_cast<double>(x.size());
  double s2 = std::max(square, 0.0), information = 0;
  for (int k = 0; k < 30; ++k) {
    double slope = 0;
    information = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      const double w = 1 / (s2 + v[i]);
      slope += 0.5 * w * (x[i] * x[i] * w - 1);
      information += 0.5 * w * w;
    }
    const double next = std::max(0.0, s2 + slope / information);
    const bool stays = std::abs(next - s2) <= 1e-12 * (next + 1e-300);
    s2 = next;
    if (stays) break;
  }
  const double sigma = std::sqrt(s2);
  // Of s², carried over to s.
  return {sigma,
          sigma > 0 ? std::sqrt(1 / information) / (2 * sigma) : std::sqrt(std::sqrt(1 / information))};
}

std::vector<RangeModel> models_for(std::size_t scenes, bool amplitudes) {
  std::vector<RangeModel> out{{}};
  for (int h = 1; h <= 4; ++h)
    if (scenes > static_cast<std::size_t>(h) + 1) out.push_back({h, false, false});
  // One more unknown than offset and error of amplitude need.
  if (scenes >= 6) out.push_back({0, true, false});
  if (amplitudes && scenes >= 3) {
    const std::size_t n = out.size();
    for (std::size_t i = 0; i < n; ++i)
      if (!out[i].spline && scenes > static_cast<std::size_t>(out[i].harmonics) + 2)
        out.push_back({out[i].harmonics, false, true});
  }
  std::stable_sort(out.begin(), out.end(), [](const RangeModel& a, const RangeModel& b) {
    return std::make_tuple(a.spline, a.harmonics + (a.amplitude ? 1 : 0)) <
           std::make_tuple(b.spline, b.harmonics + (b.amplitude ? 1 : 0));
  });
  return out;
}

void advise(FitResult& r, std::size_t scenes) {
  for (WeakDirection& w : r.weak) {
    bool wiggling = false, amplitude = false, offset = false;
    for (const auto& part : w.parts) {
      wiggling = wiggling || part.name.starts_with("harmonic") || part.name.starts_with("spline");
      amplitude = amplitude || part.name.starts_with("amplitude");
      offset = offset || part.name.starts_with("range_offset");
    }
    if (wiggling && scenes == 1) w.words += ": at a single distance wiggling is not told from the offset";
    if (wiggling)
      w.cure =
          "record the plane at distances over an eighth of the modulation's wavelength and more "
          "(1.25 m at 30 MHz), a tenth of that apart";
    if (amplitude)
      w.cure += std::string(w.cure.empty() ? "" : "; ") +
                "record surfaces of several remissions, or integration times, at each distance";
    if (offset && w.cure.empty()) w.cure = "record the plane at more distances";
  }
}

}  // namespace

std::string RangeModel::name() const {
  const std::string base = spline          ? "bspline"
                           : harmonics > 0 ? "harmonics" + std::to_string(harmonics)
                                           : "none";
  return base + (amplitude ? "+amplitude" : "");
}

Result<RangeModel> parse_range_model(const std::string& name) {
  std::string names;
  for (const bool amplitude : {false, true})
    for (const bool spline : {false, true})
      for (int h = 0; h <= (spline ? 0 : 4); ++h) {
        const RangeModel m{h, spline, amplitude};
        if (m.name() == name) return m;
        names += (names.empty() ? "" : ", ") + m.name();
      }
  return fail(ErrorCode::bad_input, "--model", "expected auto or one of " + names + ", got " + name);
}

Result<RangeFit> fit_ranges(const TofScenes& scenes, const models::TofModel& model,
                            const NoiseCoefficients* noise, const RangeFitOptions& options) {
  if (scenes.width_px != model.width_px || scenes.height_px != model.height_px)
    return fail(ErrorCode::bad_input, scenes.frames.front().name,
                fmt::format("expected pictures of {}x{} px as the base sensor model has them, got {}x{}",
                            model.width_px, model.height_px, scenes.width_px, scenes.height_px));
  RangeProblem problem(scenes, model, noise, options.distance_sigma_m, options.reject_sigmas);
  if (problem.scenes().empty())
    return fail(ErrorCode::bad_input, scenes.frames.front().name,
                "expected pictures of a plane at known distances (--distances 0.5,1,1.5 … in metres, one for "
                "each recording), got none");
  const std::size_t count = problem.scenes().size();
  std::vector<RangeModel> models = options.models;
  const bool automatic = models.empty();
  if (automatic) models = models_for(count, problem.has_amplitudes());
  // One distance alone: the base's wiggling stands, and what is free is found on the model that asks for it.
  if (automatic && count == 1) models = {RangeModel{1, false, false}};

  RangeFit out;
  RangeState state = problem.start(models.back());
  const auto tell = [&](double share) {
    if (options.progress) options.progress(share, state.scale_m);
  };
  // Outliers are what the most flexible model cannot explain: all models are compared on the rest.
  problem.reject(models.back(), state, options.stop);
  tell(0.4);

  std::vector<Candidate> candidates;
  std::vector<RangeState> states;
  for (std::size_t m = 0; m < models.size(); ++m) {
    RangeState s = problem.start_from(models[m], state);
    problem.solve(models[m], s, 8, 1, nullptr);
    Candidate c;
    c.name = models[m].name();
    c.parameters = 1 + problem.parameters(models[m]);
    c.rms = s.rms_m;
    c.bic = s.minus_two_log_likelihood + c.parameters * std::log(static_cast<double>(s.samples));
    c.cross_validation = kNaN;
    const auto folds = std::min<std::size_t>(static_cast<std::size_t>(std::max(0, options.folds)), count);
    if (models.size() > 1 && folds > 1 && count >= 3 && !options.stop.stop_requested()) {
      // A pattern of pixels tells the same as all of them.
      const std::size_t stride = std::max<std::size_t>(1, scenes.pixels() / 3000);
      std::vector<double> squares(count, kNaN);
      for (std::size_t f = 0; f < folds; ++f) {
        std::vector<bool> take(count, true);
        for (std::size_t k = f; k < count; k += folds) take[k] = false;
        if (std::count(take.begin(), take.end(), true) < 1) continue;
        RangeState part = s;
        problem.solve(models[m], part, 3, stride, &take);
        for (std::size_t k = f; k < count; k += folds)
          squares[k] = std::pow(problem.withheld_error_m(models[m], part, k, stride), 2);
      }
      set_cross_validation(c, std::move(squares));
    }
    candidates.push_back(c);
    states.push_back(std::move(s));
    tell(0.4 + 0.5 * static_cast<double>(m + 1) / static_cast<double>(models.size()));
    if (options.stop.stop_requested()) break;
  }
  const std::size_t chosen = choose_model(candidates);
  out.model = models[chosen];
  state = std::move(states[chosen]);
  if (models.size() > 1) problem.reject(out.model, state, options.stop);
  problem.solve(out.model, state, 30, 1, nullptr);

  // ---- values and their covariance
  FitResult& r = out.result;
  r.interrupted = options.stop.stop_requested();
  r.model = out.model.name();
  r.candidates = std::move(candidates);
  r.scale = state.scale;
  const RangeProblem::Information info = problem.information(out.model, state);
  r.parameters = info.parameters;
  r.weak = weak_directions(r.parameters, info.matrix);
  r.covariance = covariance_from(r.parameters, info.matrix);
  out.curve = problem.curve(out.model, state, r.covariance);
  // 3 and 5 both turn the phase with four times itself, by a5 − a3 to first order; 7 and 9 with eight times.
  // Of a model that was asked for the second is 0; where the data chose, it is not known to be.
  const bool alone = !out.model.spline && (out.model.harmonics == 1 || out.model.harmonics == 3);
  if (alone && models.size() > 1) {
    RangeModel both = out.model;
    ++both.harmonics;
    const auto compared = std::find(models.begin(), models.end(), both) - models.begin();
    RangeState next = static_cast<std::size_t>(compared) < states.size()
                          ? states[static_cast<std::size_t>(compared)]
                          : problem.start_from(both, state);
    problem.solve(both, next, 8, 1, nullptr);
    r.covariance = problem.with_next_harmonic(out.model, state, next, r.covariance);
    for (std::size_t i = 0; i < r.parameters.size(); ++i)
      r.parameters[i].sigma =
          std::sqrt(r.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(i)));
  }
  out.distance_sigma_m = state.distance_sigma_m;
  out.distance_sigma_estimated = problem.estimates_distance_sigma() && state.distance_freedom > 0;
  if (out.distance_sigma_estimated) {
    // The scatter of few scenes is itself a guess: intervals as wide as Student's t makes them.
    const double widen = student_widening(std::max(1.0, state.distance_freedom));
    r.covariance *= widen * widen;
    for (Parameter& p : r.parameters) p.sigma *= widen;
    for (RangeFit::CurvePoint& p : out.curve) p.sigma_m *= widen;
  }
  advise(r, count);
  out.offset_m = r.parameters.front().value;
  for (std::size_t h = 0; h < 4; ++h) out.harmonics[h] = state.harmonics[h];
  out.amplitude_error = problem.amplitude_error(state);
  if (out.model.spline) out.spline = {problem.spline().from, problem.spline().to, state.spline};

  // ---- pixels
  out.pixel_offset_m.assign(scenes.pixels(), std::numeric_limits<float>::quiet_NaN());
  std::vector<double> offsets, variances;
  const double s2 = state.scale * state.scale;
  for (std::size_t p = 0; p < scenes.pixels(); ++p) {
    if (!(state.weight[p] > 0)) continue;
    const double d = state.pixel_m[p] - out.offset_m;
    out.pixel_offset_m[p] = static_cast<float>(d);
    offsets.push_back(d);
    variances.push_back(s2 / state.weight[p]);
  }
  // The mean, and how the offsets run along x and y, are taken out of them: three numbers fewer.
  const auto n_pixels = static_cast<double>(offsets.size());
  for (double& d : offsets) d *= std::sqrt(n_pixels / std::max(1.0, n_pixels - 3));
  const bool once = problem.samples_per_pixel() < 1.5;
  if (offsets.size() > 10 && !once) {
    const auto [sigma, uncertainty] = spread_beyond(offsets, variances);
    out.pattern_sigma_m = sigma;
    const Eigen::Index n = r.covariance.rows();
    r.covariance.conservativeResize(n + 1, n + 1);
    r.covariance.row(n).setZero();
    r.covariance.col(n).setZero();
    r.covariance(n, n) = uncertainty * uncertainty;
    r.parameters.push_back({"pixel_offset_sigma_m", sigma, uncertainty, 1e-3 * model.unambiguous_range_m()});
    if (sigma < 2 * uncertainty)
      r.not_identifiable.emplace_back(
          "pixel_offset_sigma_m", fmt::format("the pixels' offsets are not told from noise: below {:.3g} m",
                                              sigma + 2 * uncertainty));
  } else {
    r.not_identifiable.emplace_back("pixel_offset_sigma_m",
                                    "each pixel was seen once: its offset is not told from its noise; record "
                                    "several frames");
  }

  // ---- what was left out, what remains
  problem.report_rejected(state, r);
  std::vector<double> residuals = problem.residuals(out.model, state, out.samples);
  const std::size_t rejected = r.residuals.rejected;
  r.residuals = statistics_of(residuals, "m");
  r.residuals.rejected = rejected;
  out.scenes = problem.scene_fits(out.model, state);
  double nearest = 1e300, farthest = 0, dim = 1e300, bright = 0;
  for (const SceneFit& s : out.scenes) {
    out.wrapped += s.wrapped;
    if (!s.used) continue;
    nearest = std::min(nearest, s.distance_m), farthest = std::max(farthest, s.distance_m);
  }
  r.validity = {{"distance_m", nearest, farthest}};
  for (const NoiseSample& s : out.samples)
    if (s.amplitude > 0) dim = std::min(dim, s.amplitude), bright = std::max(bright, s.amplitude);
  if (bright > 0) r.validity.push_back({"amplitude", dim, bright});
  if (out.wrapped > 0)
    r.warnings.push_back(
        fmt::format("{} ranges had wrapped at the unambiguous range of {:.4g} m and were put back",
                    out.wrapped, model.unambiguous_range_m()));
  if (noise && state.scale > 1.15)
    r.warnings.push_back(fmt::format(
        "residuals are {:.2f} times what the noise explains: something that the model has not "
        "(multipath, warming up, a plane that is none) makes them, and the uncertainties are larger "
        "than stated",
        state.scale));
  if (problem.estimates_distance_sigma()) {
    if (out.distance_sigma_estimated)
      r.warnings.push_back(
          fmt::format("how exact the distances are was not given (--distance-sigma): {:.2g} m was "
                      "estimated from {} scenes",
                      out.distance_sigma_m, count));
    else if (count > 1)
      r.warnings.push_back(
          fmt::format("how exact the distances are was not given (--distance-sigma) and {} scenes "
                      "are too few to tell: {:.2g} m was assumed",
                      count, out.distance_sigma_m));
  }
  if (alone)
    r.warnings.push_back(
        fmt::format("harmonic_{0} stands for {0} and {1} together: to first order both make the same "
                    "error of the range, and the data do not ask for more{2}",
                    out.model.harmonics * 2 + 1, out.model.harmonics * 2 + 3,
                    models.size() > 1 ? "; its sigma is that of an unknown second, the curve of the error is "
                                        "known better"
                                      : ""));
  tell(1);
  return out;
}

}  // namespace rigor::calibration

#include "calibration/photon/photon_fit.h"

#include <ceres/autodiff_cost_function.h>

#include <algorithm>
#include <cmath>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/photon/linearity.h"
#include "calibration/photon/photon_problem.h"
#include "calibration/photon/photon_residuals.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {

using namespace photon;

namespace {

double chi_square_z(double chi2, double dof) {  // Wilson & Hilferty
  if (dof < 1) return 0;
  return (std::cbrt(chi2 / dof) - (1 - 2 / (9 * dof))) / std::sqrt(2 / (9 * dof));
}

}  // namespace

Result<LeastSquares::Outcome> PhotonProblem::run(PhotonModel& m, bool robust, std::size_t without) const {
  LeastSquares problem;
  const double gain = m.p[kGain];
  double t_max = 1e-9;
  for (const std::size_t k : of(false)) t_max = std::max(t_max, level(k).settings.exposure_s);
  problem.add_block(
      m.p, {{"system_gain_dn_per_e", 0.1 * gain, 1e-9, 1e6, !plan_.light},
            {"black_level_dn", 1, -1e300, 1e300, !plan_.dark_level},
            {"read_noise_e", std::max(0.5 * m.p[kRead], 0.3 / gain), 0, 1e300, !plan_.dark_level},
            {"dark_current_e_per_s", std::max(0.5 * std::abs(m.p[kDark]), 0.3 / (gain * t_max)), -1e300,
             1e300, !plan_.dark_current},
            {"dark_doubling_k", 2, 1, 1000, !plan_.doubling},
            {"variance_offset_dn2", std::max(0.1 * std::abs(m.p[kOffset]), 1.0), -1e300, 1e300,
             plan_.dark_level}});
  if (m.two_gains)
    problem.add_block(m.upper,
                      {{"system_gain_above_dn_per_e", 0.1 * gain, 1e-9, 1e6, false},
                       {"variance_above_dn2", std::max(0.1 * m.upper[1], 1e-3), -1e300, 1e300, false}});
  if (plan_.dsnu)
    problem.add_block(&m.dsnu, {{"dsnu_e", std::max(0.5 * m.dsnu, 0.1 / gain), 0, 1e300, false}});
  if (plan_.prnu) problem.add_block(&m.prnu, {{"prnu", std::max(0.5 * m.prnu, 0.001), 0, 1, false}});
  if (plan_.full_well) problem.add_block(&m.full_well, {{"full_well_e", 0.1 * m.full_well, 1, 1e300, false}});
  for (const std::size_t k : of(false)) {
    const Whitening w = whitening(k, m);
    const PhotonFrame& s = level(k).settings;
    const double above = std::isfinite(s.temperature_c) ? s.temperature_c - out_.temperature_reference_c : 0;
    auto* functor = new DarkResidual{w, s.exposure_s, above};
    ceres::CostFunction* cost =
        w.with_variance ? static_cast<ceres::CostFunction*>(
                              new ceres::AutoDiffCostFunction<DarkResidual, 2, kModelParameters>(functor))
                        : new ceres::AutoDiffCostFunction<DarkResidual, 1, kModelParameters>(functor);
    problem.add(cost, {m.p}, static_cast<std::uint32_t>(k));
  }
  for (const std::size_t k : of(true)) {
    if (k == without) continue;
    problem.add_nuisance(&m.signal[k], 1);
    const Whitening w = whitening(k, m);
    if (m.two_gains && m.signal[k] > m.break_dn)
      problem.add(new ceres::AutoDiffCostFunction<UpperResidual, 2, kModelParameters, 2, 1>(
                      new UpperResidual{w, m.break_dn}),
                  {m.p, m.upper, &m.signal[k]}, static_cast<std::uint32_t>(k));
    else
      problem.add(new ceres::AutoDiffCostFunction<LightResidual, 2, kModelParameters, 1>(
                      new LightResidual{w, plan_.dark_level}),
                  {m.p, &m.signal[k]}, static_cast<std::uint32_t>(k));
  }
  const auto extra = static_cast<std::uint32_t>(st_.points.size());
  if (plan_.dsnu)
    problem.add(new ceres::AutoDiffCostFunction<DsnuResidual, 1, kModelParameters, 1>(
                    new DsnuResidual{dark_pattern_.value, dark_pattern_.sigma}),
                {m.p, &m.dsnu}, extra);
  if (plan_.prnu)
    problem.add(new ceres::AutoDiffCostFunction<PrnuResidual, 1, 1>(
                    new PrnuResidual{st_.light_pattern.value, st_.light_pattern.sigma}),
                {&m.prnu}, extra);
  if (plan_.full_well && m.two_gains && plateau_dn_ > m.p[kBlack] + m.break_dn)
    problem.add(new ceres::AutoDiffCostFunction<FullWellAboveResidual, 1, kModelParameters, 2, 1>(
                    new FullWellAboveResidual{plateau_dn_, plateau_sigma_dn_, m.break_dn}),
                {m.p, m.upper, &m.full_well}, extra);
  else if (plan_.full_well)
    problem.add(new ceres::AutoDiffCostFunction<FullWellResidual, 1, kModelParameters, 1>(
                    new FullWellResidual{plateau_dn_, plateau_sigma_dn_}),
                {m.p, &m.full_well}, extra);
  // The noise is known, so a fit without a degree of freedom has its uncertainty, too: a residual that is
  // always 0 says nothing and lets it pass.
  if (without == st_.points.size())
    problem.add(new ceres::AutoDiffCostFunction<Nothing, 1, kModelParameters>(new Nothing), {m.p}, extra);
  FitOptions o;
  o.robust = robust;
  o.whitened = true;
  o.threads = 1;
  o.unit = "standard deviations";
  o.stop = options_.stop;
  return problem.solve(o);
}

/// The weights depend on the gain: again until they stay.
Result<LeastSquares::Outcome> PhotonProblem::iterate(PhotonModel& m, bool robust, std::size_t without) const {
  auto out = run(m, robust, without);
  for (int i = 0; out && i < 3; ++i) {
    const double before = m.p[kGain];
    out = run(m, robust, without);
    if (std::abs(m.p[kGain] - before) < 1e-9 * before) break;
  }
  return out;
}

double PhotonProblem::best_break(PhotonModel& two) const {
  std::vector<std::size_t> light = of(true);
  std::sort(light.begin(), light.end(),
            [&](std::size_t a, std::size_t b) { return st_.points[a].mean_dn < st_.points[b].mean_dn; });
  const auto x = [&](std::size_t i) { return st_.points[light[i]].mean_dn - two.p[kBlack]; };
  const auto y = [&](std::size_t i) { return st_.points[light[i]].variance_dn2; };
  const double noise = two.p[kGain] * two.p[kGain] * two.p[kRead] * two.p[kRead] + two.p[kOffset];
  double best = 1e300;
  PhotonModel found = two;
  for (std::size_t i = 1; i + 2 < light.size(); ++i) {
    if (x(i + 1) - x(i) < 0.02 * x(i)) continue;
    PhotonModel m = two;
    m.two_gains = true;
    m.break_dn = 0.5 * (x(i) + x(i + 1));
    m.break_sigma_dn = (x(i + 1) - x(i)) / std::sqrt(12.0);
    // From below and from above: the one line through all is no start for two.
    const double slope = (y(i) - noise) / x(i);
    const std::size_t last = light.size() - 1;
    const double above = (y(last) - y(i + 1)) / (x(last) - x(i + 1));
    if (!(slope > 0) || !(above > 0)) continue;
    m.p[kRead] *= m.p[kGain] / slope, m.dsnu *= m.p[kGain] / slope;
    m.full_well = plateau_dn_ > m.p[kBlack] + m.break_dn
                      ? m.break_dn / slope + (plateau_dn_ - m.p[kBlack] - m.break_dn) / above
                      : m.full_well * m.p[kGain] / slope;
    m.p[kDark] *= m.p[kGain] / slope;
    m.p[kGain] = slope;
    m.upper[0] = above;
    m.upper[1] = y(i + 1) - above * (x(i + 1) - m.break_dn);
    const auto out = run(m, false, st_.points.size());
    if (out && out->cost < best) best = out->cost, found = m;
  }
  two = found;
  return best < 1e300 ? found.break_dn : 0;
}

bool PhotonProblem::judge(PhotonModel& m, const char* name, int parameters, Candidate& c) const {
  c.name = name;
  const auto out = iterate(m, false, st_.points.size());
  if (!out) return false;
  c.parameters = parameters + 2 + (plan_.dark_level ? 1 : 0) + plan_.dark_current + plan_.doubling;
  c.rms = out->fit.residuals.rms;
  // The noise of each datum is known: −2 ln L is χ² itself.
  c.bic = 2 * out->cost + c.parameters * std::log(static_cast<double>(out->fit.residuals.count));
  std::vector<double> squares;
  for (const std::size_t k : of(true)) {
    PhotonModel fold = m;
    if (options_.stop.stop_requested()) return false;
    if (!run(fold, false, k)) {
      squares.push_back(kNaN);
      continue;
    }
    double r[2] = {0, 0};
    const Whitening w = whitening(k, m);
    const double signal = st_.points[k].mean_dn - fold.p[kBlack];
    if (fold.two_gains && signal > fold.break_dn)
      UpperResidual{w, fold.break_dn}(fold.p, fold.upper, &signal, r);
    else
      LightResidual{w, plan_.dark_level}(fold.p, &signal, r);
    squares.push_back(r[1] * r[1]);
  }
  set_cross_validation(c, std::move(squares));
  return true;
}

Result<PhotonModel> PhotonProblem::choose(PhotonModel one, std::vector<Candidate>& candidates) {
  const std::size_t lights = of(true).size();
  const bool automatic = options_.model == "auto";
  if (options_.model == "two_gains" && lights < 7)
    return fail(ErrorCode::bad_input, "--model",
                "expected at least 7 levels of light for two gains, got " + std::to_string(lights));
  PhotonModel probe = one;
  if (options_.model == "one_gain" || !run(probe, false, st_.points.size())) return one;
  look_for_bend(probe.p[kBlack]);
  if (options_.model == "one_gain_bent" && !bend_.bent.valid)
    return fail(
        ErrorCode::bad_input, "--model",
        "expected levels of light at five exposure times or more, from 5 to 90 % of the saturation, for a "
        "response that bends, got " +
            std::to_string(bend_.points.size()));
  PhotonModel two = probe, bent = one, chosen = one;
  const double at = lights >= 7 ? best_break(two) : 0;
  two.two_gains = true, two.break_dn = at;
  const bool with_bend = bend_.found || options_.model == "one_gain_bent";
  if (at <= 0 && !with_bend) return one;
  Candidate c;
  if (!judge(one, "one_gain", 0, c)) return one;
  c.bic += with_bend ? bend_.straight.chi2 : 0;
  candidates.push_back(c);
  chosen = one;
  if (c = {}; at > 0 && judge(two, "two_gains", 3, c)) {
    if (with_bend)
      c.bic += std::min(
          bend_.straight.chi2,
          broken_response_chi2(bend_.points, two.break_dn, two.upper[0] / two.p[kGain], bend_.flicker));
    candidates.push_back(c);
  }
  if (with_bend) {
    linearise(bend_.bent.response, probe.p[kBlack]);
    start(bent);
    if (c = {}; judge(bent, "one_gain_bent", bend_.bent.response.terms, c)) {
      c.bic += bend_.bent.chi2;
      candidates.push_back(c);
    }
    linearise({}, 0);
  }
  // What is looked for is found in noise, too: the BIC must be well for it, and for a second gain the
  // cross-validation, too. (What bends the signal by a percent is hardly seen in the variance.)
  std::vector<Candidate> judged = candidates;
  const std::size_t by_validation = choose_model(judged);
  std::size_t best = 0;
  for (std::size_t i = 1; i < candidates.size(); ++i) {
    candidates[i].note = judged[i].note;
    if (candidates[i].bic > candidates[best].bic - 10) continue;
    if (candidates[i].name == "two_gains" && with_bend == false && by_validation != i) continue;
    best = i;
  }
  for (std::size_t i = 0; !automatic && i < candidates.size(); ++i)
    if (candidates[i].name == options_.model) best = i;
  for (std::size_t i = 0; i < candidates.size(); ++i) candidates[i].chosen = i == best;
  if (candidates[best].name == "two_gains") chosen = two;
  if (candidates[best].name == "one_gain_bent") {
    linearise(bend_.bent.response, probe.p[kBlack]);
    chosen = bent;
  }
  return chosen;
}

Status PhotonProblem::dark_only() {
  // No photon transfer: nothing can be said in electrons.
  PhotonModel m;
  start(m);
  say_not_identifiable(m);
  FitResult& r = out_.result;
  r.model = "dark_only";
  for (const LevelPoint& p : st_.points)
    if (p.usable && plan_.dark_level) {
      r.parameters = {{"black_level_dn", p.mean_dn, std::sqrt(p.variance_dn2 / (p.pixels * p.frames)), 1},
                      {"dark_noise_dn", std::sqrt(std::max(0.0, p.variance_dn2)),
                       std::sqrt(p.fourth_dn4 * 2 / (p.frames - 1) / p.pixels) /
                           (2 * std::sqrt(std::max(1e-12, p.variance_dn2))),
                       1}};
      r.covariance = Eigen::MatrixXd::Zero(2, 2);
      r.covariance(0, 0) = r.parameters[0].sigma * r.parameters[0].sigma;
      r.covariance(1, 1) = r.parameters[1].sigma * r.parameters[1].sigma;
      break;
    }
  if (r.parameters.empty())
    return fail(ErrorCode::bad_input, "",
                "expected dark frames above 0 or light frames of two exposures or more below white, got " +
                    std::to_string(of(true).size()) + " usable levels of light and none of the dark");
  r.residuals.unit = "standard deviations";
  r.warnings = st_.warnings;
  return {};
}

Status PhotonProblem::fit() {
  const auto dark = of(false), light = of(true);
  plan_.dark_level = !dark.empty();
  plan_.light = light.size() >= (plan_.dark_level ? 1u : 2u);
  double t0 = 1e300, t1 = 0, temperature0 = 1e300, temperature1 = -1e300;
  for (const std::size_t k : dark) {
    const PhotonFrame& s = level(k).settings;
    t0 = std::min(t0, s.exposure_s), t1 = std::max(t1, s.exposure_s);
    if (std::isfinite(s.temperature_c)) {
      temperature0 = std::min(temperature0, s.temperature_c);
      temperature1 = std::max(temperature1, s.temperature_c);
    }
  }
  plan_.dark_current = plan_.dark_level && t1 > 1.5 * t0;
  if (temperature1 >= temperature0) out_.temperature_reference_c = temperature0;
  plan_.doubling = plan_.dark_current && temperature1 - temperature0 > 2;
  fixed_patterns(stacks_, out_.in_range, st_);
  dark_pattern_ = st_.dark_pattern_dn2;
  plan_.dsnu = plan_.dark_level && plan_.light && st_.dark_pattern_dn2.valid &&
               st_.dark_pattern_dn2.value > 3 * st_.dark_pattern_dn2.sigma;
  plan_.prnu =
      plan_.light && st_.light_pattern.valid && st_.light_pattern.value > 3 * st_.light_pattern.sigma;
  plan_.full_well = plan_.dark_level && plan_.light && plateau_dn_ > 0;
  if (!plan_.light) return dark_only();
  PhotonModel m;
  start(m);
  if (plan_.doubling) m.p[kDoubling] = 7;

  std::vector<Candidate> candidates;
  auto chosen = choose(m, candidates);
  if (!chosen) return tl::unexpected<Error>(chosen.error());
  m = *chosen;
  if (m.two_gains) {
    // The pattern of the gain is that of the light only below the change.
    std::vector<bool> below = out_.in_range;
    for (std::size_t k = 0; k < below.size(); ++k)
      below[k] = below[k] && (!level(k).settings.light || st_.points[k].mean_dn < m.p[kBlack] + m.break_dn);
    st_.light_pattern = {};
    fixed_patterns(stacks_, below, st_);
    plan_.prnu = st_.light_pattern.valid && st_.light_pattern.value > 3 * st_.light_pattern.sigma;
    if (plan_.prnu) m.prnu = std::sqrt(st_.light_pattern.value);
  }
  auto outcome = iterate(m, false, st_.points.size());
  if (!outcome) return tl::unexpected<Error>(outcome.error());
  if (unround_dark_pattern(m); plan_.dsnu) {
    outcome = iterate(m, false, st_.points.size());
    if (!outcome) return tl::unexpected<Error>(outcome.error());
  }
  const double unknowns = [&] {
    double u = static_cast<double>(light.size());
    for (const Parameter& p : outcome->fit.parameters) u += !p.held;
    return u;
  }();
  double dof = static_cast<double>(outcome->fit.residuals.count) - 1 - unknowns, chi2 = 2 * outcome->cost;
  if (dof >= 1 && chi_square_z(chi2, dof) > 3.7) {
    // Larger than the statistics of the frames: is it a single level, or all of them?
    if (dof > 6) {
      PhotonModel robust = m;
      if (auto again = iterate(robust, true, st_.points.size());
          again && !again->rejected_ids.empty() && again->rejected_ids.size() <= light.size() / 3) {
        outcome = std::move(again);
        m = robust;
        dof -= 2 * static_cast<double>(outcome->rejected_ids.size());
        chi2 = 2 * outcome->cost;
      }
    }
    if (outcome->enlarged * outcome->enlarged > 1.5)
      st_.warnings.push_back(photon_text(
          "the levels scatter %.3g times as much as the noise of their frames explains (light that "
          "changes, a response that bends, a drifting black level): uncertainties are that much larger",
          outcome->enlarged));
  }
  if (response_.terms > 0) add_response(m, *outcome);
  out_.result = outcome->fit;
  for (WeakDirection& w : out_.result.weak)
    w.cure = "record more levels of light, from black to white, and darks of more exposure times";
  out_.result.scale = dof >= 1 ? std::sqrt(chi2 / dof) : 1;
  out_.result.model = m.two_gains ? "two_gains" : response_.terms > 0 ? "one_gain_bent" : "one_gain";
  out_.result.candidates = candidates;
  for (std::size_t i = 0; i < outcome->rejected_ids.size(); ++i) {
    const std::uint32_t id = outcome->rejected_ids[i];
    out_.result.rejected[i].what = id < st_.points.size() ? level(id).text() : "fixed pattern";
  }
  // For people: the mean of a level of light is free, its residual says nothing.
  const auto rejected = [&](std::size_t k) {
    return std::find(outcome->rejected_ids.begin(), outcome->rejected_ids.end(), k) !=
           outcome->rejected_ids.end();
  };
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    const Whitening w = whitening(k, m);
    if (!out_.in_range[k] || rejected(k) || !w.with_variance) continue;
    double r[2] = {0, 0};
    const PhotonFrame& s = level(k).settings;
    if (!s.light)
      DarkResidual{w, s.exposure_s,
                   std::isfinite(s.temperature_c) ? s.temperature_c - out_.temperature_reference_c : 0}(m.p,
                                                                                                        r);
    else if (m.two_gains && m.signal[k] > m.break_dn)
      UpperResidual{w, m.break_dn}(m.p, m.upper, &m.signal[k], r);
    else
      LightResidual{w, plan_.dark_level}(m.p, &m.signal[k], r);
    if (!s.light) out_.whitened.push_back(r[0]);
    out_.whitened.push_back(r[1]);
  }
  out_.response = response_;
  linearise({}, 0);
  after(m, *outcome);
  return {};
}

Result<PhotonFit> fit_photon(const FrameStacks& stacks, const PhotonFitOptions& options) {
  if (options.model != "auto" && options.model != "one_gain" && options.model != "two_gains" &&
      options.model != "one_gain_bent")
    return fail(ErrorCode::bad_input, "--model",
                "expected auto, one_gain, two_gains or one_gain_bent, got " + options.model);
  if (stacks.levels().empty()) return fail(ErrorCode::bad_input, "", "expected pictures, got none");
  PhotonFit out;
  if (options.progress) options.progress(0.1, 0);
  out.statistics = stack_statistics(stacks, {options.bits, options.mosaic});
  if (stacks.largest() / out.statistics.step > out.statistics.max_dn)
    return fail(ErrorCode::bad_input, "--bits",
                "expected values up to " + std::to_string(out.statistics.max_dn) + ", got " +
                    std::to_string(stacks.largest() / out.statistics.step));
  StackStatistics& st = out.statistics;
  if (st.step > 1)
    st.warnings.push_back("all values are multiples of " + std::to_string(st.step) +
                          ": divided by it, as the converter gave them");
  for (const std::string& copy : stacks.copies())
    st.warnings.push_back(copy +
                          " is a copy of another frame, bit by bit: left out, it has no noise of its own");
  if (const auto same = repeated_noise(stacks, st); !same.empty())
    st.warnings.push_back(
        "the noise of " + same.front() + " is the same, pixel by pixel (" + std::to_string(same.size()) +
        " such pairs): recordings of a simulated sensor with one seed and the same instants. "
        "Uncertainties are too small, DSNU and PRNU too large; take each exposure at instants of "
        "its own");
  if (st.mosaic)
    st.warnings.push_back(
        "the four places of the 2x2 mosaic differ in the light: each is a level of its own");
  const bool repeated = std::any_of(stacks.levels().begin(), stacks.levels().end(),
                                    [](const PhotonLevel& l) { return l.settings.light && l.count() > 1; });
  const auto lights = std::count_if(stacks.levels().begin(), stacks.levels().end(),
                                    [](const PhotonLevel& l) { return l.settings.light; });
  if (!repeated && lights > 1) {
    if (auto s = fit_single_frames(stacks, options, out); !s) return tl::unexpected<Error>(s.error());
    out.result.interrupted = options.stop.stop_requested();
    return out;
  }
  PhotonProblem problem(stacks, out, options);
  if (auto s = problem.prepare(); !s) return tl::unexpected<Error>(s.error());
  if (options.progress) options.progress(0.5, 0);
  if (auto s = problem.fit(); !s) return tl::unexpected<Error>(s.error());
  judge_linearity(stacks, out);
  out.result.interrupted = options.stop.stop_requested();
  out.result.rejected.insert(out.result.rejected.end(), st.outliers.named.begin(), st.outliers.named.end());
  out.result.residuals.rejected = out.result.rejected.size();
  if (st.outliers.count > st.outliers.named.size())
    out.result.warnings.push_back(std::to_string(st.outliers.count) +
                                  " pixels are left out; the worst 1000 are named");
  if (options.progress) options.progress(1, out.result.residuals.rms);
  return out;
}

}  // namespace rigor::calibration

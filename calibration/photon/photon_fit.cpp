#include "calibration/photon/photon_fit.h"

#include <ceres/autodiff_cost_function.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/photon/exposure_pairs.h"
#include "calibration/photon/linearity.h"
#include "calibration/photon/rounding.h"

namespace rigor::calibration {
namespace {

enum : std::size_t { kGain, kBlack, kRead, kDark, kDoubling, kOffset, kModelParameters };

std::string text(const char* format, double a, double b = 0, double c = 0) {
  char t[320];
  std::snprintf(t, sizeof t, format, a, b, c);
  return t;
}

/// Whitens (mean, variance) by the Cholesky factor of their covariance.
struct Whitening {
  double mean = 0, variance = 0;     // measured
  double l11 = 1, l21 = 0, l22 = 1;  // of the covariance
  double pixel_variance = 0;
  bool with_variance = true;
  template <class T>
  void residual(const T& model_mean, const T& model_variance, T* r) const {
    T m, v;
    rounded_moments(model_mean, model_variance, pixel_variance, m, v);
    r[0] = (T(mean) - m) / T(l11);
    if (with_variance) r[1] = (T(variance) - v - T(l21) * r[0]) / T(l22);
  }
};

struct DarkResidual {
  Whitening w;
  double exposure_s, above_reference_k;
  template <class T>
  bool operator()(const T* p, T* r) const {
    using std::exp;
    using std::log;
    const T signal =
        p[kGain] * p[kDark] * T(exposure_s) * exp(T(std::log(2.0) * above_reference_k) / p[kDoubling]);
    w.residual(T(p[kBlack] + signal),
               T(p[kOffset] + p[kGain] * p[kGain] * p[kRead] * p[kRead] + p[kGain] * signal), r);
    return true;
  }
};
struct LightResidual {
  Whitening w;
  template <class T>
  bool operator()(const T* p, const T* signal, T* r) const {
    w.residual(T(p[kBlack] + signal[0]),
               T(p[kOffset] + p[kGain] * p[kGain] * p[kRead] * p[kRead] + p[kGain] * signal[0]), r);
    return true;
  }
};
/// Above the point where the gain changes: a line of its own.
struct UpperResidual {
  Whitening w;
  double from_dn;
  template <class T>
  bool operator()(const T* p, const T* upper, const T* signal, T* r) const {
    w.residual(T(p[kBlack] + signal[0]), T(upper[1] + upper[0] * (signal[0] - T(from_dn))), r);
    return true;
  }
};
struct DsnuResidual {
  double variance_dn2, sigma_dn2;
  template <class T>
  bool operator()(const T* p, const T* dsnu, T* r) const {
    r[0] = (p[kGain] * p[kGain] * dsnu[0] * dsnu[0] - T(variance_dn2)) / T(sigma_dn2);
    return true;
  }
};
struct PrnuResidual {
  double variance, sigma;
  template <class T>
  bool operator()(const T* prnu, T* r) const {
    r[0] = (prnu[0] * prnu[0] - T(variance)) / T(sigma);
    return true;
  }
};
struct FullWellResidual {
  double mean, sigma;
  template <class T>
  bool operator()(const T* p, const T* well, T* r) const {
    r[0] = (p[kBlack] + p[kGain] * well[0] - T(mean)) / T(sigma);
    return true;
  }
};

struct Nothing {
  template <class T>
  bool operator()(const T* p, T* r) const {
    r[0] = T(0) * p[kGain];
    return true;
  }
};

double chi_square_z(double chi2, double dof) {  // Wilson & Hilferty
  if (dof < 1) return 0;
  return (std::cbrt(chi2 / dof) - (1 - 2 / (9 * dof))) / std::sqrt(2 / (9 * dof));
}

/// Single frames of a still scene: the scatter between exposures is all there is.
Status fit_single_frames(const FrameStacks& stacks, const PhotonFitOptions& options, PhotonFit& out) {
  auto pairs = fit_exposure_pairs(stacks, out.statistics, options.stop);
  if (!pairs) return tl::unexpected<Error>(pairs.error());
  out.pairs = pairs->bins;
  out.result = pairs->result;
  FitResult& r = out.result;
  r.model = "exposure_pairs";
  const Parameter* gain = r.find("system_gain_dn_per_e");
  bool clipped = false, dark = false, white = false, usable = false;
  for (const LevelPoint& p : out.statistics.points) {
    const bool light = stacks.levels()[p.level].settings.light;
    dark = dark || !light;
    if (!light && p.why == "clipped at black") clipped = true;
    if (!light && p.usable) usable = true;
    white = white || (light && p.white_share > 0.001);
  }
  const std::string why =
      clipped && !usable
          ? "the dark frames are clipped at black: their noise and their level are cut off; raise "
            "the camera's black level"
      : dark ? "it takes two dark frames of one exposure, and light frames of which two are alike"
             : "there are no dark frames";
  for (const char* name : {"black_level_dn", "read_noise_e", "dark_current_e_per_s", "dsnu_e"})
    r.not_identifiable.emplace_back(name, why);
  r.not_identifiable.emplace_back("prnu",
                                  "it takes frames of an even light, averaged until their noise is small");
  char text[160];
  std::snprintf(text, sizeof text, "the converter is full first: it is at least %.4g e",
                gain ? out.statistics.max_dn / gain->value : 0);
  r.not_identifiable.emplace_back("full_well_e",
                                  white && gain ? text : "no plateau below the converter's end was seen");
  out.converter_saturates = white;
  std::map<int, std::vector<const PairBin*>> sets;
  double sum = 0, top = 0, counted = 0;
  for (const PairBin& b : out.pairs) {
    LinearityPoint l{b.second_s, b.second_dn, 0, 0, b.set % 4};
    l.deviation = b.second_dn / b.first_dn / (b.second_s / b.first_s) - 1;
    l.sigma = std::sqrt(b.variance_dn2 / b.pixels) / b.first_dn;
    out.linearity.push_back(l);
    // Below 5 % of the range the unknown black level is what deviates.
    if (b.first_dn >= 0.05 * out.statistics.max_dn) sum += std::abs(l.deviation), ++counted;
    top = std::max(top, b.second_dn);
  }
  if (!out.linearity.empty()) {
    if (counted > 0) out.linearity_error = sum / counted;
    r.validity = {{"signal_dn", out.pairs.front().first_dn, top}};
    for (const PairBin& b : out.pairs) r.validity[0].from = std::min(r.validity[0].from, b.first_dn);
  } else {
    r.not_identifiable.emplace_back("linearity", "no pixels lie between black and white in two exposures");
  }
  for (const PairBin& b : out.pairs)
    out.whitened.push_back((b.variance_dn2 / b.expected_dn2 - 1) / std::sqrt(2 / (b.pixels - 2)));
  r.warnings.insert(r.warnings.end(), out.statistics.warnings.begin(), out.statistics.warnings.end());
  if (r.residuals.unit.empty()) r.residuals.unit = "standard deviations";
  if (!gain && out.linearity.empty()) {
    std::string all;
    for (const auto& [name, reason] : r.not_identifiable)
      all += (all.empty() ? "" : "; ") + name + ": " + reason;
    return fail(ErrorCode::bad_input, "",
                "expected pictures that say something about the sensor, got none (" + all + ")");
  }
  return {};
}

/// What is asked of the data, and what they answered.
struct Plan {
  bool dark_level = false;    ///< usable dark frames: black and the noise of the dark
  bool dark_current = false;  ///< at exposure times that differ
  bool doubling = false;
  bool light = false;
  bool dsnu_rounded = false;  ///< the converter's steps hide it
  bool dsnu = false, prnu = false, full_well = false;
};

class Problem {
 public:
  Problem(const FrameStacks& stacks, PhotonFit& out, const PhotonFitOptions& options)
      : stacks_(stacks), out_(out), st_(out.statistics), options_(options) {}

  Status prepare();
  Status fit();

 private:
  struct Model {
    double p[kModelParameters] = {0, 0, 0, 0, 7, 0};
    double upper[2] = {0, 0}, break_dn = 0;
    bool two_gains = false;
    double dsnu = 0, prnu = 0, full_well = 0;
    std::vector<double> signal;
  };
  [[nodiscard]] const PhotonLevel& level(std::size_t k) const {
    return stacks_.levels()[st_.points[k].level];
  }
  [[nodiscard]] Whitening whitening(std::size_t k, const Model& m) const;
  Result<LeastSquares::Outcome> run(Model& m, bool robust, std::size_t without) const;
  Result<LeastSquares::Outcome> iterate(Model& m, bool robust, std::size_t without) const;
  void choose_range();
  void start(Model& m) const;
  void compare(Model& one, Model& two, double break_dn, std::vector<Candidate>& candidates);
  [[nodiscard]] double best_break(Model& two) const;
  void say_not_identifiable(const Model& m);
  void after(Model& m, LeastSquares::Outcome& outcome);
  void hot_pixels(const Model& m);
  void curve(const Model& m);
  std::vector<std::size_t> of(bool light) const {
    std::vector<std::size_t> v;
    for (std::size_t k = 0; k < st_.points.size(); ++k)
      if (out_.in_range[k] && level(k).settings.light == light) v.push_back(k);
    return v;
  }

  const FrameStacks& stacks_;
  PhotonFit& out_;
  StackStatistics& st_;
  const PhotonFitOptions& options_;
  Plan plan_;
  double plateau_dn_ = 0, plateau_sigma_dn_ = 0;
};

Whitening Problem::whitening(std::size_t k, const Model& m) const {
  const LevelPoint& p = st_.points[k];
  Whitening w;
  w.mean = p.mean_dn, w.variance = p.variance_dn2;
  const double before = std::max(1e-4, m.p[kOffset] + std::pow(m.p[kGain] * m.p[kRead], 2) +
                                           m.p[kGain] * std::max(0.0, p.mean_dn - m.p[kBlack]));
  w.pixel_variance = pixel_variance_before(p.mean_dn, before, p.pixel_variance_dn2);
  const double samples = p.pixels * p.frames, gain = m.p[kGain];
  const double signal = std::max(0.0, p.mean_dn - m.p[kBlack]);
  // Cumulants of K·Poisson: third K² signal, fourth K³ signal.
  const double third = plan_.dark_level ? gain * gain * signal : 0;
  const double fourth = plan_.dark_level ? gain * gain * gain * signal : 0;
  const double floor = 1e-6;
  double vm = std::max(floor, p.variance_dn2) / samples;
  double vv = (2 * std::max(floor, p.fourth_dn4) / (p.frames - 1) + fourth / p.frames) / p.pixels;
  if (before < 0.5) {
    // The pixels stand at places between two steps that chance gave them, which bends mean and variance.
    double bent = 0;
    (void)rounded_pixel_variance(p.mean_dn, before, w.pixel_variance, &bent);
    vm += std::max(0.0, bent) / p.pixels;
    vv += std::max(0.0, p.fourth_dn4 - p.variance_dn2 * p.variance_dn2) / p.pixels;
  }
  const double limit = 0.99 * std::sqrt(vm * vv);
  const double c = std::clamp(third / samples, -limit, limit);
  w.l11 = std::sqrt(vm);
  w.l21 = c / w.l11;
  w.l22 = std::sqrt(vv - w.l21 * w.l21);
  w.with_variance = p.variance_dn2 > 0.005;
  return w;
}

Status Problem::prepare() {
  std::string levels;
  std::size_t usable = 0;
  out_.in_range.assign(st_.points.size(), false);
  std::map<std::size_t, std::string> why;
  for (const LevelPoint& p : st_.points) {
    usable += p.usable;
    if (!p.usable) {
      std::string& s = why[p.level];
      if (s.find(p.why) == std::string::npos) s += (s.empty() ? "" : ", ") + p.why;
    }
  }
  for (const auto& [l, reason] : why) {
    const std::string name = stacks_.levels()[l].text();
    levels += (levels.empty() ? "" : "; ") + name + ": " + reason;
    st_.warnings.push_back(name + " left out" + (st_.mosaic ? " (in one colour or more)" : "") + ": " +
                           reason);
  }
  if (usable == 0)
    return fail(ErrorCode::bad_input, "",
                "expected levels of two frames or more between black and white, got none (" + levels +
                    "); raise the black level until the dark frames are above 0 everywhere, and take "
                    "exposures from a tenth to seven tenths of the range");
  choose_range();
  return {};
}

void Problem::choose_range() {
  const int phases = st_.mosaic ? 4 : 1;
  std::size_t outside = 0;
  double black = 0, blacks = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k)
    if (st_.points[k].usable && !level(k).settings.light) {
      out_.in_range[k] = true;
      black += st_.points[k].mean_dn, ++blacks;
    }
  if (blacks > 0) black /= blacks;
  double saturation = 0;
  bool peak = false;
  for (int phase = 0; phase < phases; ++phase) {
    std::vector<const LevelPoint*> rising;  // in order of exposure
    bool white = false;
    for (std::size_t k = 0; k < st_.points.size(); ++k) {
      const LevelPoint& p = st_.points[k];
      if (p.phase != phase || !level(k).settings.light) continue;
      white = white || p.why == "saturated";
      if (p.usable) rising.push_back(&p);
    }
    if (rising.empty()) continue;
    // The variance falls and does not come back: the pixel is full. (After a change of the gain it rises
    // again; under a tone curve it falls from the beginning.) Or the converter is full.
    std::size_t top = rising.size() - 1;
    while (top > 0) {
      const LevelPoint &p = *rising[top], &q = *rising[top - 1];
      const double sigma = std::sqrt(2 * p.fourth_dn4 / (p.frames - 1) / p.pixels);
      if (p.variance_dn2 > q.variance_dn2 + 5 * sigma + 0.01) break;
      --top;
    }
    const double at = rising[top]->mean_dn, last = rising.back()->mean_dn;
    if (at < last * 0.98 && at > last * 0.5 &&
        rising.back()->variance_dn2 < 0.9 * rising[top]->variance_dn2) {
      peak = true;
      saturation = std::max(saturation, at);
    } else if (white) {
      saturation = std::max(saturation, static_cast<double>(st_.max_dn));
      out_.converter_saturates = true;
    }
  }
  if (peak) out_.converter_saturates = false;
  if (saturation > 0) out_.saturation_signal_dn = saturation - black;
  const double limit = saturation > 0 ? black + 0.7 * (saturation - black) : 1e300;
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    if (!st_.points[k].usable || !level(k).settings.light) continue;
    out_.in_range[k] = st_.points[k].mean_dn <= limit;
    outside += !out_.in_range[k];
  }
  if (outside > 0)
    st_.warnings.push_back(
        text("%.0f levels above 70 %% of the saturation at %.5g DN are not in the photon transfer",
             double(outside), saturation));
  // All pixels full: the variance of the light is gone, the mean is the full well.
  double dark_variance = 0;
  for (const std::size_t k : of(false)) dark_variance = std::max(dark_variance, st_.points[k].variance_dn2);
  double number = 0;
  for (std::size_t k = 0; peak && dark_variance > 0 && k < st_.points.size(); ++k) {
    const LevelPoint& p = st_.points[k];
    if (!p.usable || !level(k).settings.light || out_.in_range[k] || p.variance_dn2 > 1.15 * dark_variance)
      continue;
    if (number == 0 || p.mean_dn > plateau_dn_) {
      plateau_dn_ = p.mean_dn;
      // Without noise the plateau stands on a step of the converter, somewhere in it.
      plateau_sigma_dn_ = p.variance_dn2 > 0.1 ? std::sqrt(p.variance_dn2 / (p.pixels * p.frames)) : 0.29;
    }
    ++number;
  }
  if (number > 0) out_.saturation_signal_dn = plateau_dn_ - black;
}

void Problem::start(Model& m) const {
  const auto dark = of(false), light = of(true);
  double black = 0, read_dn2 = 0;
  if (!dark.empty()) {
    // The shortest dark exposure stands for black.
    const std::size_t k = *std::min_element(dark.begin(), dark.end(), [&](std::size_t a, std::size_t b) {
      return level(a).settings.exposure_s < level(b).settings.exposure_s;
    });
    black = st_.points[k].mean_dn;
    read_dn2 = std::max(0.01, st_.points[k].variance_dn2 - 1.0 / 12);
  }
  m.p[kBlack] = black;
  double num = 0, den = 0, mean = 0, variance = 0;
  for (const std::size_t k : light) {
    mean += st_.points[k].mean_dn / static_cast<double>(light.size());
    variance += st_.points[k].variance_dn2 / static_cast<double>(light.size());
  }
  const bool through = !dark.empty();
  for (const std::size_t k : light) {
    const double x = st_.points[k].mean_dn - (through ? black : mean);
    const double y = st_.points[k].variance_dn2 - (through ? read_dn2 + 1.0 / 12 : variance);
    num += x * y, den += x * x;
  }
  m.p[kGain] = den > 0 && num > 0 ? num / den : 0.01 * std::max(1.0, st_.max_dn / 255.0);
  m.p[kRead] = std::sqrt(read_dn2) / m.p[kGain];
  m.p[kOffset] = through ? 0 : variance - m.p[kGain] * mean;
  if (!through) m.p[kRead] = 0;
  double t0 = 1e300, t1 = 0, y0 = 0, y1 = 0;
  for (const std::size_t k : dark) {
    const double t = level(k).settings.exposure_s;
    if (t < t0) t0 = t, y0 = st_.points[k].mean_dn;
    if (t > t1) t1 = t, y1 = st_.points[k].mean_dn;
  }
  if (plan_.dark_current) m.p[kDark] = std::max(1e-3 / (t1 * m.p[kGain]), (y1 - y0) / (t1 - t0) / m.p[kGain]);
  m.dsnu = plan_.dsnu ? std::sqrt(st_.dark_pattern_dn2.value) / m.p[kGain] : 0;
  m.prnu = plan_.prnu ? std::sqrt(st_.light_pattern.value) : 0;
  m.full_well = plan_.full_well ? (plateau_dn_ - black) / m.p[kGain] : 0;
  m.signal.assign(st_.points.size(), 0);
  for (const std::size_t k : light) m.signal[k] = st_.points[k].mean_dn - black;
}

Result<LeastSquares::Outcome> Problem::run(Model& m, bool robust, std::size_t without) const {
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
      problem.add(
          new ceres::AutoDiffCostFunction<LightResidual, 2, kModelParameters, 1>(new LightResidual{w}),
          {m.p, &m.signal[k]}, static_cast<std::uint32_t>(k));
  }
  const auto extra = static_cast<std::uint32_t>(st_.points.size());
  if (plan_.dsnu)
    problem.add(new ceres::AutoDiffCostFunction<DsnuResidual, 1, kModelParameters, 1>(
                    new DsnuResidual{st_.dark_pattern_dn2.value, st_.dark_pattern_dn2.sigma}),
                {m.p, &m.dsnu}, extra);
  if (plan_.prnu)
    problem.add(new ceres::AutoDiffCostFunction<PrnuResidual, 1, 1>(
                    new PrnuResidual{st_.light_pattern.value, st_.light_pattern.sigma}),
                {&m.prnu}, extra);
  if (plan_.full_well)
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
Result<LeastSquares::Outcome> Problem::iterate(Model& m, bool robust, std::size_t without) const {
  auto out = run(m, robust, without);
  for (int i = 0; out && i < 3; ++i) {
    const double before = m.p[kGain];
    out = run(m, robust, without);
    if (std::abs(m.p[kGain] - before) < 1e-9 * before) break;
  }
  return out;
}

double Problem::best_break(Model& two) const {
  std::vector<std::size_t> light = of(true);
  std::sort(light.begin(), light.end(),
            [&](std::size_t a, std::size_t b) { return st_.points[a].mean_dn < st_.points[b].mean_dn; });
  const auto x = [&](std::size_t i) { return st_.points[light[i]].mean_dn - two.p[kBlack]; };
  const auto y = [&](std::size_t i) { return st_.points[light[i]].variance_dn2; };
  const double noise = two.p[kGain] * two.p[kGain] * two.p[kRead] * two.p[kRead] + two.p[kOffset];
  double best = 1e300;
  Model found = two;
  for (std::size_t i = 1; i + 2 < light.size(); ++i) {
    if (x(i + 1) - x(i) < 0.02 * x(i)) continue;
    Model m = two;
    m.two_gains = true;
    m.break_dn = 0.5 * (x(i) + x(i + 1));
    // From below and from above: the one line through all is no start for two.
    const double slope = (y(i) - noise) / x(i);
    const std::size_t last = light.size() - 1;
    const double above = (y(last) - y(i + 1)) / (x(last) - x(i + 1));
    if (!(slope > 0) || !(above > 0)) continue;
    m.p[kRead] *= m.p[kGain] / slope, m.dsnu *= m.p[kGain] / slope, m.full_well *= m.p[kGain] / slope;
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

void Problem::compare(Model& one, Model& two, double break_dn, std::vector<Candidate>& candidates) {
  const auto light = of(true);
  for (Model* m : {&one, &two}) {
    Candidate c;
    c.name = m == &one ? "one_gain" : "two_gains";
    if (m == &two) {
      m->two_gains = true, m->break_dn = break_dn;
    }
    const auto out = iterate(*m, false, st_.points.size());
    if (!out) continue;
    c.parameters = (m == &one ? 0 : 3) + 2 + (plan_.dark_level ? 1 : 0) + plan_.dark_current + plan_.doubling;
    c.rms = out->fit.residuals.rms;
    // The noise of each datum is known: −2 ln L is χ² itself.
    c.bic = 2 * out->cost + c.parameters * std::log(static_cast<double>(out->fit.residuals.count));
    std::vector<double> squares;
    for (const std::size_t k : light) {
      Model fold = *m;
      if (options_.stop.stop_requested()) return;
      if (!run(fold, false, k)) continue;
      double r[2] = {0, 0};
      const Whitening w = whitening(k, *m);
      const double signal = st_.points[k].mean_dn - fold.p[kBlack];
      if (fold.two_gains && signal > fold.break_dn)
        UpperResidual{w, fold.break_dn}(fold.p, fold.upper, &signal, r);
      else
        LightResidual{w}(fold.p, &signal, r);
      squares.push_back(r[1] * r[1]);
    }
    double mean = 0, variance = 0;
    const auto n = static_cast<double>(squares.size());
    for (const double s : squares) mean += s / n;
    for (const double s : squares) variance += (s - mean) * (s - mean) / std::max(1.0, n - 1);
    c.cross_validation = std::sqrt(mean);
    c.cross_validation_sigma = std::sqrt(variance / n) / (2 * std::max(1e-300, c.cross_validation));
    candidates.push_back(c);
  }
}

Status Problem::fit() {
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
  plan_.dsnu = plan_.dark_level && plan_.light && st_.dark_pattern_dn2.valid &&
               st_.dark_pattern_dn2.value > 3 * st_.dark_pattern_dn2.sigma;
  plan_.prnu =
      plan_.light && st_.light_pattern.valid && st_.light_pattern.value > 3 * st_.light_pattern.sigma;
  plan_.full_well = plan_.dark_level && plan_.light && plateau_dn_ > 0;
  Model m;
  start(m);
  if (!plan_.light) {
    // No photon transfer: nothing can be said in electrons.
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
                      std::to_string(light.size()) + " usable levels of light and none of the dark");
    r.residuals.unit = "standard deviations";
    r.warnings = st_.warnings;
    return {};
  }
  if (plan_.doubling) m.p[kDoubling] = 7;

  std::vector<Candidate> candidates;
  Model two = m;
  bool with_two = false;
  if (options_.model != "one_gain" && light.size() >= 7) {
    Model probe = m;
    if (run(probe, false, st_.points.size())) {
      two = probe;
      if (const double at = best_break(two); at > 0) {
        compare(m, two, at, candidates);
        with_two = candidates.size() == 2;
      }
    }
  }
  if (with_two) {
    std::size_t chosen = choose_model(candidates);
    // A break that is looked for finds one in noise, too: both judges must be for it.
    if (chosen == 1 && candidates[1].bic > candidates[0].bic - 10) chosen = 0;
    if (options_.model == "two_gains") chosen = 1;
    for (std::size_t i = 0; i < 2; ++i) candidates[i].chosen = i == chosen;
    if (chosen == 1) m = two;
  } else if (options_.model == "two_gains") {
    return fail(ErrorCode::bad_input, "--model",
                "expected at least 7 levels of light for two gains, got " + std::to_string(light.size()));
  }
  auto outcome = iterate(m, false, st_.points.size());
  if (!outcome) return tl::unexpected<Error>(outcome.error());
  const double unknowns = [&] {
    double u = static_cast<double>(light.size());
    for (const Parameter& p : outcome->fit.parameters) u += !p.held;
    return u;
  }();
  double dof = static_cast<double>(outcome->fit.residuals.count) - 1 - unknowns, chi2 = 2 * outcome->cost;
  if (dof >= 1 && chi_square_z(chi2, dof) > 3.7) {
    // Larger than the statistics of the frames: is it a single level, or all of them?
    if (dof > 6) {
      Model robust = m;
      if (auto again = iterate(robust, true, st_.points.size());
          again && !again->rejected_ids.empty() && again->rejected_ids.size() <= light.size() / 3) {
        outcome = std::move(again);
        m = robust;
        dof -= 2 * static_cast<double>(outcome->rejected_ids.size());
        chi2 = 2 * outcome->cost;
      }
    }
    const double s2 = std::max(1.0, chi2 / std::max(1.0, dof));
    outcome->fit.covariance *= s2;
    for (Parameter& p : outcome->fit.parameters) p.sigma *= std::sqrt(s2);
    if (s2 > 1.5)
      st_.warnings.push_back(
          text("the levels scatter %.3g times as much as the noise of their frames explains (light that "
               "changes, a response that bends, a drifting black level): uncertainties are that much larger",
               std::sqrt(s2)));
  }
  out_.result = outcome->fit;
  out_.result.scale = dof >= 1 ? std::sqrt(chi2 / dof) : 1;
  out_.result.model = m.two_gains ? "two_gains" : "one_gain";
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
      LightResidual{w}(m.p, &m.signal[k], r);
    if (!s.light) out_.whitened.push_back(r[0]);
    out_.whitened.push_back(r[1]);
  }
  after(m, *outcome);
  return {};
}

void Problem::after(Model& m, LeastSquares::Outcome&) {
  FitResult& r = out_.result;
  out_.black_dn = m.p[kBlack];
  // The mean of the offset pattern is the same in all levels: none of them tells it from the black level.
  if (const int b = r.index_of("black_level_dn"); b >= 0 && plan_.dark_level && st_.dark_pattern_dn2.valid) {
    const double pixels = std::max(1.0, st_.dark_pattern_dn2.pixels);
    r.covariance(b, b) += std::max(0.0, st_.dark_pattern_dn2.value) / pixels;
    r.parameters[static_cast<std::size_t>(b)].sigma = std::sqrt(r.covariance(b, b));
  }
  // K times the full well is known far better than either: the ridge is curved, and what the covariance
  // leaves out of it (second order, e_K e_W) would be the larger part of its width.
  if (const int w = r.index_of("full_well_e"), g = r.index_of("system_gain_dn_per_e"); w >= 0 && g >= 0)
    r.covariance(w, w) += 3 * r.covariance(w, w) * r.covariance(g, g) / (m.p[kGain] * m.p[kGain]);
  curve(m);
  say_not_identifiable(m);
  // What was held, or says nothing, is not a parameter of the result.
  const auto drop = [&](const std::string& name) {
    for (const auto& [n, why] : r.not_identifiable)
      if (n == name) return true;
    return name == "variance_offset_dn2" && plan_.dark_level;
  };
  std::vector<Eigen::Index> kept;
  std::vector<Parameter> parameters;
  for (std::size_t i = 0; i < r.parameters.size(); ++i)
    if (!r.parameters[i].held && !drop(r.parameters[i].name)) {
      kept.push_back(static_cast<Eigen::Index>(i));
      parameters.push_back(r.parameters[i]);
    }
  r.parameters = std::move(parameters);
  r.covariance = r.covariance(kept, kept).eval();
  hot_pixels(m);
  if (m.two_gains)
    r.warnings.push_back(text(
        "the gain changes at %.5g DN above black: %.4g DN/e below, %.4g above. The simulator's model has one "
        "gain: the sheet gets that below",
        m.break_dn, m.p[kGain], m.upper[0]));
  r.warnings.insert(r.warnings.end(), st_.warnings.begin(), st_.warnings.end());
  double s0 = 1e300, s1 = 0, t0 = 1e300, t1 = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    if (!out_.in_range[k]) continue;
    s0 = std::min(s0, st_.points[k].mean_dn - m.p[kBlack]);
    s1 = std::max(s1, st_.points[k].mean_dn - m.p[kBlack]);
    t0 = std::min(t0, level(k).settings.exposure_s), t1 = std::max(t1, level(k).settings.exposure_s);
  }
  r.validity = {{"signal_dn", s0, s1}, {"exposure_s", t0, t1}};
}

void Problem::say_not_identifiable(const Model& m) {
  FitResult& r = out_.result;
  const auto say = [&](const char* name, const std::string& why) {
    r.not_identifiable.emplace_back(name, why);
  };
  bool darks = false, dark_clipped = false, dark_single = false, white = false;
  for (const LevelPoint& p : st_.points) {
    const bool light = stacks_.levels()[p.level].settings.light;
    darks = darks || !light;
    if (!light && p.why == "clipped at black") dark_clipped = true;
    if (!light && p.frames < 2) dark_single = true;
    white = white || (light && p.why == "saturated");
  }
  const double gain = m.p[kGain];
  if (!plan_.light)
    say("system_gain_dn_per_e",
        "it needs levels of light between black and saturation, of two frames each, there is none");
  std::string no_dark;
  if (!plan_.dark_level)
    no_dark = !darks ? "there are no dark frames"
              : dark_clipped
                  ? "the dark frames are clipped at black: their noise and their level are cut off; raise "
                    "the camera's black level"
              : dark_single ? "it takes two dark frames of the same exposure"
                            : "no dark level can be used";
  if (!plan_.dark_level) {
    say("black_level_dn", no_dark);
    say("read_noise_e", no_dark);
    say("dark_current_e_per_s", no_dark);
    say("dsnu_e", no_dark);
  } else if (plan_.light) {
    const Parameter* read = r.find("read_noise_e");
    double least = 1e300;
    for (const std::size_t k : of(false)) least = std::min(least, st_.points[k].variance_dn2);
    if (least <= 0.005)
      say("read_noise_e", text("the dark frames hardly change (variance %.2g DN²): their noise lies below "
                               "the converter's step",
                               least));
    else if (read && read->value < 6 * read->sigma)
      say("read_noise_e", text("it is below %.3g e (95 %%), and not told from 0",
                               std::sqrt(read->value * read->value + 4 * read->value * read->sigma)));
    if (!plan_.dark_current)
      say("dark_current_e_per_s",
          "all dark frames have one exposure time: take them at two times or more, the longest of seconds. "
          "Until then "
          "black level and read noise hold its share");
    else if (const Parameter* d = r.find("dark_current_e_per_s"); d && d->value < 3 * d->sigma)
      say("dark_current_e_per_s",
          d->value < -3 * d->sigma
              ? "the dark level falls with the exposure time: the camera takes it out by itself"
              : text("it is below %.3g e/s (95 %%), and not told from 0: take longer dark exposures",
                     std::max(0.0, d->value) + 1.645 * d->sigma));
    if (plan_.dsnu_rounded)
      say("dsnu_e",
          "the noise is below the converter's step, whose rounding shapes the pattern: take more bits, or "
          "gain");
    else if (!plan_.dsnu)
      say("dsnu_e",
          text("the dark frames differ from pixel to pixel by no more than their noise (below %.3g e): "
               "average "
               "more of them",
               std::sqrt(std::max(0.0, st_.dark_pattern_dn2.value) + 2 * st_.dark_pattern_dn2.sigma) / gain));
    if (plan_.dark_current && !plan_.doubling)
      say("dark_doubling_k", "all dark frames are of one temperature, or of none that is known");
  } else {
    say("read_noise_e", "without light there is no gain that leads to electrons");
    say("dark_current_e_per_s", "without light there is no gain that leads to electrons");
    say("dsnu_e", "without light there is no gain that leads to electrons");
  }
  if (!plan_.prnu) {
    if (!plan_.light || !plan_.dark_level)
      say("prnu", plan_.light ? no_dark : "there are no usable levels of light");
    else
      say("prnu",
          text("the bright frames differ from pixel to pixel by no more than their noise (below %.2g %%): "
               "average more of them",
               100 * std::sqrt(std::max(0.0, st_.light_pattern.value) + 2 * st_.light_pattern.sigma)));
  }
  if (!plan_.full_well)
    say("full_well_e",
        out_.converter_saturates ? text("the converter is full first, at %.5g DN: it is at least %.4g e",
                                        double(st_.max_dn), (st_.max_dn - m.p[kBlack]) / gain)
        : out_.saturation_signal_dn
            ? text("the variance peaks near %.5g DN above black (%.4g e), but no level has all pixels full",
                   *out_.saturation_signal_dn, *out_.saturation_signal_dn / gain)
            : "no level is saturated: go on with longer exposures");
}

/// Excess dark current of hot pixels: an exponential distribution above the limit at which they are found,
/// those that are full censored. Its share below the limit is in the mean of the others: taken out.
void Problem::hot_pixels(const Model& m) {
  FitResult& r = out_.result;
  const OutlierPixels& o = st_.outliers;
  const int g = r.index_of("system_gain_dn_per_e"), d = r.index_of("dark_current_e_per_s");
  if (!plan_.dark_current || d < 0) return;
  const double n = static_cast<double>(o.hot_dn_per_s.size()), seen = n - static_cast<double>(o.hot_full);
  const double all = static_cast<double>(o.bad.size());
  if (seen < 10) {
    r.not_identifiable.emplace_back("hot_pixel_share",
                                    text("%.0f hot pixels are too few to tell how many and how hot", n));
    return;
  }
  double sum = 0;
  for (const double x : o.hot_dn_per_s) sum += x - o.hot_limit_dn_per_s;
  const double gain = m.p[kGain], limit = o.hot_limit_dn_per_s, h = sum / seen;
  const double share = std::min(1.0, n / all * std::exp(limit / h));
  const double var_h = h * h / seen,
               var_share = share * share / n + std::pow(share * limit / (h * h), 2) * var_h;
  const double hidden = h - (limit + h) * std::exp(-limit / h);
  r.parameters[static_cast<std::size_t>(d)].value -= share * hidden / gain;
  const auto p = static_cast<Eigen::Index>(r.parameters.size());
  Eigen::MatrixXd c = Eigen::MatrixXd::Zero(p + 2, p + 2);
  c.topLeftCorner(p, p) = r.covariance;
  const double hidden_sigma = share * hidden / gain * std::sqrt(1 / n + 1 / seen);
  c(d, d) += hidden_sigma * hidden_sigma;
  c(p, p) = var_share;
  const double to_gain = -h / (gain * gain);
  c.row(p + 1).head(p) = to_gain * r.covariance.row(g);
  c.col(p + 1).head(p) = c.row(p + 1).head(p).transpose();
  c(p + 1, p + 1) = var_h / (gain * gain) + to_gain * to_gain * r.covariance(g, g);
  c(p, p + 1) = c(p + 1, p) = -share * limit / (h * h) * var_h / gain;
  r.parameters[static_cast<std::size_t>(d)].sigma = std::sqrt(c(d, d));
  r.parameters.push_back({"hot_pixel_share", share, std::sqrt(var_share), 0.5 * share});
  r.parameters.push_back({"hot_pixel_dark_e_per_s", h / gain, std::sqrt(c(p + 1, p + 1)), 0.5 * h / gain});
  r.covariance = c;
}

void Problem::curve(const Model& m) {
  double top = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k)
    if (st_.points[k].usable) top = std::max(top, st_.points[k].mean_dn - m.p[kBlack]);
  const auto& c = out_.result.covariance;
  const int g = out_.result.index_of("system_gain_dn_per_e"), s = out_.result.index_of("read_noise_e"),
            o = out_.result.index_of("variance_offset_dn2");
  for (int i = 0; i <= 100; ++i) {
    const double x = top * i / 100, k = m.p[kGain], read = m.p[kRead];
    double v = m.p[kOffset] + k * k * read * read + k * x;
    if (m.two_gains && x > m.break_dn) v = m.upper[1] + m.upper[0] * (x - m.break_dn);
    double mean, rounded;
    rounded_moments(m.p[kBlack] + x, v, 10, mean, rounded);
    Eigen::Vector3d j(x + 2 * k * read * read, 2 * k * k * read, 1);
    Eigen::Matrix3d part = Eigen::Matrix3d::Zero();
    const int at[3] = {g, s, o};
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        if (at[a] >= 0 && at[b] >= 0) part(a, b) = c(at[a], at[b]);
    out_.curve_signal_dn.push_back(x);
    out_.curve_variance_dn2.push_back(rounded);
    out_.curve_sigma_dn2.push_back(std::sqrt(std::max(0.0, j.dot(part * j))));
  }
}

}  // namespace

Result<PhotonFit> fit_photon(const FrameStacks& stacks, const PhotonFitOptions& options) {
  if (options.model != "auto" && options.model != "one_gain" && options.model != "two_gains")
    return fail(ErrorCode::bad_input, "--model",
                "expected auto, one_gain or two_gains, got " + options.model);
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
  Problem problem(stacks, out, options);
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

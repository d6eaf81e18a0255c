#include "calibration/tof/noise_law.h"

#include <ceres/autodiff_cost_function.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/chi_squared.h"
#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

int coefficients_of(NoiseLaw law) {
  switch (law) {
    case NoiseLaw::shot:
    case NoiseLaw::inverse:
      return 1;
    case NoiseLaw::floor_inverse:
    case NoiseLaw::shot_read:
      return 2;
    case NoiseLaw::shot_read_floor:
      return 3;
  }
  return 0;
}

/// Variance of a group from its means of 1/A (`i`, shot noise's share `si`) and 1/A² (`ii`).
template <class T>
T variance_of(NoiseLaw law, const T* c, double i, double si, double ii) {
  switch (law) {
    case NoiseLaw::shot:
      return c[0] * c[0] * si;
    case NoiseLaw::inverse:
      return c[0] * c[0] * ii;
    case NoiseLaw::floor_inverse:
      return c[0] * c[0] + 2.0 * c[0] * c[1] * i + c[1] * c[1] * ii;
    case NoiseLaw::shot_read:
      return c[0] * si + c[1] * ii;
    case NoiseLaw::shot_read_floor:
      return c[0] * si + c[1] * ii + c[2];
  }
  return T(0);
}

struct Unit {
  double amplitude, sigma_m;
};
/// What coefficient k of a law, found with amplitude and range in units of `u`, is in the caller's.
double scale_of(NoiseLaw law, int k, const Unit& u) {
  const double s = u.sigma_m, a = u.amplitude;
  switch (law) {
    case NoiseLaw::shot:
      return s * std::sqrt(a);
    case NoiseLaw::inverse:
      return s * a;
    case NoiseLaw::floor_inverse:
      return k == 0 ? s : s * a;
    case NoiseLaw::shot_read:
    case NoiseLaw::shot_read_floor:
      return s * s * (k == 0 ? a : k == 1 ? a * a : 1);
  }
  return 1;
}
const char* coefficient_name(NoiseLaw law, int k) {
  switch (law) {
    case NoiseLaw::shot:
      return "noise_shot_m";
    case NoiseLaw::inverse:
      return "noise_inverse_m";
    case NoiseLaw::floor_inverse:
      return k == 0 ? "noise_floor_m" : "noise_inverse_m";
    case NoiseLaw::shot_read:
    case NoiseLaw::shot_read_floor:
      return k == 0 ? "noise_shot_m2" : k == 1 ? "noise_read_m2" : "noise_floor_m2";
  }
  return "";
}

struct Datum {
  double log_sigma, uncertainty, i, si, ii;
};

struct LogSigma {
  NoiseLaw law;
  Datum d;
  double weight;
  template <class T>
  bool operator()(const T* c, T* r) const {
    const T v = variance_of(law, c, d.i, d.si, d.ii);
    if (!(v > T(0))) return false;
    using std::log;
    r[0] = (T(d.log_sigma) - 0.5 * log(v)) * weight;
    return true;
  }
};

struct Solved {
  std::array<double, 3> c{};
  LeastSquares::Outcome outcome;
  double tau = 0, minus_two_log_likelihood = 0;
};

double residual_of(NoiseLaw law, const std::array<double, 3>& c, const Datum& d) {
  return d.log_sigma - 0.5 * std::log(variance_of(law, c.data(), d.i, d.si, d.ii));
}

Result<Solved> solve_at(NoiseLaw law, const std::vector<Datum>& data, double tau,
                        std::array<double, 3> start) {
  Solved s;
  s.c = start;
  s.tau = tau;
  LeastSquares fit;
  std::vector<ParameterInfo> infos;
  for (int k = 0; k < 3; ++k)
    // In units of the data's own noise: a coefficient that is as uncertain as the noise is large is of no
    // use.
    infos.push_back({k < coefficients_of(law) ? coefficient_name(law, k) : "unused", 1, 0, 1e300,
                     k >= coefficients_of(law)});
  fit.add_block(s.c.data(), infos);
  for (std::size_t i = 0; i < data.size(); ++i) {
    const double w = 1 / std::hypot(data[i].uncertainty, tau);
    fit.add(new ceres::AutoDiffCostFunction<LogSigma, 1, 3>(new LogSigma{law, data[i], w}), {s.c.data()},
            static_cast<std::uint32_t>(i));
  }
  FitOptions o;
  o.robust = false;
  o.whitened = true;
  o.threads = 1;
  o.unit = "ln(sigma)";
  auto r = fit.solve(o);
  if (!r) return tl::unexpected<Error>(r.error());
  s.outcome = std::move(*r);
  for (const Datum& d : data) {
    const double v = d.uncertainty * d.uncertainty + tau * tau, e = residual_of(law, s.c, d);
    s.minus_two_log_likelihood += std::log(v) + e * e / v;
  }
  return s;
}

/// With the τ that makes the residuals as large as they are said to be.
Result<Solved> solve(NoiseLaw law, const std::vector<Datum>& data) {
  std::array<double, 3> start{};
  // Each term alone explains the middle of the data.
  const Datum& m = data[data.size() / 2];
  const double sigma = std::exp(m.log_sigma);
  const int n = coefficients_of(law);
  switch (law) {
    case NoiseLaw::shot:
      start[0] = sigma / std::sqrt(m.si);
      break;
    case NoiseLaw::inverse:
      start[0] = sigma / std::sqrt(m.ii);
      break;
    case NoiseLaw::floor_inverse:
      start = {sigma / 2, sigma / 2 / std::sqrt(m.ii), 0};
      break;
    case NoiseLaw::shot_read:
    case NoiseLaw::shot_read_floor:
      start = {sigma * sigma / n / m.si, sigma * sigma / n / m.ii, n == 3 ? sigma * sigma / n : 0};
      break;
  }
  auto best = solve_at(law, data, 0, start);
  if (!best) return best;
  const auto excess = [&](const Solved& s) {
    double sum = 0;
    for (const Datum& d : data) {
      const double e = residual_of(law, s.c, d);
      sum += e * e / (d.uncertainty * d.uncertainty + s.tau * s.tau);
    }
    return sum - static_cast<double>(data.size() - static_cast<std::size_t>(n));
  };
  // Chance alone makes the residuals larger than they are said to be every second time: that is no misfit.
  const auto dof = static_cast<double>(data.size() - static_cast<std::size_t>(n));
  if (excess(*best) + dof <= chi_squared_quantile(0.99, dof)) return best;
  double low = 0, high = 1;
  for (int i = 0; i < 40; ++i) {
    const double tau = low == 0 ? high / 4 : std::sqrt(low * high);
    auto s = solve_at(law, data, tau, best->c);
    if (!s) return s;
    best = std::move(s);
    (excess(*best) > 0 ? low : high) = tau;
    if (low > 0 && high / low < 1.0005) break;
    if (high < 1e-9) break;
  }
  return best;
}

}  // namespace

std::string_view noise_law_name(NoiseLaw law) {
  static constexpr std::string_view kNames[] = {"shot", "inverse", "floor_inverse", "shot_read",
                                                "shot_read_floor"};
  return kNames[static_cast<std::size_t>(law)];
}

Result<NoiseLaw> parse_noise_law(const std::string& name) {
  std::string names;
  for (const NoiseLaw law : kNoiseLaws) {
    if (noise_law_name(law) == name) return law;
    names += (names.empty() ? "" : ", ") + std::string(noise_law_name(law));
  }
  return fail(ErrorCode::bad_input, "--model", "expected one of " + names + ", got " + name);
}

double NoiseCoefficients::sigma_m(double amplitude) const {
  if (!(amplitude > 0)) return 0;
  const double i = 1 / amplitude;
  return std::sqrt(variance_of(law, c.data(), i, i, i * i));
}

Result<NoiseLawFit> fit_noise_law(const std::vector<NoiseBin>& bins, const NoiseLawOptions& options) {
  if (bins.size() < 2 || options.laws.empty())
    return fail(ErrorCode::bad_input, "noise against amplitude",
                "expected variances at two amplitudes or more, got " + std::to_string(bins.size()) +
                    ": record surfaces of several remissions, or at several ranges");
  std::vector<Datum> data;
  Unit unit{0, 0};
  for (const NoiseBin& b : bins) {
    if (!(b.inverse > 0) || !(b.inverse_square > 0) || !(b.variance_m2 > 0) || !(b.dof > 0))
      return fail(ErrorCode::bad_input, "noise against amplitude",
                  "expected groups with an amplitude and a variance above 0, got one of amplitude " +
                      std::to_string(b.amplitude) + " and variance " + std::to_string(b.variance_m2));
    unit.amplitude -= std::log(b.inverse) / static_cast<double>(bins.size());
    unit.sigma_m += 0.5 * std::log(b.variance_m2) / static_cast<double>(bins.size());
  }
  unit = {std::exp(unit.amplitude), std::exp(unit.sigma_m)};
  for (const NoiseBin& b : bins) {
    // The logarithm of an unbiased variance is biased.
    const double bias = digamma(b.dof / 2) - std::log(b.dof / 2);
    const double s = 0.5 * (std::log(b.variance_m2 / (unit.sigma_m * unit.sigma_m)) - bias);
    const double u = b.log_sigma > 0 ? b.log_sigma : 0.5 * std::sqrt(trigamma(b.dof / 2));
    data.push_back({s, u, b.inverse * unit.amplitude,
                    (b.shot_inverse > 0 ? b.shot_inverse : b.inverse) * unit.amplitude,
                    b.inverse_square * unit.amplitude * unit.amplitude});
  }
  std::vector<std::size_t> order(bins.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return data[a].i > data[b].i; });

  NoiseLawFit out;
  std::vector<Solved> solved;
  std::vector<NoiseLaw> laws;
  for (const NoiseLaw law : options.laws) {
    const int n = coefficients_of(law);
    if (data.size() <= static_cast<std::size_t>(n)) {
      out.result.warnings.push_back("noise law " + std::string(noise_law_name(law)) + ": not tried, " +
                                    std::to_string(data.size()) + " amplitudes for " + std::to_string(n) +
                                    " coefficients");
      continue;
    }
    auto s = solve(law, data);
    if (!s) return tl::unexpected<Error>(s.error());
    Candidate c;
    c.name = std::string(noise_law_name(law));
    c.parameters = n;
    double sum = 0, misfit = 0;
    for (const Datum& d : data) {
      const double e = residual_of(law, s->c, d);
      sum += e * e;
      misfit += std::expm1(e) * std::expm1(e);
    }
    c.rms = std::sqrt(sum / static_cast<double>(data.size()));
    c.bic = s->minus_two_log_likelihood + (n + 1) * std::log(static_cast<double>(data.size()));
    c.cross_validation = kNaN;
    // Bands of amplitude are withheld: a law has to say what it does where it was not seen.
    const auto folds = static_cast<std::size_t>(options.folds);
    if (options.laws.size() > 1 && folds >= 2 && data.size() >= folds * 2 &&
        data.size() - data.size() / folds - 1 > static_cast<std::size_t>(n)) {
      std::vector<double> squares;
      for (std::size_t f = 0; f < folds; ++f) {
        std::vector<Datum> rest, held;
        for (std::size_t k = 0; k < order.size(); ++k)
          (k * folds / order.size() == f ? held : rest).push_back(data[order[k]]);
        auto part = solve(law, rest);
        if (!part) return tl::unexpected<Error>(part.error());
        for (const Datum& d : held) squares.push_back(std::pow(residual_of(law, part->c, d), 2));
      }
      set_cross_validation(c, std::move(squares));
    }
    out.misfits.push_back(std::sqrt(misfit / static_cast<double>(data.size())));
    NoiseCoefficients coefficients{law, {}};
    for (int k = 0; k < n; ++k)
      coefficients.c[static_cast<std::size_t>(k)] =
          s->c[static_cast<std::size_t>(k)] * scale_of(law, k, unit);
    out.all.push_back(coefficients);
    out.result.candidates.push_back(c);
    solved.push_back(std::move(*s));
    laws.push_back(law);
  }
  if (laws.empty())
    return fail(ErrorCode::bad_input, "noise against amplitude",
                "expected more amplitudes than a law has coefficients, got " + std::to_string(data.size()));
  const std::size_t chosen = choose_model(out.result.candidates);
  const NoiseLaw law = laws[chosen];
  const Solved& s = solved[chosen];
  const int n = coefficients_of(law);
  out.noise = out.all[chosen];
  out.misfit = out.misfits[chosen];
  out.tau = s.tau;
  const FitResult& f = s.outcome.fit;
  std::vector<Candidate> candidates = std::move(out.result.candidates);
  std::vector<std::string> warnings = std::move(out.result.warnings);
  out.result = f;
  out.result.candidates = std::move(candidates);
  out.result.warnings = std::move(warnings);
  out.result.model = std::string(noise_law_name(law));
  for (WeakDirection& w : out.result.weak)
    w.cure = "record surfaces from the darkest to the brightest, so that the amplitudes span more";
  out.result.parameters.resize(static_cast<std::size_t>(n));
  out.result.covariance = f.covariance.topLeftCorner(n, n).eval();
  for (int k = 0; k < n; ++k) {
    const double scale = scale_of(law, k, unit);
    Parameter& p = out.result.parameters[static_cast<std::size_t>(k)];
    if (p.at_bound || p.value < 1.645 * p.sigma) {
      char text[200];
      std::snprintf(text, sizeof text, "not told from 0: below %.3g with 95 %% confidence",
                    (std::max(0.0, p.value) + 1.645 * p.sigma) * scale);
      out.result.not_identifiable.emplace_back(p.name, text);
    }
    p.value *= scale;
    p.sigma *= scale;
    p.resolution *= scale;
    out.result.covariance.row(k) *= scale;
    out.result.covariance.col(k) *= scale;
  }
  std::vector<double> residuals;
  for (const Datum& d : data) residuals.push_back(residual_of(law, s.c, d));
  out.result.residuals = statistics_of(residuals, "ln(sigma)");
  out.result.scale = 1;
  double least = 1e300, most = 0;
  for (const NoiseBin& b : bins) least = std::min(least, b.amplitude), most = std::max(most, b.amplitude);
  out.result.validity = {{"amplitude", least, most}};
  return out;
}

}  // namespace rigor::calibration

#include "calibration/tof/drift_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

constexpr double kLog2Pi = 1.8378770664093453;

struct Model {
  const char* name;
  bool correlated, walk;
  [[nodiscard]] int parameters() const { return 1 + (walk ? 1 : 0) + (correlated ? 2 : 0); }
};
constexpr std::array kModels{Model{"white", false, false}, Model{"random_walk", false, true},
                             Model{"correlated", true, false}, Model{"correlated+random_walk", true, true}};

/// In units of the series' own scale and of its period.
struct Noise {
  double white = 1, walk = 0, correlated = 0, time = 1;
};
/// ln white [, ln walk] [, ln correlated, ln time].
Noise noise_of(const Model& m, const Eigen::VectorXd& p) {
  Noise n;
  Eigen::Index i = 0;
  n.white = std::exp(p[i++]);
  if (m.walk) n.walk = std::exp(p[i++]);
  if (m.correlated) {
    n.correlated = std::exp(p[i++]);
    n.time = std::exp(p[i]);
  }
  return n;
}

struct Filtered {
  double minus_log_likelihood = 0;
  double c = 0, d = 0;  ///< at the middle of the series, per sample
  Eigen::Matrix2d cd_covariance = Eigen::Matrix2d::Zero();
};

/// Kalman filter of the walk and the correlated part, run at once over the series and over the regressors 1
/// and t (the augmented filter of de Jong, Ann. Statist. 19 (1991) 1073): c and d then follow by least
/// squares of the innovations. The walk begins at 0: its start is c.
Filtered filter(std::span<const double> y, const Noise& n, DriftFit* keep = nullptr, double scale = 1) {
  const double phi = n.correlated > 0 ? std::exp(-1 / n.time) : 0;
  const double q1 = n.walk * n.walk, q2 = n.correlated * n.correlated * (1 - phi * phi),
               r = n.white * n.white;
  double p11 = 0, p12 = 0, p22 = n.correlated * n.correlated;
  std::array<std::array<double, 2>, 3> x{};  // states of y, 1, t
  double log_sum = 0;
  double a00 = 0, a01 = 0, a11 = 0, b0 = 0, b1 = 0, yy = 0;
  double k1 = 0, k2 = 0, f = 1, log_f = 0;
  bool steady = false;
  std::size_t used = 0;
  const double middle = 0.5 * static_cast<double>(y.size());
  std::vector<std::array<double, 4>> steps;
  if (keep) steps.resize(y.size(), {kNaN, 0, 0, 0});
  for (std::size_t k = 0; k < y.size(); ++k) {
    const bool seen = std::isfinite(y[k]);
    if (!seen) steady = false;
    if (!steady) {
      f = p11 + 2 * p12 + p22 + r;
      log_f = std::log(f);
    }
    const std::array<double, 3> z{seen ? y[k] : 0, 1, (static_cast<double>(k) - middle) / middle};
    std::array<double, 3> v{};
    for (std::size_t j = 0; j < 3; ++j) v[j] = z[j] - x[j][0] - x[j][1];
    if (keep) steps[k] = {seen ? v[0] : kNaN, v[1], v[2], f};
    if (seen) {
      ++used;
      if (!steady) k1 = (p11 + p12) / f, k2 = (p12 + p22) / f;
      for (std::size_t j = 0; j < 3; ++j) x[j][0] += k1 * v[j], x[j][1] += k2 * v[j];
      const double w = 1 / f;
      log_sum += log_f;
      yy += w * v[0] * v[0];
      a00 += w * v[1] * v[1], a01 += w * v[1] * v[2], a11 += w * v[2] * v[2];
      b0 += w * v[1] * v[0], b1 += w * v[2] * v[0];
    }
    for (std::size_t j = 0; j < 3; ++j) x[j][1] *= phi;
    if (!steady) {
      double n11 = p11, n12 = p12, n22 = p22;
      if (seen) n11 -= k1 * k1 * f, n12 -= k1 * k2 * f, n22 -= k2 * k2 * f;
      n11 += q1, n12 *= phi, n22 = n22 * phi * phi + q2;
      steady = seen && std::abs(n11 - p11) <= 1e-14 * (n11 + r) && std::abs(n12 - p12) <= 1e-14 * (n11 + r) &&
               std::abs(n22 - p22) <= 1e-14 * (n22 + r);
      p11 = n11, p12 = n12, p22 = n22;
    }
  }
  Filtered out;
  Eigen::Matrix2d a;
  a << a00, a01, a01, a11;
  const Eigen::Vector2d b(b0, b1);
  const Eigen::Vector2d s = a.ldlt().solve(b);
  out.cd_covariance = a.inverse();
  out.c = s[0], out.d = s[1];
  out.minus_log_likelihood =
      0.5 * (static_cast<double>(used) * kLog2Pi + log_sum + std::max(0.0, yy - b.dot(s)));
  // The scale of c and d is marginalised too: without it variances come out short by two degrees of freedom.
  out.minus_log_likelihood += 0.5 * std::log(std::max(a.determinant(), 1e-300));
  if (keep) {
    keep->prediction.resize(y.size());
    keep->innovation.resize(y.size());
    for (std::size_t k = 0; k < y.size(); ++k) {
      const double e = steps[k][0] - s[0] * steps[k][1] - s[1] * steps[k][2];
      keep->innovation[k] = e / std::sqrt(steps[k][3]);
      keep->prediction[k] = (std::isfinite(y[k]) ? y[k] - e : kNaN) * scale;
    }
  }
  return out;
}

/// Nelder and Mead, then Newton's steps with the Hessian that the covariance needs anyway.
Eigen::VectorXd minimise(const std::function<double(const Eigen::VectorXd&)>& f, Eigen::VectorXd start,
                         int evaluations, double edge) {
  const Eigen::Index n = start.size();
  std::vector<std::pair<double, Eigen::VectorXd>> s{{f(start), start}};
  for (Eigen::Index i = 0; i < n; ++i) {
    Eigen::VectorXd p = start;
    p[i] += edge;
    s.emplace_back(f(p), p);
  }
  const auto less = [](const auto& a, const auto& b) { return a.first < b.first; };
  for (int k = 0; k < evaluations; ++k) {
    std::sort(s.begin(), s.end(), less);
    if (s.back().first - s.front().first < 1e-5) break;
    Eigen::VectorXd centre = Eigen::VectorXd::Zero(n);
    for (Eigen::Index i = 0; i < n; ++i)
      centre += s[static_cast<std::size_t>(i)].second / static_cast<double>(n);
    const auto try_at = [&](double t) {
      const Eigen::VectorXd p = centre + t * (s.back().second - centre);
      return std::make_pair(f(p), p);
    };
    auto reflected = try_at(-1);
    if (reflected.first < s.front().first) {
      auto further = try_at(-2);
      s.back() = further.first < reflected.first ? further : reflected;
    } else if (reflected.first < s[s.size() - 2].first) {
      s.back() = reflected;
    } else {
      auto nearer = try_at(reflected.first < s.back().first ? -0.5 : 0.5);
      if (nearer.first < std::min(reflected.first, s.back().first)) {
        s.back() = nearer;
      } else {
        for (std::size_t i = 1; i < s.size(); ++i) {
          s[i].second = 0.5 * (s[i].second + s[0].second);
          s[i].first = f(s[i].second);
        }
      }
    }
  }
  return std::min_element(s.begin(), s.end(), less)->second;
}

Eigen::MatrixXd hessian(const std::function<double(const Eigen::VectorXd&)>& f, const Eigen::VectorXd& at,
                        Eigen::VectorXd& gradient, const Eigen::VectorXd& step) {
  const Eigen::Index n = at.size();
  Eigen::MatrixXd h(n, n);
  gradient.resize(n);
  const double f0 = f(at);
  const auto moved = [&](Eigen::Index i, double a, Eigen::Index j, double b) {
    Eigen::VectorXd p = at;
    p[i] += a * step[i];
    p[j] += b * step[j];
    return f(p);
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    const double up = moved(i, 1, i, 0), down = moved(i, -1, i, 0);
    gradient[i] = (up - down) / (2 * step[i]);
    h(i, i) = (up - 2 * f0 + down) / (step[i] * step[i]);
    for (Eigen::Index j = 0; j < i; ++j)
      h(i, j) = h(j, i) =
          (moved(i, 1, j, 1) - moved(i, 1, j, -1) - moved(i, -1, j, 1) + moved(i, -1, j, -1)) /
          (4 * step[i] * step[j]);
  }
  return h;
}

struct Fitted {
  Eigen::VectorXd p;
  Eigen::MatrixXd information;
  double minus_log_likelihood = 0;
};

Eigen::VectorXd start_of(const Model& m, double count) {
  Eigen::VectorXd p(m.parameters());
  Eigen::Index i = 0;
  p[i++] = 0;
  if (m.walk) p[i++] = -0.5 * std::log(count);
  if (m.correlated) p[i++] = -1.5, p[i++] = std::log(std::sqrt(count));
  return p;
}

Fitted fit_model(const Model& m, std::span<const double> y, const Eigen::VectorXd* warm) {
  const auto count = static_cast<double>(y.size());
  const auto f = [&](const Eigen::VectorXd& p) {
    const Noise n = noise_of(m, p);
    // Beyond these ends the parts cannot be told from white noise, from a constant, or from nothing.
    double wall = 0;
    for (Eigen::Index i = 0; i < p.size(); ++i) wall += std::pow(std::max(0.0, std::abs(p[i]) - 18), 2);
    if (m.correlated)
      wall += std::pow(std::max(0.0, p[p.size() - 1] - std::log(2 * count)), 2) +
              std::pow(std::max(0.0, std::log(0.3) - p[p.size() - 1]), 2);
    return filter(y, n).minus_log_likelihood + 100 * wall;
  };
  Fitted out;
  out.p = minimise(f, warm ? *warm : start_of(m, count), warm ? 40 : 250, warm ? 0.1 : 0.7);
  if (warm) {
    out.minus_log_likelihood = f(out.p);
    return out;
  }
  Eigen::VectorXd step = Eigen::VectorXd::Constant(out.p.size(), 0.02), gradient;
  for (int round = 0; round < 4; ++round) {
    out.information = hessian(f, out.p, gradient, step);
    const Eigen::LDLT<Eigen::MatrixXd> solver(out.information);
    if (solver.info() != Eigen::Success || !solver.isPositive()) break;
    const Eigen::VectorXd move = -solver.solve(gradient);
    // A step of a fifth of a standard deviation changes ln L by 0.02: far above rounding, and still
    // parabolic.
    for (Eigen::Index i = 0; i < step.size(); ++i)
      step[i] = std::clamp(0.2 / std::sqrt(std::max(out.information(i, i), 1e-6)), 1e-5, 0.3);
    if (move.cwiseAbs().maxCoeff() > 1) break;
    const double before = f(out.p), after = f(out.p + move);
    if (after > before) break;
    out.p += move;
    if (before - after < 1e-8 && round > 0) break;
  }
  out.minus_log_likelihood = f(out.p);
  return out;
}

double step_of(std::span<const double> y) {
  // Whole multiples of a decimal step, as devices that report millimetres give them.
  for (const double step : {1e-2, 1e-3, 1e-4}) {
    bool all = true;
    for (const double v : y)
      if (std::isfinite(v) &&
          std::abs(v / step - std::round(v / step)) > 1e-6 * std::max(1.0, std::abs(v / step)))
        all = false;
    if (all) return step;
  }
  return 0;
}

}  // namespace

double model_allan(const DriftFit& f, double tau_s) {
  const double walk = f.random_walk * f.random_walk;
  double v = f.white_m * f.white_m * f.period_s / tau_s + walk * tau_s / 3 +
             f.drift_mps * f.drift_mps * tau_s * tau_s / 2;
  if (f.correlated_m > 0 && f.correlation_s > 0) {
    // Gauss–Markov: IEEE Std 952, annex B, with σ² the variance of the process.
    const double x = tau_s / f.correlation_s;
    v += 2 * f.correlated_m * f.correlated_m / x *
         (1 - 1 / (2 * x) * (3 - 4 * std::exp(-x) + std::exp(-2 * x)));
  }
  return std::sqrt(v);
}

Result<DriftFit> fit_drift(std::span<const double> range_m, double period_s, const DriftOptions& options) {
  const std::string where = options.name.empty() ? "series" : options.name;
  std::vector<double> values;
  for (const double v : range_m)
    if (std::isfinite(v)) values.push_back(v);
  if (values.size() < 100 || !(period_s > 0))
    return fail(ErrorCode::bad_input, where,
                "expected at least 100 readings of a target at rest and the time between them, got " +
                    std::to_string(values.size()));
  const auto median_of = [](std::vector<double> v) {
    std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
    return v[v.size() / 2];
  };
  const double centre = median_of(values);
  std::vector<Model> models;
  std::string names;
  for (const Model& m : kModels) {
    if (options.model == "auto" || options.model == m.name) models.push_back(m);
    names += (names.empty() ? "" : ", ") + std::string(m.name);
  }
  if (models.empty())
    return fail(ErrorCode::bad_input, "--model",
                "expected auto or one of " + names + ", got " + options.model);

  DriftFit out;
  out.period_s = period_s;
  out.step_m = step_of(range_m);
  out.series.assign(range_m.begin(), range_m.end());
  // Outliers: against the median of the neighbours, so that drift is none.
  constexpr std::ptrdiff_t kHalf = 15;
  const auto count = static_cast<std::ptrdiff_t>(range_m.size());
  std::vector<double> away(range_m.size(), kNaN), finite;
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    if (!std::isfinite(range_m[static_cast<std::size_t>(k)])) continue;
    std::vector<double> near;
    for (std::ptrdiff_t i = std::max<std::ptrdiff_t>(0, k - kHalf); i <= std::min(count - 1, k + kHalf); ++i)
      if (std::isfinite(range_m[static_cast<std::size_t>(i)]))
        near.push_back(range_m[static_cast<std::size_t>(i)]);
    away[static_cast<std::size_t>(k)] = range_m[static_cast<std::size_t>(k)] - median_of(std::move(near));
    finite.push_back(std::abs(away[static_cast<std::size_t>(k)]));
  }
  const double spread = std::max(1.4826 * median_of(finite), 0.6 * out.step_m);
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  if (!(spread > 0) || *low == *high)
    return fail(ErrorCode::bad_input, where,
                "expected readings that vary, got most of them the same: the device filters or holds its "
                "values, or steps by more than its noise");
  for (std::size_t k = 0; k < away.size(); ++k) {
    if (!(std::abs(away[k]) > options.reject_sigmas * spread)) continue;
    char text[120];
    std::snprintf(text, sizeof text, "%s reading %zu (%.6g m)", where.c_str(), k, range_m[k]);
    out.result.rejected.push_back({text, away[k], std::abs(away[k]) / spread});
    out.series[k] = kNaN;
  }
  std::sort(out.result.rejected.begin(), out.result.rejected.end(),
            [](const Rejected& a, const Rejected& b) { return a.sigmas > b.sigmas; });

  // In units of its own spread: the fit does not know metres.
  std::vector<double> y(out.series);
  for (double& v : y) v = (v - centre) / spread;
  std::vector<Fitted> fitted;
  std::vector<Candidate> candidates;
  const auto used =
      static_cast<std::size_t>(std::count_if(y.begin(), y.end(), [](double v) { return std::isfinite(v); }));
  for (const Model& m : models) {
    if (options.stop.stop_requested()) {
      out.result.interrupted = true;
      if (!fitted.empty()) break;
    }
    Fitted f = fit_model(m, y, nullptr);
    Candidate c;
    c.name = m.name;
    c.parameters = m.parameters() + 2;
    c.bic = 2 * f.minus_log_likelihood + c.parameters * std::log(static_cast<double>(used));
    DriftFit kept;
    (void)filter(y, noise_of(m, f.p), &kept, 1);
    double sum = 0;
    for (std::size_t k = 0; k < y.size(); ++k)
      if (std::isfinite(y[k])) sum += std::pow(y[k] - kept.prediction[k], 2);
    c.rms = spread * std::sqrt(sum / static_cast<double>(used));
    c.cross_validation = kNaN;
    if (models.size() > 1 && options.folds > 1) {
      std::vector<double> scores;
      const auto folds = static_cast<std::size_t>(options.folds);
      for (std::size_t k = 0; k < folds; ++k) {
        std::vector<double> rest = y;
        const std::size_t from = k * y.size() / folds, to = (k + 1) * y.size() / folds;
        for (std::size_t i = from; i < to; ++i) rest[i] = kNaN;
        const auto held = static_cast<double>(std::count_if(y.begin() + static_cast<std::ptrdiff_t>(from),
                                                            y.begin() + static_cast<std::ptrdiff_t>(to),
                                                            [](double v) { return std::isfinite(v); }));
        if (held < 1) continue;
        const Fitted part = fit_model(m, rest, &f.p);
        const Noise n = noise_of(m, part.p);
        const double density =
            (filter(y, n).minus_log_likelihood - filter(rest, n).minus_log_likelihood) / held;
        scores.push_back(spread * std::exp(density - 0.5 * (kLog2Pi + 1)));
      }
      const auto k = static_cast<double>(scores.size());
      const double mean = std::accumulate(scores.begin(), scores.end(), 0.0) / k;
      double square = 0;
      for (const double s : scores) square += (s - mean) * (s - mean);
      c.cross_validation = mean;
      c.cross_validation_sigma = std::sqrt(square / std::max(1.0, k - 1) / k);
    }
    candidates.push_back(c);
    fitted.push_back(std::move(f));
  }
  // Withheld thirds score noise types by single readings, where white noise hides the rest: the thirds differ
  // from each other by more than the models do. The likelihood decides; both are reported.
  std::vector<Candidate> by_bic = candidates;
  for (Candidate& c : by_bic) c.cross_validation = kNaN;
  const std::size_t chosen = choose_model(by_bic);
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    candidates[i].chosen = by_bic[i].chosen;
    candidates[i].note = by_bic[i].note;
  }
  const Model& model = models[chosen];
  const Fitted& f = fitted[chosen];
  const Noise noise = noise_of(model, f.p);
  const Filtered line = filter(y, noise, &out, 1);
  for (double& p : out.prediction) p = p * spread + centre;
  const double span_s = 0.5 * static_cast<double>(y.size()) * period_s;
  out.white_m = noise.white * spread;
  out.random_walk = noise.walk * spread / std::sqrt(period_s);
  out.correlated_m = noise.correlated * spread;
  out.correlation_s = noise.time * period_s;
  out.mean_m = centre + spread * line.c;
  out.drift_mps = spread * line.d / span_s;

  FitResult& r = out.result;
  r.model = model.name;
  r.candidates = std::move(candidates);
  r.parameters.push_back({"white_noise_m", out.white_m, 0, out.white_m});
  if (model.walk) r.parameters.push_back({"random_walk_m_per_sqrt_s", out.random_walk, 0, out.random_walk});
  if (model.correlated) {
    r.parameters.push_back({"correlated_noise_m", out.correlated_m, 0, out.correlated_m});
    r.parameters.push_back({"correlation_time_s", out.correlation_s, 0, out.correlation_s});
  }
  // Values are logarithms inside: the information in them is that of the logarithms over the values squared.
  const Eigen::Index n = f.p.size();
  std::vector<Parameter> logs;
  for (Eigen::Index i = 0; i < n; ++i)
    logs.push_back({r.parameters[static_cast<std::size_t>(i)].name, 0, 0, 1});
  const Eigen::MatrixXd information = f.information.size() > 0 ? f.information : Eigen::MatrixXd::Zero(n, n);
  r.weak = weak_directions(logs, information);
  for (WeakDirection& w : r.weak)
    w.cure = "record for ten times longer, with the temperature and the target as they are";
  const Eigen::MatrixXd log_covariance = covariance_from(logs, information);
  r.covariance = Eigen::MatrixXd::Zero(n + 2, n + 2);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double vi = r.parameters[static_cast<std::size_t>(i)].value;
    for (Eigen::Index j = 0; j < n; ++j)
      r.covariance(i, j) = log_covariance(i, j) * vi * r.parameters[static_cast<std::size_t>(j)].value;
    r.parameters[static_cast<std::size_t>(i)].sigma = logs[static_cast<std::size_t>(i)].sigma * vi;
  }
  const Eigen::Vector2d to_si(spread, spread / span_s);
  r.covariance.bottomRightCorner(2, 2) = to_si.asDiagonal() * line.cd_covariance * to_si.asDiagonal();
  r.parameters.push_back({"mean_range_m", out.mean_m, std::sqrt(r.covariance(n, n)), out.white_m * 10});
  r.parameters.push_back(
      {"drift_m_per_s", out.drift_mps, std::sqrt(r.covariance(n + 1, n + 1)), out.white_m * 10 / span_s});
  if (std::abs(out.drift_mps) < 1.96 * r.parameters.back().sigma)
    r.not_identifiable.emplace_back("drift_m_per_s",
                                    "no straight drift is told from the wandering of the readings: within ±" +
                                        std::to_string(1.96e3 * r.parameters.back().sigma) + " mm/s (95 %)");

  // Gaps are filled for the Allan deviation alone, which knows none.
  for (std::size_t k = 0; k < out.series.size(); ++k)
    if (!std::isfinite(out.series[k])) {
      std::size_t a = k, b = k;
      while (b < out.series.size() && !std::isfinite(out.series[b])) ++b;
      const double left = a > 0 ? out.series[a - 1] : kNaN,
                   right = b < out.series.size() ? out.series[b] : kNaN;
      out.series[k] = std::isfinite(left) && std::isfinite(right) ? 0.5 * (left + right)
                      : std::isfinite(left)                       ? left
                                                                  : right;
    }
  out.allan = overlapping_allan(out.series, period_s);
  // Of many points one lies beyond its interval by chance: noise that is white by all of them has no limit.
  const AllanPoint* limit =
      model.walk || model.correlated ? averaging_limit(out.allan, out.white_m) : nullptr;
  if (limit) out.averaging_limit = limit->averaged;
  out.minimum_deviation_m = 1e300;
  for (const AllanPoint& p : out.allan)
    if (p.deviation < out.minimum_deviation_m)
      out.minimum_deviation_m = p.deviation, out.minimum_tau_s = p.tau_s;
  if (out.averaging_limit > 0) {
    char text[300];
    std::snprintf(
        text, sizeof text,
        "averaging gains as 1/sqrt(N) up to about %zu readings (%.3g s); the least Allan deviation is "
        "%.3g m at %.3g s: no mean of this sensor is better than that, however many readings it has",
        out.averaging_limit, static_cast<double>(out.averaging_limit) * period_s, out.minimum_deviation_m,
        out.minimum_tau_s);
    r.warnings.emplace_back(text);
  }
  std::vector<double> residuals;
  for (std::size_t k = 0; k < y.size(); ++k)
    if (std::isfinite(y[k])) residuals.push_back(spread * y[k] + centre - out.prediction[k]);
  r.residuals = statistics_of(residuals, "m");
  r.residuals.rejected = r.rejected.size();
  r.scale = 1;
  r.validity = {{"range_m", *low, *high}, {"duration_s", 0, 2 * span_s}};
  return out;
}

}  // namespace rigor::calibration

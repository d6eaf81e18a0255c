#include "calibration/pair/time_offset.h"

#include <ceres/sized_cost_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/least_squares.h"
#include "calibration/pair/regression_spline.h"

namespace rigor::calibration {
namespace {

/// second − offset − gain · first(t + delay)
class Shifted : public ceres::SizedCostFunction<1, 3> {
 public:
  Shifted(const RegressionSpline& first, double t, double value) : first_(first), t_(t), value_(value) {}
  bool Evaluate(double const* const* p, double* residual, double** jacobian) const override {
    const auto [value, slope] = first_.at(t_ + p[0][0]);
    residual[0] = p[0][2] + p[0][1] * value - value_;
    if (jacobian != nullptr && jacobian[0] != nullptr) {
      jacobian[0][0] = p[0][1] * slope;
      jacobian[0][1] = value;
      jacobian[0][2] = 1;
    }
    return true;
  }

 private:
  const RegressionSpline& first_;
  double t_, value_;
};

Status check(const TimeSeries& s, const char* which) {
  const std::string where = std::string("time offset, ") + which + " channel";
  if (s.t_ns.size() != s.value.size() || s.t_ns.size() < 8)
    return fail(
        ErrorCode::bad_input, where,
        "expected at least 8 samples, got " + std::to_string(std::min(s.t_ns.size(), s.value.size())));
  for (std::size_t i = 0; i < s.t_ns.size(); ++i) {
    if (!std::isfinite(s.value[i]))
      return fail(ErrorCode::bad_input, where, "sample " + std::to_string(i) + " is not finite");
    if (i > 0 && s.t_ns[i] <= s.t_ns[i - 1])
      return fail(ErrorCode::bad_input, where,
                  "the time of sample " + std::to_string(i) + " does not increase");
  }
  return {};
}

/// How much of a quantity tells about time: its spread about its mean, or about a straight line.
double movement_of(const std::vector<double>& t, const std::vector<double>& y, bool about_a_line) {
  const double n = static_cast<double>(t.size());
  double st = 0, sy = 0, stt = 0, sty = 0, syy = 0;
  for (std::size_t i = 0; i < t.size(); ++i) {
    st += t[i] - t[0], sy += y[i] - y[0], stt += (t[i] - t[0]) * (t[i] - t[0]);
    sty += (t[i] - t[0]) * (y[i] - y[0]), syy += (y[i] - y[0]) * (y[i] - y[0]);
  }
  const double vtt = stt - st * st / n, vty = sty - st * sy / n, vyy = syy - sy * sy / n;
  return std::sqrt(std::max(0.0, about_a_line ? vyy - vty * vty / vtt : vyy) / n);
}

/// What least squares take for exact, the first channel, has noise of its own: it makes the gain too small,
/// and moves the delay towards where a spline is least noisy. Equations without that (corrected score:
/// Carroll, Ruppert, Stefanski and Crainiceanu, Measurement Error in Nonlinear Models, 2006, chapter 7),
///
///   Σ J r + (g² cov(s', s), g var(s), 0) = 0,      J = (g s', s, 1),  r = second − offset − gain s
///
/// and their covariance A⁻¹ M A⁻¹, where A = Σ J Jᵀ less the noise in it, and M the scatter of Σ J r by the
/// noise of the second channel and by the spline's, which neighbours share. False where the noise leaves
/// nothing to tell by: then nothing was changed.
bool solve_with_noise(const RegressionSpline& first, const std::vector<double>& t,
                      const std::vector<double>& y, Eigen::Index unknown, std::array<double, 3>& p,
                      Eigen::MatrixXd& covariance) {
  Eigen::Vector3d x(p[0], p[1], p[2]);
  Eigen::Matrix3d information;
  Eigen::MatrixXd weighed;
  double square = 0, of_first = 0;
  for (int round = 0; round < 30; ++round) {
    information.setZero();
    Eigen::Vector3d score = Eigen::Vector3d::Zero();
    weighed = Eigen::MatrixXd::Zero(first.size(), 3);
    square = of_first = 0;
    const double g = x[1];
    for (std::size_t i = 0; i < t.size(); ++i) {
      const RegressionSpline::Basis b = first.basis(t[i] + x[0]);
      const auto [value, slope] = first.at(t[i] + x[0]);
      const RegressionSpline::Noise n = first.noise(b);
      const Eigen::Vector3d j(g * slope, value, 1);
      const double r = y[i] - x[2] - g * value;
      information += j * j.transpose();
      information(0, 0) -= g * g * n.slope, information(1, 1) -= n.value;
      information(0, 1) -= g * n.both, information(1, 0) -= g * n.both;
      score += j * r + Eigen::Vector3d(g * g * n.both, g * n.value, 0);
      weighed.middleRows<4>(b.first) += b.value * j.transpose();
      square += r * r, of_first += g * g * n.value;
    }
    const Eigen::LDLT<Eigen::MatrixXd> factored(information.topLeftCorner(unknown, unknown));
    if (!factored.isPositive() || factored.info() != Eigen::Success) return false;
    const Eigen::VectorXd step = factored.solve(score.head(unknown));
    if (!step.allFinite()) return false;
    x.head(unknown) += step;
    if (step.dot(score.head(unknown)) <= 1e-12 * square) break;
  }
  const auto n = static_cast<double>(t.size());
  const double second = std::max(0.0, square / (n - static_cast<double>(unknown)) - of_first / n);
  const Eigen::MatrixXd a = information.topLeftCorner(unknown, unknown), j = weighed.leftCols(unknown),
                        inverse = a.inverse(),
                        scatter = second * a + x[1] * x[1] * j.transpose() * first.covariance_times(j);
  p = {x[0], x[1], x[2]};
  covariance = inverse * scatter * inverse;
  return true;
}

struct Linear {
  double gain = 1, offset = 0, rms = std::numeric_limits<double>::infinity();
};

}  // namespace

Result<TimeOffset> fit_time_offset(const TimeSeries& first, const TimeSeries& second,
                                   const TimeOffsetOptions& options) {
  if (auto s = check(first, "first"); !s) return tl::unexpected<Error>(s.error());
  if (auto s = check(second, "second"); !s) return tl::unexpected<Error>(s.error());
  const std::int64_t t0 = first.t_ns.front();
  std::vector<double> t;
  for (const auto ns : first.t_ns) t.push_back(static_cast<double>(ns - t0) * 1e-9);
  const RegressionSpline spline(t, first.value, options.first_exact);

  // Samples that have a counterpart at every delay of the search: the same ones are judged at each.
  std::vector<std::size_t> common;
  std::vector<double> at;
  for (std::size_t i = 0; i < second.t_ns.size(); ++i) {
    const double s = static_cast<double>(second.t_ns[i] - t0) * 1e-9;
    if (s - options.largest_s < spline.from() || s + options.largest_s > spline.to()) continue;
    common.push_back(i);
    at.push_back(s);
  }
  if (common.size() < 8)
    return fail(ErrorCode::bad_input, "time offset",
                "expected at least 8 samples that both channels have within " +
                    std::to_string(options.largest_s) + " s, got " + std::to_string(common.size()) +
                    "; record for longer, or search less far");

  const auto linear_at = [&](double delay) {
    const double n = static_cast<double>(common.size());
    double sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
    for (std::size_t k = 0; k < common.size(); ++k) {
      const double x = spline.at(at[k] + delay).first, y = second.value[common[k]];
      sx += x, sy += y, sxx += x * x, sxy += x * y, syy += y * y;
    }
    Linear l;
    const double vxx = sxx - sx * sx / n, vxy = sxy - sx * sy / n, vyy = syy - sy * sy / n;
    if (options.same_quantity) {
      l.rms = std::sqrt(std::max(0.0, sxx - 2 * sxy + syy) / n);
    } else {
      l.gain = vxx > 0 ? vxy / vxx : 0;
      l.offset = (sy - l.gain * sx) / n;
      l.rms = std::sqrt(std::max(0.0, vyy - l.gain * vxy) / n);
    }
    return l;
  };
  // Half the first channel's period is fine enough for a spline's valley.
  const double step = std::max((spline.to() - spline.from()) / static_cast<double>(2 * t.size()), 1e-5);
  double best = 0;
  Linear start;
  for (double delay = -options.largest_s; delay <= options.largest_s + step / 2; delay += step) {
    const Linear l = linear_at(delay);
    if (l.rms < start.rms) start = l, best = delay;
  }

  std::array<double, 3> p{best, start.gain, start.offset};
  double spread = 0, mean = 0;
  for (const double v : first.value) mean += v / static_cast<double>(first.value.size());
  for (const double v : first.value)
    spread += (v - mean) * (v - mean) / static_cast<double>(first.value.size());
  spread = std::sqrt(spread);
  LeastSquares fit;
  const bool held = options.same_quantity;
  fit.add_block(p.data(),
                {{"delay_s", options.largest_s, -2 * options.largest_s, 2 * options.largest_s},
                 {.name = "gain", .resolution = std::max(std::abs(start.gain), 1e-12), .held = held},
                 {.name = "offset",
                  .resolution = std::max({std::abs(start.gain) * spread, std::abs(start.offset), 1e-12}),
                  .held = held}});
  for (std::size_t k = 0; k < common.size(); ++k)
    fit.add(new Shifted(spline, at[k], second.value[common[k]]), {p.data()}, static_cast<std::uint32_t>(k));
  FitOptions fit_options;
  fit_options.reject_sigmas = options.reject_sigmas;
  auto solved = fit.solve(fit_options);
  if (!solved) return tl::unexpected<Error>(solved.error());
  TimeOffset out;
  out.first_sigma = spline.sigma();
  out.result = std::move(solved->fit);
  std::vector<double> t_used, y_used, left;
  std::vector<bool> rejected(common.size(), false);
  for (const std::uint32_t id : solved->rejected_ids) rejected[id] = true;
  for (std::size_t k = 0; k < common.size(); ++k)
    if (!rejected[k]) t_used.push_back(at[k]), y_used.push_back(second.value[common[k]]);
  Eigen::MatrixXd covariance;
  const bool told = solve_with_noise(spline, t_used, y_used, held ? 1 : 3, p, covariance);
  if (told) {
    const Eigen::Index unknown = covariance.rows();
    out.result.covariance.topLeftCorner(unknown, unknown) = covariance;
    for (Eigen::Index i = 0; i < unknown; ++i) {
      Parameter& parameter = out.result.parameters[static_cast<std::size_t>(i)];
      parameter.value = p[static_cast<std::size_t>(i)];
      parameter.sigma = std::sqrt(covariance(i, i));
    }
  }
  out.result.model = held ? "delay" : "delay, gain, offset";
  for (std::size_t i = 0; i < out.result.rejected.size() && i < solved->rejected_ids.size(); ++i)
    out.result.rejected[i].what =
        "sample " + std::to_string(common[solved->rejected_ids[i]]) + " of the second channel";
  for (std::size_t k = 0; k < common.size(); ++k) {
    out.residual.push_back(second.value[common[k]] - p[2] - p[1] * spline.at(at[k] + p[0]).first);
    out.residual_t_ns.push_back(second.t_ns[common[k]]);
    if (!rejected[k]) left.push_back(out.residual.back());
  }
  const std::size_t left_out = out.result.residuals.rejected;
  out.result.residuals = statistics_of(left, out.result.residuals.unit);
  out.result.residuals.rejected = left_out;
  const Parameter* delay = out.result.find("delay_s");
  if (delay != nullptr && std::abs(delay->value) > options.largest_s)
    out.result.warnings.push_back("the delay lies outside of the search; search farther");
  // What noise leaves of a first channel that stands still has slopes too, and would seem to tell; so does
  // what rounding leaves of either.
  std::vector<double> smooth, compared;
  double noise = 0;
  for (const double when : t) {
    smooth.push_back(spline.at(when).first);
    noise += spline.noise(spline.basis(when)).value / static_cast<double>(t.size());
  }
  for (const std::size_t k : common) compared.push_back(second.value[k]);
  const auto rounded = [](const std::vector<double>& v) {
    return 1e-9 * std::abs(*std::ranges::max_element(v, {}, [](double x) { return std::abs(x); }));
  };
  const bool moves = movement_of(t, smooth, !held) > std::max(4 * std::sqrt(noise), rounded(smooth)) &&
                     movement_of(at, compared, false) > rounded(compared);
  if (delay != nullptr && (!told || !moves || !(delay->sigma < options.largest_s))) {
    out.result.not_identifiable.emplace_back(
        "delay_s", "the quantity does not move enough, or moves evenly: record it swinging to and fro");
  }
  return out;
}

}  // namespace rigor::calibration

#include "calibration/pair/time_offset.h"

#include <ceres/sized_cost_function.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

/// Natural cubic spline over seconds. Source: de Boor, A Practical Guide to Splines, chapter IV.
class Spline {
 public:
  Spline(std::vector<double> t, std::vector<double> y)
      : t_(std::move(t)), y_(std::move(y)), m_(t_.size(), 0) {
    const std::size_t n = t_.size();
    std::vector<double> c(n, 0);
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double h0 = t_[i] - t_[i - 1], h1 = t_[i + 1] - t_[i];
      const double pivot = 2 * (h0 + h1) - h0 * c[i - 1];
      c[i] = h1 / pivot;
      m_[i] = (6 * ((y_[i + 1] - y_[i]) / h1 - (y_[i] - y_[i - 1]) / h0) - h0 * m_[i - 1]) / pivot;
    }
    for (std::size_t i = n - 1; i-- > 1;) m_[i] -= c[i] * m_[i + 1];
  }
  [[nodiscard]] double from() const { return t_.front(); }
  [[nodiscard]] double to() const { return t_.back(); }
  /// Value and slope; at the ends' outside the end's.
  [[nodiscard]] std::pair<double, double> at(double t) const {
    auto next = std::upper_bound(t_.begin(), t_.end(), t);
    next = std::clamp(next, t_.begin() + 1, t_.end() - 1);
    const auto i = static_cast<std::size_t>(next - t_.begin());
    const double h = t_[i] - t_[i - 1], a = (t_[i] - t) / h, b = (t - t_[i - 1]) / h;
    const double value =
        a * y_[i - 1] + b * y_[i] + ((a * a * a - a) * m_[i - 1] + (b * b * b - b) * m_[i]) * h * h / 6;
    const double slope =
        (y_[i] - y_[i - 1]) / h + ((3 * b * b - 1) * m_[i] - (3 * a * a - 1) * m_[i - 1]) * h / 6;
    return {value, slope};
  }

 private:
  std::vector<double> t_, y_, m_;
};

/// second − offset − gain · first(t + delay)
class Shifted : public ceres::SizedCostFunction<1, 3> {
 public:
  Shifted(const Spline& first, double t, double value) : first_(first), t_(t), value_(value) {}
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
  const Spline& first_;
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

/// Standard deviation of white noise on an evenly sampled smooth quantity, from its second differences.
double noise_of(const std::vector<double>& y) {
  std::vector<double> d;
  for (std::size_t i = 1; i + 1 < y.size(); ++i) d.push_back(std::abs(y[i - 1] - 2 * y[i] + y[i + 1]));
  const auto middle = d.begin() + static_cast<std::ptrdiff_t>(d.size() / 2);
  std::nth_element(d.begin(), middle, d.end());
  return 1.4826 * *middle / std::sqrt(6.0);
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
  const Spline spline(t, first.value);

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
  out.result = std::move(solved->fit);
  out.result.model = held ? "delay" : "delay, gain, offset";
  for (std::size_t i = 0; i < out.result.rejected.size() && i < solved->rejected_ids.size(); ++i)
    out.result.rejected[i].what =
        "sample " + std::to_string(common[solved->rejected_ids[i]]) + " of the second channel";
  for (std::size_t k = 0; k < common.size(); ++k) {
    out.residual.push_back(second.value[common[k]] - p[2] - p[1] * spline.at(at[k] + p[0]).first);
    out.residual_t_ns.push_back(second.t_ns[common[k]]);
  }
  const Parameter* delay = out.result.find("delay_s");
  if (delay != nullptr && std::abs(delay->value) > options.largest_s)
    out.result.warnings.push_back("the delay lies outside of the search; search farther");
  // Noise of the first channel has slopes too, and would seem to tell; so does what rounding leaves of a
  // second one that stands still.
  std::vector<double> compared;
  for (const std::size_t k : common) compared.push_back(second.value[k]);
  const double largest =
      std::abs(*std::ranges::max_element(compared, {}, [](double v) { return std::abs(v); }));
  const bool moves = movement_of(t, first.value, !held) > 4 * noise_of(first.value) &&
                     movement_of(at, compared, false) > 1e-9 * largest;
  if (delay != nullptr && (!moves || !(delay->sigma < options.largest_s))) {
    out.result.not_identifiable.emplace_back(
        "delay_s", "the quantity does not move enough, or moves evenly: record it swinging to and fro");
  }
  return out;
}

}  // namespace rigor::calibration

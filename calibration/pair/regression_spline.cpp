#include "calibration/pair/regression_spline.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor::calibration {
namespace {

/// Standard deviation of white noise on a smooth quantity, from seven neighbouring samples' differences of
/// the sixth order: of a sine with ten samples a period they leave 0.2 %.
double noise_of(const std::vector<double>& t, const std::vector<double>& y) {
  constexpr std::size_t kPoints = 7;
  std::vector<double> d;
  for (std::size_t i = 0; i + kPoints <= t.size(); ++i) {
    double sum = 0, square = 0;
    const double width = t[i + kPoints - 1] - t[i];
    for (std::size_t k = 0; k < kPoints; ++k) {
      double c = 1;
      for (std::size_t j = 0; j < kPoints; ++j)
        if (j != k) c *= width / (t[i + k] - t[i + j]);
      sum += c * y[i + k], square += c * c;
    }
    d.push_back(std::abs(sum) / std::sqrt(square));
  }
  // Without what jerks leave: few, and large.
  const auto middle = d.begin() + static_cast<std::ptrdiff_t>(d.size() / 2);
  std::nth_element(d.begin(), middle, d.end());
  const double most = *middle > 0 ? 4 * 1.4826 * *middle : std::numeric_limits<double>::infinity();
  double sum = 0, n = 0;
  for (const double v : d)
    if (v <= most) sum += v * v, ++n;
  return std::sqrt(sum / n);
}

}  // namespace

RegressionSpline::RegressionSpline(const std::vector<double>& t_s, const std::vector<double>& y, bool exact)
    : t_(t_s) {
  if (!exact) {
    const auto n = static_cast<double>(t_.size());
    double least = std::numeric_limits<double>::infinity();
    std::size_t best = 1;
    for (std::size_t spacing = 2; 4 * spacing <= t_.size(); spacing *= 2) {
      const double square = fit(y, spacing);
      const double left = 1 - static_cast<double>(coefficients_.size()) / n;
      if (const double error = square / (left * left); error < least) least = error, best = spacing;
    }
    const std::size_t spacing = std::max<std::size_t>(1, best / 2);
    const double square = fit(y, spacing), differences = noise_of(t_, y);
    const double left = 1 - static_cast<double>(coefficients_.size()) / n;
    sigma_ = spacing == 1 ? differences : std::min(differences, std::sqrt(square / left));
  } else {
    fit(y, 1);
  }
  invert();
}

double RegressionSpline::fit(const std::vector<double>& y, std::size_t spacing) {
  const std::size_t n = t_.size();
  knots_.assign(4, t_.front());
  // Through all samples: as many B-splines as samples, which leaves out the knots next to the ends.
  if (spacing == 1)
    knots_.insert(knots_.end(), t_.begin() + 2, t_.end() - 2);
  else
    for (std::size_t i = spacing; i + spacing / 2 < n - 1; i += spacing) knots_.push_back(t_[i]);
  knots_.insert(knots_.end(), 4, t_.back());
  const auto size = static_cast<Eigen::Index>(knots_.size() - 4);
  normal_ = Band::Zero(size, kBand);
  coefficients_ = Eigen::VectorXd::Zero(size);
  for (std::size_t i = 0; i < n; ++i) {
    const Basis b = basis(t_[i]);
    for (Eigen::Index r = 0; r < kBand; ++r) {
      coefficients_[b.first + r] += b.value[r] * y[i];
      for (Eigen::Index c = r; c < kBand; ++c) normal_(b.first + r, c - r) += b.value[r] * b.value[c];
    }
  }
  factor();
  coefficients_ = solve(coefficients_);
  double square = 0;
  for (std::size_t i = 0; i < n; ++i) square += std::pow(y[i] - at(t_[i]).first, 2);
  return square / static_cast<double>(n);
}

RegressionSpline::Basis RegressionSpline::basis(double t) const {
  const auto last = knots_.end() - 4;
  const auto next = std::clamp(std::upper_bound(knots_.begin() + 4, last, t), knots_.begin() + 4, last);
  const auto span = static_cast<std::size_t>(next - knots_.begin()) - 1;
  const double* const k = &knots_[span];
  // de Boor's recurrence, from constants to cubics; of the quadratics the slopes.
  std::array<double, 4> b{1, 0, 0, 0};
  Basis out;
  out.first = static_cast<Eigen::Index>(span) - 3;
  for (int degree = 1; degree <= 3; ++degree) {
    double saved = 0, before = 0;
    for (int r = 0; r < degree; ++r) {
      const double right = k[r + 1], left = k[r + 1 - degree];
      const double share = b[static_cast<std::size_t>(r)] / (right - left);
      if (degree == 3) out.slope[r] = 3 * (before - share), before = share;
      b[static_cast<std::size_t>(r)] = saved + (right - t) * share;
      saved = (t - left) * share;
    }
    if (degree == 3) out.slope[3] = 3 * before;
    b[static_cast<std::size_t>(degree)] = saved;
  }
  for (int i = 0; i < 4; ++i) out.value[i] = b[static_cast<std::size_t>(i)];
  return out;
}

std::pair<double, double> RegressionSpline::at(double t) const {
  const Basis b = basis(t);
  const auto c = coefficients_.segment<4>(b.first);
  return {b.value.dot(c), b.slope.dot(c)};
}

RegressionSpline::Noise RegressionSpline::noise(const Basis& b) const {
  Eigen::Matrix4d c;
  for (Eigen::Index i = 0; i < kBand; ++i)
    for (Eigen::Index j = i; j < kBand; ++j) c(i, j) = c(j, i) = inverse_(b.first + i, j - i);
  c *= sigma_ * sigma_;
  const Eigen::Vector4d of_value = c * b.value;
  return {b.value.dot(of_value), b.slope.dot(c * b.slope), b.slope.dot(of_value)};
}

Eigen::MatrixXd RegressionSpline::covariance_times(const Eigen::MatrixXd& x) const {
  return sigma_ * sigma_ * solve(x);
}

/// LDLᵀ of a banded matrix: Golub and Van Loan, Matrix Computations, 4.3.
void RegressionSpline::factor() {
  const Eigen::Index n = normal_.rows();
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index reach = std::min(kBand - 1, n - 1 - i);
    for (Eigen::Index r = 1; r <= reach; ++r) {
      const double l = normal_(i, r) / normal_(i, 0);
      for (Eigen::Index c = r; c <= reach; ++c) normal_(i + r, c - r) -= l * normal_(i, c);
    }
    for (Eigen::Index r = 1; r <= reach; ++r) normal_(i, r) /= normal_(i, 0);
  }
}

Eigen::MatrixXd RegressionSpline::solve(Eigen::MatrixXd x) const {
  const Eigen::Index n = normal_.rows();
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index r = 1; r < kBand && i + r < n; ++r) x.row(i + r) -= normal_(i, r) * x.row(i);
  for (Eigen::Index i = n; i-- > 0;) {
    x.row(i) /= normal_(i, 0);
    for (Eigen::Index r = 1; r < kBand && i + r < n; ++r) x.row(i) -= normal_(i, r) * x.row(i + r);
  }
  return x;
}

/// The inverse within the band, from the factors: Erisman and Tinney, Communications of the ACM 18, 1975.
void RegressionSpline::invert() {
  const Eigen::Index n = normal_.rows();
  inverse_ = Band::Zero(n, kBand);
  const auto entry = [&](Eigen::Index i, Eigen::Index j) {
    return inverse_(std::min(i, j), std::abs(i - j));
  };
  for (Eigen::Index i = n; i-- > 0;)
    for (Eigen::Index r = std::min(kBand - 1, n - 1 - i);; --r) {
      double sum = r == 0 ? 1 / normal_(i, 0) : 0;
      for (Eigen::Index k = 1; k < kBand && i + k < n; ++k) sum -= normal_(i, k) * entry(i + k, i + r);
      inverse_(i, r) = sum;
      if (r == 0) break;
    }
}

}  // namespace rigor::calibration

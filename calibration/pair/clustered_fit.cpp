#include "calibration/pair/clustered_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor::calibration {
namespace {

constexpr double kLeastInside = 0.05;
/// Of what columns vary by, the share that their instruments have, too. Of noise alone it is about 1/√rows.
constexpr double kLeastShare = 0.1;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

Eigen::Map<const Eigen::VectorXd> vector(std::span<const double> v) {
  return {v.data(), static_cast<Eigen::Index>(v.size())};
}

}  // namespace

ClusteredFit::ClusteredFit(std::size_t parameters, std::size_t places)
    : n_(parameters),
      place_scores_(Eigen::MatrixXd::Zero(Eigen::Index(parameters), Eigen::Index(places))),
      stretch_scores_(place_scores_),
      touched_(places) {
  clear();
}

void ClusteredFit::clear() {
  const auto n = static_cast<Eigen::Index>(n_);
  a_ = slope_ = information_ = time_ = both_ = Eigen::MatrixXd::Zero(n, n);
  b_ = inside_ = instruments_ = Eigen::VectorXd::Zero(n);
  place_scores_.setZero(), stretch_scores_.setZero();
  touched_.assign(touched_.size(), false);
  count_ = 0, stretches_ = 0;
}

void ClusteredFit::add(std::size_t place, std::span<const double> instrument,
                       std::span<const double> derivative, double residual, RobustWeight w) {
  // Of many beams an equation has one: what is 0 costs nothing.
  used_.clear();
  for (std::size_t i = 0; i < n_; ++i)
    if (instrument[i] != 0 || derivative[i] != 0) used_.push_back(static_cast<Eigen::Index>(i));
  const auto column = static_cast<Eigen::Index>(place);
  const double wr = w.weight * residual;
  for (const Eigen::Index k : used_) {
    const double j = derivative[static_cast<std::size_t>(k)], wj = w.weight * j, sj = w.slope * j;
    for (const Eigen::Index i : used_) {
      a_(i, k) += instrument[static_cast<std::size_t>(i)] * wj;
      slope_(i, k) += instrument[static_cast<std::size_t>(i)] * sj;
      information_(i, k) += derivative[static_cast<std::size_t>(i)] * wj;
    }
    inside_[k] += j * sj;
    const double z = instrument[static_cast<std::size_t>(k)], score = wr * z;
    instruments_[k] += w.weight * z * z;
    b_[k] += score;
    stretch_scores_(k, column) += score;
  }
  touched_[place] = true;
  ++count_;
}

void ClusteredFit::constrain(std::span<const double> coefficients) {
  constraints_.emplace_back(vector(coefficients));
}

void ClusteredFit::end_stretch() {
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(n_));
  bool any = false;
  for (std::size_t p = 0; p < touched_.size(); ++p) {
    if (!touched_[p]) continue;
    auto g = stretch_scores_.col(static_cast<Eigen::Index>(p));
    both_.noalias() += g * g.transpose();
    place_scores_.col(static_cast<Eigen::Index>(p)) += g;
    sum += g;
    g.setZero();
    touched_[p] = false;
    any = true;
  }
  if (!any) return;
  time_.noalias() += sum * sum.transpose();
  ++stretches_;
}

ClusteredFit::Solution ClusteredFit::solve(const std::vector<bool>& held) const {
  const auto n = static_cast<Eigen::Index>(n_);
  Solution s{Eigen::VectorXd::Zero(n), Eigen::MatrixXd::Zero(n, n), std::vector<bool>(n_, false)};
  std::vector<Eigen::Index> free;
  for (Eigen::Index i = 0; i < n; ++i)
    if (!held[static_cast<std::size_t>(i)]) free.push_back(i);
  const auto lost = [&](Eigen::Index i) { s.covariance(i, i) = kInfinity; };
  double places = 0;
  for (Eigen::Index p = 0; p < place_scores_.cols(); ++p)
    if (!place_scores_.col(p).isZero(0)) ++places;
  if (places < 2 || stretches_ < 2) {
    for (const Eigen::Index i : free) lost(i);
    return s;
  }
  // A condition binds what the data tell of: it does not make up for a parameter that has no data.
  std::erase_if(free, [&](Eigen::Index i) {
    if (!(information_(i, i) > 0) || !(instruments_[i] > 0)) lost(i);
    return std::isinf(s.covariance(i, i));
  });
  if (free.empty()) return s;
  // Conditions weigh as much as the data say of what they bind.
  Eigen::MatrixXd a = a_, slope = slope_, information = information_;
  for (Eigen::VectorXd c : constraints_) {
    for (Eigen::Index i = 0; i < n; ++i)
      if (std::isinf(s.covariance(i, i))) c[i] = 0;
    const double weight = (information_.diagonal().cwiseProduct(c.cwiseAbs2())).sum();
    const Eigen::MatrixXd condition = weight * c * c.transpose();
    a += condition, slope += condition, information += condition;
  }
  // What the data leave open: the null space in units in which every parameter's own information is 1.
  while (!free.empty()) {
    const auto m = static_cast<Eigen::Index>(free.size());
    Eigen::VectorXd unit(m);
    for (Eigen::Index i = 0; i < m; ++i)
      unit[i] = 1 / std::sqrt(information(free[std::size_t(i)], free[std::size_t(i)]));
    bool changed = false;
    Eigen::VectorXd open = Eigen::VectorXd::Zero(m);
    Eigen::MatrixXd scaled(m, m);
    for (Eigen::Index i = 0; i < m; ++i)
      for (Eigen::Index k = 0; k < m; ++k)
        scaled(i, k) = information(free[std::size_t(i)], free[std::size_t(k)]) * unit[i] * unit[k];
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scaled);
    for (Eigen::Index k = 0; k < m; ++k)
      if (eigen.eigenvalues()[k] < 1e-9) open += eigen.eigenvectors().col(k).cwiseAbs();
    for (Eigen::Index i = 0; i < m; ++i)
      if (open[i] > 1e-3) lost(free[std::size_t(i)]), changed = true;
    if (!changed) {
      // Columns of noise alone look as if they told something, and their instruments know nothing of them:
      // a move along walls, of which each side's normals are noise.
      Eigen::MatrixXd shared(m, m);
      for (Eigen::Index i = 0; i < m; ++i)
        for (Eigen::Index k = 0; k < m; ++k) {
          const Eigen::Index row = free[std::size_t(i)], column = free[std::size_t(k)];
          shared(i, k) =
              a(row, column) * std::sqrt(information_(row, row) / instruments_[row]) * unit[i] * unit[k];
        }
      const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> common(
          (shared + shared.transpose()) / 2, scaled);
      if (common.eigenvalues()[0] < kLeastShare) {
        Eigen::Index most = 0;
        common.eigenvectors().col(0).cwiseAbs().maxCoeff(&most);
        lost(free[std::size_t(most)]), changed = true;
      }
    }
    if (!changed) break;
    std::erase_if(free, [&](Eigen::Index i) { return std::isinf(s.covariance(i, i)); });
  }
  if (free.empty()) return s;

  const auto part = [&](const Eigen::MatrixXd& full) {
    const auto size = static_cast<Eigen::Index>(free.size());
    Eigen::MatrixXd out(size, size);
    for (Eigen::Index i = 0; i < size; ++i)
      for (Eigen::Index k = 0; k < size; ++k) out(i, k) = full(free[std::size_t(i)], free[std::size_t(k)]);
    return out;
  };
  Eigen::VectorXd b(static_cast<Eigen::Index>(free.size()));
  for (std::size_t i = 0; i < free.size(); ++i) b[Eigen::Index(i)] = b_[free[i]];
  const Eigen::VectorXd step = part(a).fullPivLu().solve(b);
  for (std::size_t i = 0; i < free.size(); ++i) s.step[free[i]] = step[Eigen::Index(i)];
  // Of what is known from outliers alone, the scatter does not give the uncertainty; after this step they may
  // be outliers no more.
  std::erase_if(free, [&](Eigen::Index i) {
    const bool outliers = inside_[i] < kLeastInside * information_(i, i);
    if (outliers) lost(i);
    return outliers;
  });
  if (free.empty()) return s;
  const auto m = static_cast<Eigen::Index>(free.size());
  const Eigen::MatrixXd inverse = part(slope).fullPivLu().inverse();
  if (!inverse.allFinite()) {
    for (const Eigen::Index i : free) lost(i);
    return s;
  }
  const double k = static_cast<double>(stretches_);
  const auto sandwich = [&](const Eigen::MatrixXd& meat) -> Eigen::MatrixXd {
    return inverse * meat * inverse.transpose();
  };
  const Eigen::MatrixXd by_place =
      places / (places - 1) * sandwich(part(place_scores_ * place_scores_.transpose()));
  const Eigen::MatrixXd by_time = k / (k - 1) * sandwich(part(time_)), by_both = sandwich(part(both_));
  // Correlations by place, of which there are many; standard deviations at least theirs, and more where
  // stretches of time say so. A difference of matrices need not be a covariance; this is.
  Eigen::VectorXd more(m);
  for (Eigen::Index i = 0; i < m; ++i) {
    const double two_ways = by_place(i, i) + by_time(i, i) - by_both(i, i);
    more[i] = by_place(i, i) > 0 ? std::sqrt(std::max(1.0, two_ways / by_place(i, i))) : 1;
  }
  const Eigen::MatrixXd covariance = more.asDiagonal() * by_place * more.asDiagonal();
  for (Eigen::Index i = 0; i < m; ++i) {
    s.determined[std::size_t(free[std::size_t(i)])] = true;
    for (Eigen::Index j = 0; j < m; ++j)
      s.covariance(free[std::size_t(i)], free[std::size_t(j)]) = (covariance(i, j) + covariance(j, i)) / 2;
  }
  return s;
}

bool ClusteredFit::Solution::is_small(double share) const {
  for (Eigen::Index i = 0; i < step.size(); ++i)
    if (!(std::abs(step[i]) <=
          (determined[std::size_t(i)] ? share * std::sqrt(covariance(i, i)) : kLeastStep)))
      return false;
  return true;
}

double Relaxation::next(const Eigen::VectorXd& step) {
  if (before_.size() == step.size()) {
    const Eigen::VectorXd change = step - before_;
    const double squares = change.squaredNorm();
    const double factor = squares > 0 ? -factor_ * before_.dot(change) / squares : 1;
    factor_ = factor > 0 ? std::clamp(factor, kLeast, 1.0) : 1;
  }
  before_ = step;
  return factor_;
}

}  // namespace rigor::calibration

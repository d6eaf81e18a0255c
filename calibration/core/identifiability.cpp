// What the data determine and what they leave free: from the information matrix of a fit.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::vector<std::size_t> free_indices(const std::vector<Parameter>& parameters) {
  std::vector<std::size_t> free;
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (!parameters[i].held) free.push_back(i);
  return free;
}

std::string words_for(const WeakDirection& w) {
  if (w.parts.size() == 1) return "the data do not determine " + w.parts[0].name;
  std::string names;
  for (std::size_t i = 0; i < w.parts.size(); ++i) {
    if (i > 0) names += i + 1 == w.parts.size() ? " and " : ", ";
    names += w.parts[i].name;
  }
  return "the data cannot tell apart " + names + ": a change of one is made up for by the others";
}

}  // namespace

std::vector<WeakDirection> weak_directions(const std::vector<Parameter>& parameters,
                                           const Eigen::MatrixXd& information) {
  const auto free = free_indices(parameters);
  const auto n = static_cast<Eigen::Index>(free.size());
  if (n == 0) return {};
  Eigen::VectorXd resolution(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double r = parameters[free[static_cast<std::size_t>(i)]].resolution;
    resolution[i] = r > 0 ? r : 1;
  }
  Eigen::MatrixXd scaled = resolution.asDiagonal() * information * resolution.asDiagonal();
  scaled = 0.5 * (scaled + scaled.transpose()).eval();
  Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scaled);
  const double floor = std::max(0.0, eigen.eigenvalues().maxCoeff()) * 1e-15 * static_cast<double>(n);
  std::vector<WeakDirection> weak;
  for (Eigen::Index k = 0; k < n; ++k) {
    const double l = eigen.eigenvalues()[k];
    if (l >= 1) break;  // in increasing order
    WeakDirection w;
    w.sigma = l > floor ? 1 / std::sqrt(l) : kInfinity;
    const Eigen::VectorXd v = eigen.eigenvectors().col(k);
    Eigen::Index at = 0;
    const double largest = v.cwiseAbs().maxCoeff(&at);
    for (Eigen::Index i = 0; i < n; ++i)
      if (std::abs(v[i]) >= 0.2 * largest)
        w.parts.push_back({parameters[free[static_cast<std::size_t>(i)]].name, v[i] / v[at]});
    std::stable_sort(w.parts.begin(), w.parts.end(),
                     [](const auto& a, const auto& b) { return std::abs(a.weight) > std::abs(b.weight); });
    w.words = words_for(w);
    weak.push_back(std::move(w));
  }
  return weak;
}

Eigen::MatrixXd covariance_from(std::vector<Parameter>& parameters, const Eigen::MatrixXd& information) {
  const auto free = free_indices(parameters);
  const auto n = static_cast<Eigen::Index>(free.size());
  const auto all = static_cast<Eigen::Index>(parameters.size());
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(all, all);
  if (n == 0) return covariance;
  Eigen::VectorXd scale(n);
  for (Eigen::Index i = 0; i < n; ++i)
    scale[i] = information(i, i) > 0 ? 1 / std::sqrt(information(i, i)) : 0;
  Eigen::MatrixXd unit = scale.asDiagonal() * information * scale.asDiagonal();
  unit = 0.5 * (unit + unit.transpose()).eval();
  Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(unit);
  const double floor = 1e-13 * static_cast<double>(n);
  Eigen::VectorXd inverse(n);
  std::vector<bool> unknown(static_cast<std::size_t>(n), false);
  for (Eigen::Index k = 0; k < n; ++k) {
    const double l = eigen.eigenvalues()[k];
    inverse[k] = l > floor ? 1 / l : 0;
    if (l > floor) continue;
    for (Eigen::Index i = 0; i < n; ++i)
      if (std::abs(eigen.eigenvectors()(i, k)) > 1e-5) unknown[static_cast<std::size_t>(i)] = true;
  }
  Eigen::MatrixXd c = eigen.eigenvectors() * inverse.asDiagonal() * eigen.eigenvectors().transpose();
  c = scale.asDiagonal() * c * scale.asDiagonal();
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::size_t pi = free[static_cast<std::size_t>(i)];
    for (Eigen::Index j = 0; j < n; ++j) {
      const std::size_t pj = free[static_cast<std::size_t>(j)];
      const bool lost = unknown[static_cast<std::size_t>(i)] || unknown[static_cast<std::size_t>(j)];
      covariance(static_cast<Eigen::Index>(pi), static_cast<Eigen::Index>(pj)) = lost ? 0 : c(i, j);
    }
    const double variance = unknown[static_cast<std::size_t>(i)] ? kInfinity : c(i, i);
    covariance(static_cast<Eigen::Index>(pi), static_cast<Eigen::Index>(pi)) = variance;
    parameters[pi].sigma = std::sqrt(variance);
  }
  return covariance;
}

}  // namespace rigor::calibration

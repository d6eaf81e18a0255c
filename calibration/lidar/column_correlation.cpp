#include "calibration/lidar/column_correlation.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <vector>

namespace rigor::calibration::lidar {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kLags[] = {1, 2, 3, 4, 6, 8, 11, 15, 20};

class Columns {
 public:
  Columns(std::span<const ColumnResidual> columns, int per_plane)
      : columns_(columns), n_(static_cast<Index>(columns.size())) {
    int planes = 0;
    for (const ColumnResidual& c : columns_) planes = std::max(planes, c.plane + 1);
    MatrixXd design = MatrixXd::Zero(n_, planes * per_plane + 1);
    for (Index i = 0; i < n_; ++i) {
      const ColumnResidual& c = at(i);
      for (int k = 0; k < per_plane; ++k)
        design(i, c.plane * per_plane + k) = c.d_plane[static_cast<std::size_t>(k)];
      design(i, planes * per_plane) = c.d_bias;
      squares_ += c.z * c.z;
    }
    q_ = orthonormal(design);
    measure();
  }
  [[nodiscard]] bool any() const { return squares_ > 0; }
  [[nodiscard]] double squares() const { return squares_; }

  /// Observed less expected correlation of the residuals, squared, over all lags.
  [[nodiscard]] double misfit(const VectorXd& r) const {
    const double s = of_squares_.dot(r);
    double sum = 0;
    for (std::size_t l = 0; l < std::size(kLags); ++l) {
      const double e = observed_[l] - (s > 0 ? of_products_[l].dot(r) / s : 0);
      sum += e * e;
    }
    return sum;
  }
  [[nodiscard]] VectorXd correlations(const ColumnProcess& p) const {
    VectorXd r(of_squares_.size());
    for (Index d = 0; d < r.size(); ++d) r[d] = p.at(static_cast<int>(d));
    return r;
  }
  [[nodiscard]] double kept(const VectorXd& r) const { return of_squares_.dot(r) / of_squares_[0]; }
  [[nodiscard]] double neighbours() const { return observed_[0]; }

 private:
  [[nodiscard]] const ColumnResidual& at(Index i) const { return columns_[static_cast<std::size_t>(i)]; }
  static MatrixXd orthonormal(MatrixXd design) {
    for (Index k = 0; k < design.cols(); ++k)
      if (const double length = design.col(k).norm(); length > 0) design.col(k) /= length;
    const Eigen::ColPivHouseholderQR<MatrixXd> qr(design);
    return qr.householderQ() * MatrixXd::Identity(design.rows(), qr.rank());
  }
  /// The column `lag` cells on along the same wall; −1: none.
  [[nodiscard]] Index on(Index i, int lag) const {
    for (Index j = i + 1; j < n_ && at(j).plane == at(i).plane && at(j).cell <= at(i).cell + lag; ++j)
      if (at(j).cell == at(i).cell + lag) return j;
    return -1;
  }
  [[nodiscard]] double outside(Index i, Index j) const {
    return (i == j ? 1.0 : 0.0) - q_.row(i).dot(q_.row(j));
  }

  /// Residuals are M e with M = 1 − Q Qᵀ. With S, which has a one for each pair of columns at a lag, the
  /// products' expectation is tr(M S M R), that of the squares tr(M R); R, the correlation of the errors,
  /// hangs on the distance along a wall alone: the sums of M S M and of M over each distance.
  void measure() {
    Index distances = 1;
    for (Index i = 0; i < n_; ++i)
      for (Index j = i; j < n_ && at(j).plane == at(i).plane; ++j)
        distances = std::max(distances, static_cast<Index>(at(j).cell - at(i).cell) + 1);
    of_squares_ = VectorXd::Zero(distances);
    of_products_.assign(std::size(kLags), VectorXd::Zero(distances));
    observed_.assign(std::size(kLags), 0);
    const auto by_distance = [&](VectorXd& sums, auto&& value) {
      for (Index first = 0, end = 0; first < n_; first = end) {
        while (end < n_ && at(end).plane == at(first).plane) ++end;
        for (Index i = first; i < end; ++i)
          for (Index j = first; j < end; ++j) sums[std::abs(at(i).cell - at(j).cell)] += value(i, j);
      }
    };
    by_distance(of_squares_, [&](Index i, Index j) { return outside(i, j); });
    for (std::size_t l = 0; l < std::size(kLags); ++l) {
      MatrixXd after = MatrixXd::Zero(n_, q_.cols()), before = after;  // S Q, Sᵀ Q
      std::vector<Index> next(static_cast<std::size_t>(n_));
      for (Index i = 0; i < n_; ++i) {
        const Index j = next[static_cast<std::size_t>(i)] = on(i, kLags[l]);
        if (j < 0) continue;
        after.row(i) = q_.row(j), before.row(j) = q_.row(i);
        observed_[l] += at(i).z * at(j).z / squares_;
      }
      const MatrixXd inner = q_ * (q_.transpose() * after) - after;  // Q (Qᵀ S Q) − S Q
      by_distance(of_products_[l], [&](Index i, Index j) {
        return (next[static_cast<std::size_t>(i)] == j ? 1.0 : 0.0) - q_.row(i).dot(before.row(j)) +
               inner.row(i).dot(q_.row(j));
      });
    }
  }

  std::span<const ColumnResidual> columns_;
  Index n_;
  double squares_ = 0;
  MatrixXd q_;
  VectorXd of_squares_;
  std::vector<VectorXd> of_products_;
  std::vector<double> observed_;
};

}  // namespace

double ColumnProcess::at(int distance) const {
  return std::pow(rho, distance) * std::cos(omega_rad * distance);
}

ColumnProcess column_process(std::span<const ColumnResidual> columns, int per_plane) {
  ColumnProcess best;
  if (columns.size() < 10) return best;
  const Columns c(columns, per_plane);
  if (!c.any()) return best;
  double least = c.misfit(c.correlations(best));
  // Correlation lengths from 0.3 to 50 cells, intervals from 8 cells on.
  for (int i = 0; i <= 40; ++i)
    for (int k = 0; k <= 24; ++k) {
      ColumnProcess p;
      p.rho = std::exp(-1 / (0.3 * std::pow(50 / 0.3, i / 40.0)));
      p.omega_rad = std::numbers::pi / 4 * k / 24;
      if (const double m = c.misfit(c.correlations(p)); m < least) least = m, best = p;
    }
  const VectorXd r = c.correlations(best);
  best.kept = std::clamp(c.kept(r), 0.05, 1.0);
  best.neighbours = c.neighbours();
  return best;
}

}  // namespace rigor::calibration::lidar

// A smooth quantity from samples that are noisy: a cubic spline fitted by least squares.
//
// Where the samples are noisy its knots are several samples apart, so that noise averages out and movement
// does not: as far as the least generalised cross-validation says (Craven and Wahba, Numerische Mathematik
// 31, 1979), and half as far again, since what is lost by smoothing costs an estimate more than noise, whose
// size is known. B-splines: de Boor, A Practical Guide to Splines, chapters IX, X and XIV.
#pragma once

#include <Eigen/Core>
#include <array>
#include <utility>
#include <vector>

namespace rigor::calibration {

class RegressionSpline {
 public:
  /// The four B-splines that are not 0 at a time.
  struct Basis {
    Eigen::Index first = 0;
    Eigen::Vector4d value, slope;  ///< slope: a second
  };
  /// Variances of the quantity and of its slope at a time, and the covariance of both, from the samples'
  /// noise.
  struct Noise {
    double value = 0, slope = 0, both = 0;
  };

  /// `t_s` increasing, at least 8, `y` finite and as many. `exact`: through every sample, which has no noise.
  RegressionSpline(const std::vector<double>& t_s, const std::vector<double>& y, bool exact);

  [[nodiscard]] double from() const { return t_.front(); }
  [[nodiscard]] double to() const { return t_.back(); }
  /// Standard deviation of a sample's noise.
  [[nodiscard]] double sigma() const { return sigma_; }
  [[nodiscard]] Eigen::Index size() const { return coefficients_.size(); }

  [[nodiscard]] Basis basis(double t_s) const;
  /// Value and slope; past the ends the last polynomial goes on.
  [[nodiscard]] std::pair<double, double> at(double t_s) const;
  [[nodiscard]] Noise noise(const Basis& b) const;
  /// C x, with C the covariance of the coefficients. x: size() rows.
  [[nodiscard]] Eigen::MatrixXd covariance_times(const Eigen::MatrixXd& x) const;

 private:
  static constexpr Eigen::Index kBand = 4;
  using Band = Eigen::Matrix<double, Eigen::Dynamic, kBand, Eigen::RowMajor>;
  /// Knots, coefficients, mean square of what is left over (NaN: nothing is).
  double fit(const std::vector<double>& y, std::size_t spacing);
  void factor();
  [[nodiscard]] Eigen::MatrixXd solve(Eigen::MatrixXd x) const;
  void invert();

  std::vector<double> t_, knots_;
  Eigen::VectorXd coefficients_;
  double sigma_ = 0;
  Band normal_;  ///< BᵀB: row i has columns i to i + 3; once factored D and L of LDLᵀ, below the diagonal
  Band inverse_;  ///< of BᵀB, as far as the band goes
};

}  // namespace rigor::calibration

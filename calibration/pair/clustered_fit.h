// Estimating equations whose uncertainty comes from the scatter of what hangs together.
//
//   Σ_i z_i w_i (r_i − J_iᵀ δ) = 0      δ = A⁻¹ b,  A = Σ z w Jᵀ,  b = Σ z w r
//
// z = J is weighted least squares. Where J is measured itself (a normal from noisy points), its noise makes δ
// too small; a z that has noise of its own, independent of J's, does not (instrumental variables: Wooldridge,
// Econometric Analysis of Cross Section and Panel Data, 2010, chapter 5). z must not hold the noise of its
// own residual either. A combination of columns whose variation its instruments do not share (less than a
// tenth of it) is noise, and one of its parameters is not determined: neither its value nor the scatter says
// how far off it is.
//
// Huber's weight w depends on r, and the covariance takes that into account: beyond the limit w r is
// constant, so such a residual adds to the scatter and nothing to the slope B = Σ z (d(w r)/dr) Jᵀ (Huber and
// Ronchetti, Robust Statistics, 2009, section 7.6). With A in place of B, standard deviations would be 14 %
// too small for normal residuals.
//
// A fixed pattern stays at its place and a disturbance stays for its time, so residuals of one place, or of
// one stretch of time, are no independent witnesses. The covariance is B⁻¹ (V_place + V_time − V_both) B⁻ᵀ
// with V_c the sum over the clusters of g gᵀ, g = Σ z w r in the cluster (two ways of clustering: Cameron,
// Gelbach and Miller, Journal of Business & Economic Statistics 29, 2011). It is that of the last linear
// step: residuals are those at the solution.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace rigor::calibration {

/// Weight of a residual, and d(weight · residual)/d residual.
struct RobustWeight {
  double weight = 0, slope = 0;
};
/// Of Huber's weights, in standard deviations of the noise: 95 % efficient where it is normal.
inline constexpr double kHuberLimit = 1.345;
/// Huber's; `far`: size of the residual over the limit.
inline RobustWeight huber_weight(double weight, double far) noexcept {
  return far > 1 ? RobustWeight{weight / far, 0} : RobustWeight{weight, weight};
}

/// Steps of what is not determined that are no longer taken: metres, radians or shares.
inline constexpr double kLeastStep = 1e-5;

/// Share of each step of a series of passes that is taken, one for all parameters. Where derivatives are too
/// small, as of an edge one pixel wide that is differenced over two, steps are too long; of twice the right
/// length they go to and fro for ever. A step that points back shortens what is taken (Aitken's relaxation:
/// Irons and Tuck, International Journal for Numerical Methods in Engineering 1, 1969); one that has grown in
/// the same direction makes it whole again.
class Relaxation {
 public:
  /// `step`: in standard deviations. From kLeast to 1, at first 1.
  double next(const Eigen::VectorXd& step);

 private:
  static constexpr double kLeast = 0.1;
  double factor_ = 1;
  Eigen::VectorXd before_;
};

class ClusteredFit {
 public:
  /// Setup; allocates.
  ClusteredFit(std::size_t parameters, std::size_t places);

  /// One residual. `place` below the number given to the constructor.
  void add(std::size_t place, std::span<const double> instrument, std::span<const double> derivative,
           double residual, RobustWeight weight);
  /// A condition on the parameters, Σ c δ = 0, that counts for every later solution.
  void constrain(std::span<const double> coefficients);
  /// What was added since the last call is one stretch of time.
  void end_stretch();
  void clear();

  struct Solution {
    /// 0 where held or where the data say nothing. What outliers alone tell of has a step, which may bring
    /// them back, and is not determined.
    Eigen::VectorXd step;
    Eigen::MatrixXd covariance;    ///< zero rows where held; infinite variance where not determined
    std::vector<bool> determined;  ///< false: held, or neither the data nor their scatter tell of it
    /// Each step is at most `share` of its standard deviation, of what is not determined at most kLeastStep.
    [[nodiscard]] bool is_small(double share) const;
  };
  /// `held`: these stay; the rest is solved for. Fewer than two stretches or places: all is undetermined.
  [[nodiscard]] Solution solve(const std::vector<bool>& held) const;

  [[nodiscard]] std::uint64_t count() const { return count_; }

 private:
  std::size_t n_;
  Eigen::MatrixXd a_, slope_, information_, time_, both_, place_scores_, stretch_scores_;
  Eigen::VectorXd b_, inside_;   ///< `inside_`: diagonal of the information without what is beyond the limit
  Eigen::VectorXd instruments_;  ///< their weighted squares
  std::vector<Eigen::VectorXd> constraints_;
  std::vector<bool> touched_;
  std::vector<Eigen::Index> used_;  ///< scratch
  std::uint64_t count_ = 0;
  std::size_t stretches_ = 0;
};

}  // namespace rigor::calibration

// Robust least squares over Ceres with an honest end: outliers are named and left out, the covariance comes
// from what is left, and directions that the data do not determine are found and named instead of hidden.
//
//   LeastSquares fit;
//   fit.add_block(camera, {{"fx_px", 10}, {"fy_px", 10}, …});            // wanted: reported
//   for (view) fit.add_nuisance(pose, 6);                                // solved for, marginalised
//   for (corner) fit.add(new ceres::AutoDiffCostFunction<…>(…), {camera, pose}, corner_id);
//   Result<FitResult> r = fit.solve(options);
//
// Steps (each deterministic, on any number of threads):
//   1. a robust fit (Cauchy, its scale from the median absolute residual, taken again until it stays),
//   2. observations beyond `reject_sigmas` are left out and the rest fitted plainly; again until the set
//      stays: one that fits again comes back. With few degrees of freedom the limit is as far out as
//      Student's t says,
//   3. covariance s²·(JᵀJ)⁻¹ with the nuisance blocks eliminated (Schur), s² = SSR/(m − p), p without
//      directions that are exactly free.
//
// The analysis of what is determined works on parameters in units of their `resolution`, so that it does not
// depend on the units that were chosen.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/manifold.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::calibration {

/// One parameter of a wanted block.
struct ParameterInfo {
  std::string name{};
  double resolution = 1;  ///< see Parameter
  double lower = -1e300, upper = 1e300;
  bool held = false;
};

struct FitOptions {
  bool robust = true;  ///< steps 1 and 2; off: one plain fit of everything
  /// Start values for another fit: step 1 alone and not to its end. The covariance is then none to be used.
  bool rough = false;
  double reject_sigmas = 4;  ///< an observation's residual norm over s·√(its dimension)
  /// Residuals are in units of their stated noise: s = 1 means that it was right. The covariance is that of
  /// the stated noise, times s² where s is larger than chance explains (Outcome::enlarged).
  bool whitened = false;
  int max_iterations = 200;
  int threads = 0;     ///< 0: all cores; the result does not depend on it beyond rounding
  std::string unit{};  ///< of the residuals
  StopToken stop{};    ///< asked between iterations; the best so far is then returned, marked
  /// Called between iterations with 0 … 1 (a guess) and the current RMS.
  std::function<void(double, double)> progress{};
};

class LeastSquares {
 public:
  LeastSquares();
  ~LeastSquares();
  LeastSquares(const LeastSquares&) = delete;
  LeastSquares& operator=(const LeastSquares&) = delete;

  /// `values` are the start, and the result; they stay the caller's and outlive this object.
  void add_block(double* values, std::vector<ParameterInfo> infos);
  /// Parameters that are solved for and not reported: poses, points. No two of them in one residual, unless
  /// `joint` (then their elimination costs more).
  void add_nuisance(double* values, int size, std::shared_ptr<ceres::Manifold> manifold = nullptr);
  /// An observation: `id` is the caller's, for names of what is rejected. Takes ownership of `cost`.
  void add(ceres::CostFunction* cost, std::vector<double*> blocks, std::uint32_t id);
  /// Many observations of the same blocks in one function, which is evaluated and solved faster than as many
  /// small ones: its residuals are those of `ids`, one after the other, of equal number. Each is judged and
  /// left out on its own. One that has no residual here (a point behind the camera) is written as infinity,
  /// with `true`.
  void add_batch(ceres::CostFunction* cost, std::vector<double*> blocks, std::vector<std::uint32_t> ids);

  struct Outcome {
    FitResult fit;                            ///< without candidates, validity, names of the rejected
    std::vector<std::uint32_t> rejected_ids;  ///< in order of `fit.rejected`
    std::vector<double> residuals;            ///< of the observations that were used, scalars
    /// Covariance of each nuisance block (tangent space), in order of their addition, for predictions of
    /// their own; only with FitOptions' callers that ask by `want_nuisance_covariance`.
    std::vector<Eigen::MatrixXd> nuisance_covariance;
    int iterations = 0;
    double cost = 0;
    /// Of `whitened` residuals: factor on the standard uncertainties where the residuals contradict the
    /// stated noise; else 1. The caller says so.
    double enlarged = 1;
  };
  bool want_nuisance_covariance = false;
  /// bad_input where there are fewer residuals than parameters; protocol-free. One thread.
  [[nodiscard]] Result<Outcome> solve(const FitOptions& options);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The weak directions of a covariance (infinite where exactly free: `null_space` columns), in units of the
/// parameters' resolutions: those with a standard deviation above 1. Exposed for models that are not fitted
/// by LeastSquares.
[[nodiscard]] std::vector<WeakDirection> weak_directions(const std::vector<Parameter>& parameters,
                                                         const Eigen::MatrixXd& information);
/// Covariance from an information matrix (JᵀJ/s²) of free parameters, safely: unit-diagonal scaling,
/// eigenvalues, and infinite variance for what lies in its null space. `free` are indices into `parameters`;
/// sets their sigma.
[[nodiscard]] Eigen::MatrixXd covariance_from(std::vector<Parameter>& parameters,
                                              const Eigen::MatrixXd& information);

}  // namespace rigor::calibration

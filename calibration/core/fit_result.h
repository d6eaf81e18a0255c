// What a fit says: parameters with their uncertainty, what was left out, what the data cannot tell, and which
// models were compared. Plain data: written as JSON and YAML by fit_output.h, shown by the command line.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace rigor::calibration {

/// One number of a model.
struct Parameter {
  std::string name;  ///< with its unit: `fx_px`, `beam_bias_m[3]`
  double value = 0;
  double sigma = 0;  ///< standard uncertainty; infinite where the data says nothing, 0 where it was held
  /// Beyond this standard uncertainty the parameter is of no use: what "the data cannot tell" is judged by.
  double resolution = 0;
  bool held = false;      ///< not fitted: the value was given
  bool at_bound = false;  ///< the fit ended where the model ends; sigma then means little
  /// How far apart fits to two halves of the data put it; NaN: not computed. Where that is far more than
  /// sigma says, the parameter is in FitResult::not_identifiable.
  double halves_apart = std::numeric_limits<double>::quiet_NaN();
};

/// A combination of parameters along which the data leave the model free.
struct WeakDirection {
  struct Part {
    std::string name;
    double weight;  ///< of the parameter in units of its resolution; the largest is ±1
  };
  std::vector<Part> parts;  ///< those that matter, the largest first
  double sigma = 0;         ///< along the direction in units of the resolutions; infinite: exactly free
  std::string words;        ///< for people: which parameters the data cannot tell apart
  std::string cure;         ///< which further recording would; may be empty
};

/// An observation that was not used for the values.
struct Rejected {
  std::string what;     ///< `left03.jpg corner (4, 1)`
  double residual = 0;  ///< in the fit's unit
  double sigmas = 0;    ///< the same in standard deviations of those that were used
};

/// A model that was tried.
struct Candidate {
  std::string name;
  int parameters = 0;
  double rms = 0;               ///< of the residuals it was fitted to
  double bic = 0;               ///< smaller is better
  double cross_validation = 0;  ///< error on what it was not fitted to; NaN: not computed
  double cross_validation_sigma = 0;
  bool chosen = false;
  std::string note{};
  /// Mean squared error of each part that was withheld (a view, a sector), the same parts in the same order
  /// for all candidates, and how much each part counts (empty: all alike). Compared in pairs by
  /// choose_model().
  std::vector<double> withheld{}, withheld_weights{};
};

struct ResidualStatistics {
  std::string unit;
  std::size_t count = 0;     ///< scalar residuals that were used
  std::size_t rejected = 0;  ///< observations that were not
  double rms = 0, median_absolute = 0, p95_absolute = 0, largest = 0;
};

struct FitResult {
  std::string model;  ///< of the candidates the one that was chosen
  std::vector<Parameter> parameters;
  Eigen::MatrixXd covariance;  ///< of all parameters in their order; zero rows for those held
  double scale = 1;            ///< s: residual standard deviation that the covariance was scaled by
  ResidualStatistics residuals;
  std::vector<Rejected> rejected;
  std::vector<WeakDirection> weak;
  std::vector<Candidate> candidates;
  std::vector<std::string> warnings;
  /// What could not be determined, and why: not reported as a number, or with this reason beside it.
  std::vector<std::pair<std::string, std::string>> not_identifiable;
  /// Over which inputs the model was fitted: name, smallest, largest (`range_m` 0.5 … 7.2).
  struct Span {
    std::string name;
    double from = 0, to = 0;
  };
  std::vector<Span> validity;
  bool interrupted = false;  ///< stopped early: the best so far

  [[nodiscard]] const Parameter* find(std::string_view name) const;
  [[nodiscard]] bool identifiable(std::string_view name) const;
  /// −1: there is none.
  [[nodiscard]] int index_of(std::string_view name) const;
};

/// Of residuals in one unit; reorders `residuals`.
[[nodiscard]] ResidualStatistics statistics_of(std::vector<double>& residuals, std::string unit);

}  // namespace rigor::calibration

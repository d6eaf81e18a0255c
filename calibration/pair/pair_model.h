// What has to change in a simulated side's model so that it describes its device, from a recording of both.
//
//   before   r = real − simulated                       of the recorded samples
//   pass     the simulated samples are carried over to the model found so far (pictures resampled through
//            the new lens and mount, points moved along their surfaces), and one Gauss-Newton step follows
//   after    r of the last pass: steps are small against their sigma
//
// One step alone, which is what a watch of pairs takes, is off by some per cent where pictures shift by a
// good part of what is seen in them; `one_step` keeps it for comparison.
//
// What carrying over cannot do is shown by running the rig again with the proposal: what is hidden to the
// simulated side's old place stays hidden, and a scene's parallax with it.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "sensor-hal/types/sample.h"

namespace rigor::calibration {

using TakePair = std::function<void(const Sample& real, const Sample& simulated)>;
/// Gives every pair of the recording in order, and the same ones at each call.
using ForEachPair = std::function<Status(const TakePair&)>;

struct PairOptions {
  int most_passes = 12;
  StopToken stop{};  ///< asked between passes; the best so far is then given, marked
  std::function<void(int pass)> progress{};
};

/// Every n-th number of a stream whose length nobody knows, at most 2^15 of them: for plots and quantiles.
class ResidualSample {
 public:
  void add(double x) {
    squares_ += x * x, sum_ += x, ++seen_;
    if ((seen_ - 1) % every_ != 0) return;
    values_.push_back(x);
    if (values_.size() < (std::size_t{1} << 15)) return;
    for (std::size_t i = 0; 2 * i < values_.size(); ++i) values_[i] = values_[2 * i];
    values_.resize(values_.size() / 2), every_ *= 2;
  }
  [[nodiscard]] const std::vector<double>& values() const { return values_; }
  [[nodiscard]] std::uint64_t count() const { return seen_; }
  [[nodiscard]] double mean() const { return seen_ > 0 ? sum_ / double(seen_) : 0; }
  [[nodiscard]] double rms() const;

 private:
  std::vector<double> values_;
  std::uint64_t every_ = 1, seen_ = 0;
  double squares_ = 0, sum_ = 0;
};

/// Noise of both sides at one level of light, remission or amplitude; variances in the residuals' unit,
/// squared.
struct NoiseLevel {
  double level = 0;                  ///< mean, of the simulated side
  double real = 0, simulated = 0;    ///< variance
  double difference = 0, sigma = 0;  ///< real − simulated, and its standard uncertainty
  std::uint64_t count = 0;
};

struct PairFit {
  /// Of the device against the simulated side's sensor model; not_identifiable, warnings, weak directions;
  /// residuals after.
  FitResult change;
  std::vector<double> one_step;  ///< by parameter: the first pass alone
  int passes = 0;
  bool converged = false;
  std::uint64_t pairs = 0, unlike = 0;
  ResidualSample before, after;
  std::vector<NoiseLevel> noise;  ///< levels with enough of it
};

/// Sums of one level while samples come in. Differences of elements that share nothing.
class NoiseByLevel {
 public:
  explicit NoiseByLevel(std::size_t levels) : sums_(levels) {}
  /// Squares that each are an estimate of the variance.
  void add(std::size_t level, double at, double real_squares, double simulated_squares) {
    Sums& s = sums_[level];
    const double d = real_squares - simulated_squares;
    s.at += at, s.real += real_squares, s.simulated += simulated_squares, s.difference += d,
        s.squares += d * d, ++s.count;
  }
  [[nodiscard]] std::vector<NoiseLevel> levels(std::uint64_t least = 200) const;

 private:
  struct Sums {
    double at = 0, real = 0, simulated = 0, difference = 0, squares = 0;
    std::uint64_t count = 0;
  };
  std::vector<Sums> sums_;
};

/// Fills value, sigma, covariance, not_identifiable (with `why` by parameter) from a solution.
void keep_solution(PairFit& fit, std::vector<Parameter> parameters, const Eigen::VectorXd& value,
                   const Eigen::MatrixXd& covariance, const std::vector<bool>& held,
                   const std::vector<std::string>& why);

}  // namespace rigor::calibration

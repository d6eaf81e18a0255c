// How far a simulated side is from its real channel: bias, spread, and the noise of each from sample to
// sample.
//
// Noise is judged without knowing the truth: of an element (pixel, beam) that sees the same in two
// consecutive samples the difference has √2 of the noise's standard deviation. What moved between the two
// shows as differences that are far beyond the others'; the spread is therefore taken from the quantiles that
// hold the middle half.
//
// Samples of one scene hang together (a fixed pattern, a slow drift), so standard uncertainties come from the
// scatter of the means of up to 20 stretches of time (batch means); a pattern that stays for the whole
// recording does not show in them.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace rigor::calibration {

/// One element of a sample: which one, and what it measured. NaN: nothing (no return).
struct TwinElement {
  std::uint64_t key = 0;
  double value = 0;
};

struct TwinDifference {
  std::uint64_t samples = 0;   ///< pairs of one instant
  std::uint64_t elements = 0;  ///< that both measured
  std::uint64_t only_real = 0, only_simulated = 0;
  double bias = 0, rms = 0;  ///< simulated less real
  double q05 = 0, q25 = 0, median = 0, q75 = 0, q95 = 0;
  double real_noise = 0, simulated_noise = 0;  ///< standard deviations; NaN: fewer than two samples
  /// Of bias, real noise, simulated noise and simulated over real noise, in this order: covariance of their
  /// estimates; infinite variances where fewer than eight samples say nothing of it.
  Eigen::Matrix4d covariance = Eigen::Matrix4d::Zero();
  /// Largest distance between the two noises' cumulative distributions, each in units of the real one's
  /// standard deviation (Kolmogorov–Smirnov); 0 alike, 1 nothing in common.
  double noise_distance = 0;
  /// For plots: at most 4096 each, evenly taken, sorted.
  std::vector<double> differences, real_noise_sorted, simulated_noise_sorted;
};

class TwinComparer {
 public:
  /// `step`: values are whole multiples of it (grey values: 1); 0: they are continuous.
  explicit TwinComparer(double step = 0) : step_(step) {}
  /// Two samples of one instant; keys need no order and are unique within a sample.
  void add(std::span<const TwinElement> real, std::span<const TwinElement> simulated);
  [[nodiscard]] TwinDifference result() const;

 private:
  /// Every n-th number of a stream whose length nobody knows, at most 2^17 of them.
  class Thinned {
   public:
    void add(double x);
    [[nodiscard]] const std::vector<double>& values() const { return values_; }

   private:
    std::vector<double> values_;
    std::uint64_t every_ = 1, seen_ = 0;
  };
  using Values = std::vector<TwinElement>;  ///< by key; without those that measured nothing
  static Values sorted_values(std::span<const TwinElement> sample);
  /// Adds what changed and returns its spread.
  double noise(const Values& before, const Values& now, Thinned& into) const;

  std::uint64_t samples_ = 0, elements_ = 0, only_real_ = 0, only_simulated_ = 0;
  double sum_ = 0, squares_ = 0;
  Thinned differences_, real_noise_, simulated_noise_;
  Values real_, simulated_;  ///< of the last sample
  double step_;
  /// Of each sample: mean difference, spreads against the sample before (NaN: the first).
  std::vector<std::array<double, 3>> each_;
};

}  // namespace rigor::calibration

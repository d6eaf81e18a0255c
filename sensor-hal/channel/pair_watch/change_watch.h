// When a pair's difference is no longer what it was, and which parameter explains that best.
//
//   windows    0 … N−1: learn            N …: watch                          alarm      acknowledge
//   δ̂_k        mean μ, covariance S ──▶  z = (δ̂ − μ)/s ──▶ CUSUM of each ──▶ latched ──▶ watch again
//
// A simulated side is never perfect: what the first N windows show is taken for its normal state, and alarms
// are for changes against that. Run them when the simulated side is known to be good.
//
// False alarms: the stated rate (of all parameters together) is shared equally by the parameters and turned
// into a mean run length of each two-sided CUSUM (cusum.h). μ and s come from N windows only and windows may
// hang together, both of which would raise that rate unseen. Therefore
//   s   the standard deviation of windows, or the one that batch means show for sums of many of them,
//       sqrt(b · var(means of b)), where that is larger; b doubles until neighbouring means no longer
//       correlate visibly. Of either the upper confidence limit by chi-squared.
//   k   the reference value, or half of the parameter's least change in units of s, plus the confidence limit
//       of the error of μ.
// With probability `confidence` over all parameters the rate is then at most the stated one, for windows that
// are normal and go on as in the baseline. What this costs is sensitivity; more windows in the baseline bring
// it back. Correlation that lasts for a large part of the baseline is not seen through: `unsettled`.
//
// A window that is less certain than those of the baseline (a dark picture) counts less, by the ratio of its
// own sigma; one that says nothing of a parameter is passed over.
//
// Explanation: of the mean change Δ since the alarm began, over n windows, the log likelihood ratio of "only
// j has changed" is n (dᵀS⁻¹Δ)² / (2 dᵀS⁻¹d), with the estimate dᵀS⁻¹Δ / dᵀS⁻¹d; d is the unit vector of j,
// or what Parameter::common makes of it. S is the covariance between windows, its correlations shrunk by (P +
// 1)/(P + 1 + N).
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/pair_watch/cusum.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"

namespace rigor::pair_watch {

struct WatchOptions {
  double window_s = 10;
  std::uint32_t baseline_windows = 200;  ///< at least 16
  double false_alarms_per_h = 1e-3;      ///< of all parameters together
  double reference = 0.5;    ///< k in standard deviations: the best for changes of twice that per window
  double confidence = 0.99;  ///< that the rate is not exceeded, see above
};

enum class WatchState : std::uint8_t { learning, watching, alarm };

/// Plain data. Parameters are numbers in the list that the watch was made with.
struct Alarm {
  std::uint32_t trigger = 0;     ///< whose sum reached its threshold
  std::uint32_t parameter = 0;   ///< that explains the change best
  std::uint32_t runner_up = 0;   ///< equal to `parameter` where there is no other
  double change = 0, sigma = 0;  ///< of `parameter`, against the baseline, in its unit
  double log_ratio = 0;          ///< of `parameter`, against no change
  double runner_up_change = 0, runner_up_log_ratio = 0;
  std::uint64_t window = 0;  ///< in which it was raised, counted from the first of the baseline
  std::uint64_t since = 0;   ///< estimate of the first window with the change
};

/// What is known of a parameter.
struct ParameterState {
  bool watched = false;    ///< false: fewer than half of the baseline's windows determined it
  bool unsettled = false;  ///< the baseline is too short for how its windows hang together
  double mean = 0;         ///< μ
  double sigma = 0;        ///< s
  double level = 0;        ///< of its sum; 1 is the alarm
  double highest = 0;      ///< level since the baseline
  double k = 0, h = 0;
  std::uint64_t undetermined = 0;  ///< windows that said nothing of it
};

class ChangeWatch {
 public:
  /// Setup; allocates all there will be. bad_input: options out of bounds, no parameter or too many.
  [[nodiscard]] static Result<ChangeWatch> make(std::vector<Parameter> parameters,
                                                const WatchOptions& options);

  // One thread at a time; no allocation.
  void add(const Estimate& window) noexcept;
  /// The alarm is over; sums start at 0. Where the change persists there will be another.
  void acknowledge() noexcept;
  /// What is now is taken as normal: learns again.
  void learn_again() noexcept;

  [[nodiscard]] WatchState state() const noexcept { return state_; }
  /// Of the last alarm; means nothing before there was one.
  [[nodiscard]] const Alarm& alarm() const noexcept { return alarm_; }
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return parameters_; }
  [[nodiscard]] ParameterState parameter_state(std::size_t i) const noexcept;
  [[nodiscard]] std::uint64_t windows() const noexcept { return window_; }
  /// Windows of the baseline that are there.
  [[nodiscard]] std::uint64_t learned() const noexcept {
    return state_ == WatchState::learning ? window_ - first_ : options_.baseline_windows;
  }
  /// Mean windows between false alarms of one parameter that its threshold is made for.
  [[nodiscard]] double run_length() const noexcept { return run_length_; }

 private:
  ChangeWatch(std::vector<Parameter> parameters, const WatchOptions& options);
  struct Learned {
    bool watched = false, unsettled = false;
    double mean = 0, marginal = 0, sigma = 0, within = 0, highest = 0;
    std::uint64_t undetermined = 0;
    Cusum sum;
  };
  void learn() noexcept;
  void learn_one(std::size_t i) noexcept;
  void raise(std::size_t trigger) noexcept;
  [[nodiscard]] std::array<double, kMaxParameters> direction(std::size_t j) const noexcept;
  [[nodiscard]] const Estimate& at(std::uint64_t window) const noexcept {
    return ring_[window % ring_.size()];
  }

  std::vector<Parameter> parameters_;
  WatchOptions options_;
  double run_length_ = 0;
  WatchState state_ = WatchState::learning;
  std::uint64_t window_ = 0, first_ = 0;  ///< first: of the baseline
  std::vector<Estimate> ring_;            ///< of the newest windows; holds the baseline while learning
  std::vector<double> column_;            ///< scratch of one parameter's baseline
  std::vector<Learned> learned_;
  std::vector<double> inverse_;  ///< S⁻¹ in units of the marginal standard deviations
  Alarm alarm_;
};

}  // namespace rigor::pair_watch

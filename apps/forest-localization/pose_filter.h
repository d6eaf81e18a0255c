// Where the base is: a Kalman filter over six numbers, with robust, iterated updates by stems of a map that
// is itself not exact.
//
//   state   x, y [m], yaw [rad]; s way per way told by the odometry; k turn per turn told; b bias of the gyro
//   predict odometry's way and turn; where there is a gyro, its turn, and odometry's then measures b and k
//   update  by all stems of a scan at once: Gauss–Newton for the place to linearise at and for Huber's
//   weights
//           on each stem's Mahalanobis distance, then a Schmidt–Kalman step in the right-invariant error (A.
//           Barrau, S. Bonnabel, IEEE T-AC 2017), which before one stem for an hour learns no heading
//
// Why a filter and not a sliding window: between scans odometry is good to centimetres and a degree, so one
// iteration nearly suffices and a window would relinearise what is linear; its cost is fixed; and the one
// error that lasts over many scans and would make either too sure, that of the map, is handled as what it is:
// each stem's place has an error of `map_sigma_m` that is drawn once. The filter keeps the covariance of its
// state with each stem's error and never estimates that error (S. F. Schmidt, 1966): standing still before
// the same five trees for an hour does not make it surer than the map is.
//
// s and k are first-order Gauss–Markov along the way, b in time: they stay as uncertain as configured where
// nothing is observed (k without turning, s without moving).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "apps/forest-localization/statistics.h"
#include "apps/forest-localization/stem_matcher.h"

namespace rigor::forest {

struct PoseFilterConfig {
  double along_per_sqrt_m = 0.03;    ///< of the way, after s
  double across_per_sqrt_m = 0.02;   ///< sideslip
  double across_per_rad = 0.03;      ///< m for a turn of 1 rad: the centre of turning is not the middle
  double yaw_rad_per_sqrt_m = 0.01;  ///< of the odometry's turn
  double yaw_per_sqrt_rad = 0.05;    ///< rad for the root of a turn told
  double way_scale_sigma = 0.03, turn_scale_sigma = 0.1, scale_length_m = 30;
  double gyro_noise_rad_per_sqrt_s = 2e-4;
  double gyro_bias_sigma_radps = 0.02, gyro_bias_time_s = 300;
  double map_sigma_m = 0.03, map_radius_sigma_m = 0.02;
  double huber = 2.8;  ///< Mahalanobis distance of 3 numbers (0.95 of them below) from which weights fall
};

/// A stretch of the way, as sensors tell it.
struct MotionIncrement {
  double dt_s = 0;
  double way_m = 0, turn_rad = 0;                         ///< odometry's
  std::optional<double> gyro_turn_rad;                    ///< integral of the measured rate
  double extra_way_sigma_m = 0, extra_yaw_sigma_rad = 0;  ///< odometry is missing: guessed
};

struct UpdateReport {
  std::uint32_t matches = 0, down_weighted = 0;
  double chi_squared = 0;  ///< of all innovations before the update; 3 degrees each
};

class PoseFilter {
 public:
  enum Index { kX, kY, kYaw, kWayScale, kTurnScale, kGyroBias, kSize };
  using State = Eigen::Matrix<double, kSize, 1>;
  using Covariance = Eigen::Matrix<double, kSize, kSize>;

  /// Setup context: memory for the covariances with `map_stems` stems.
  PoseFilter(const PoseFilterConfig& config, std::size_t map_stems);

  // Loop thread; no allocation.
  /// Forgets the pose, and what is known of stems; keeps scales and bias.
  void reset(const PoseGaussian& pose) noexcept;
  void predict(const MotionIncrement& motion) noexcept;
  UpdateReport update(std::span<const StemObservation> stems, std::span<const StemMatch> matches,
                      const StemMap& map) noexcept;
  /// More uncertain than it believed, by a Gaussian: wheels slipped.
  void loosen(double position_sigma_m, double yaw_sigma_rad) noexcept;

  /// How a state and its covariance move on, without a filter: for looking ahead of the last scan. `F`: the
  /// derivative of the state by that before.
  static void propagate(const PoseFilterConfig& config, const MotionIncrement& motion, State& x,
                        Covariance& P, Covariance& F) noexcept;

  [[nodiscard]] const PoseFilterConfig& config() const noexcept { return c_; }
  [[nodiscard]] const State& state() const noexcept { return x_; }
  [[nodiscard]] const Covariance& covariance() const noexcept { return P_; }
  [[nodiscard]] PoseGaussian pose() const noexcept { return {x_.head<3>(), P_.topLeftCorner<3, 3>()}; }

 private:
  using Cross = Eigen::Matrix<double, kSize, 2>;
  void odometry_against_gyro(double turn_rad, double gyro_turn_rad, double way_m, double dt_s) noexcept;
  void settle() noexcept;

  PoseFilterConfig c_;
  State x_;
  Covariance P_;
  std::vector<Cross> cross_;           ///< state with the error of each stem in the map
  std::vector<std::uint32_t> active_;  ///< stems whose cross covariance is not zero
  std::vector<std::uint8_t> is_active_;
  std::size_t active_count_ = 0;
};

}  // namespace rigor::forest

// A LiDAR pair: what has to change in the simulated side's ranges, beams and mount, so that it measures what
// the device does.
//
// The simulated side's points are pieces of surface: point and normal. A firing of the device, mounted with
// T_simulated_real = (R, t), meets the piece that lies in its direction at
//
//   ρ′ = n·(p − t)/(n·R d),   and measures   (1 + s) ρ′ + b + b_beam
//
// which is solved for b, s, R, t by point-to-plane Gauss-Newton steps, pieces looked up anew in each pass.
// Normals and ranges of the pieces are noisy, and their noise would make estimates of a mount's turn and of
// the range scale too small; normals of the device's own points and the ranges beside them serve as
// instruments against that (clustered_fit.h). Surfaces of the device are taken from its points less the
// biases of beams found so far: with a bias in them, points would be chosen by their noise. A beam that is
// far off starts from the median of its own residuals. Points and normals come from pair_watch's CloudChange.
// Huber's weights limit edges, leaves, people.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "calibration/pair/pair_model.h"

namespace rigor::calibration {

struct CloudPairOptions : PairOptions {
  std::uint32_t rings = 1;
  std::size_t points = 100000;  ///< at most, in a cloud
  double sigma_m = 0.02;        ///< of one range, roughly
  double remission_max = 0;     ///< brighter ones are not compared (saturation); 0: all
  bool mount = true;
  /// Of the sensor model, of a return with this remission (device's unit) and range; null: sigma_m.
  std::function<double(double remission, double range_m)> model_sigma_m{};
};

struct CloudPairFit : PairFit {
  double bias_m = 0, scale = 0;  ///< of the device over the simulated side: (1 + scale) ρ + bias
  Eigen::Matrix3d R_simulated_real = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t_simulated_real_m = Eigen::Vector3d::Zero();
  std::vector<double> beam_m;  ///< of groups of rings, sum 0; empty: nothing to be said of single beams
  std::vector<std::uint32_t> beam_of_ring;
  double lost = 0, gained = 0;  ///< shares of firings that the simulated side alone, the device alone answers
};

/// bad_input: no pairs, clouds that cannot be compared.
[[nodiscard]] Result<CloudPairFit> fit_cloud_pair(const ForEachPair& pairs, const CloudPairOptions& options);

/// By which factor the device's noise differs from the sensor model's, from levels whose `level` is the
/// sensor model's variance: weighted mean of (level + difference)/level. `chi2` over their number less 1:
/// whether one factor is enough.
struct NoiseFactor {
  double factor = 1, sigma = 0, chi2 = 0;  ///< of the standard deviation
  int levels = 0;
};
[[nodiscard]] NoiseFactor noise_factor(const std::vector<NoiseLevel>& levels);

}  // namespace rigor::calibration

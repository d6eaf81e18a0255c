// Response of a sensor that is not quite linear, in the simulator's model
// (sensor-hal/models/emva_noise.glsl.h): y = x (1 + c2 s + c3 s²) in DN above black, s = x over the
// converter's range above black, x = K n. Seen in the signal over exposure times of a steady light.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace rigor::calibration {

struct PhotonResponse {
  int terms = 0;  ///< 0: linear, 1: c2, 2: c2 and c3
  double full_scale_dn = 1;
  Eigen::Vector2d c = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  [[nodiscard]] double value(double x_dn) const;
  [[nodiscard]] double slope(double x_dn) const;
  /// x of y; the response rises, so there is one.
  [[nodiscard]] double inverse(double y_dn) const;
  /// Rises over the whole range, within what a sensor model may say.
  [[nodiscard]] bool rising() const;
};

/// Mean signal of a level above black.
struct ResponsePoint {
  double exposure_s = 0, signal_dn = 0, sigma_dn = 0;
  int colour = 0;  ///< each has a light of its own
};

struct ResponseFit {
  PhotonResponse response;
  double chi2 = 0;
  int parameters = 0;  ///< the lights included
  bool valid = false;
};

/// Least squares with `flicker` (relative, of the light from level to level) added to each level's sigma.
[[nodiscard]] ResponseFit fit_response(const std::vector<ResponsePoint>& points, int terms,
                                       double full_scale_dn, double flicker);
/// χ² of a response whose slope changes to `ratio` of it at `break_dn`; the lights alone are fitted.
[[nodiscard]] double broken_response_chi2(const std::vector<ResponsePoint>& points, double break_dn,
                                          double ratio, double flicker);
/// The flicker that makes χ² what its degrees of freedom expect; 0 where it is below that without any.
[[nodiscard]] double flicker_of(const std::vector<ResponsePoint>& points, int terms, double full_scale_dn);

}  // namespace rigor::calibration

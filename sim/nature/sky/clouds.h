// A layer of cumulus that is drawn by arithmetic: optical depth as a function of place and cover.
#pragma once

#include <Eigen/Core>

namespace rigor::nature {

inline constexpr double kCloudBase_m = 1600;  ///< above the eye

/// Vertical optical depth (550 nm) of the layer over a point of the plane, x east, y north, of the cloud
/// field that covers the share `cover` of the sky. `footprint_m`: structure that is smaller is averaged away.
/// The same at every run. Any thread.
class CloudField {
 public:
  explicit CloudField(double cover);
  [[nodiscard]] double optical_depth(const Eigen::Vector2d& p_m, double footprint_m = 0) const;
  [[nodiscard]] double cover() const noexcept { return cover_; }

 private:
  double cover_ = 0, threshold_ = 1;
};

/// Share of the light on top of a layer that comes out at its base, diffusely (two streams, droplets with
/// asymmetry 0.85: Bohren 1987).
[[nodiscard]] double cloud_transmittance(double optical_depth);

}  // namespace rigor::nature

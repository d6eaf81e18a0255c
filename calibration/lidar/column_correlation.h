// How far columns of cells along a wall err alike, from residuals of a fit. Internal to calibration/lidar.
#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace rigor::calibration::lidar {

/// All beams' cells of a wall at one azimuth, together.
struct ColumnResidual {
  int plane = 0;
  std::int32_t cell = 0;  ///< of azimuth
  double z = 0;           ///< standardised residual
  /// What it changes by with the plane's numbers and with a bias that all beams share.
  std::array<double, 3> d_plane{};
  double d_bias = 0;
};

/// Errors of columns along a wall as a stationary process: their correlation at a distance of d cells is
/// rho^d cos(omega d), boards and ribs at intervals included.
struct ColumnProcess {
  double rho = 0, omega_rad = 0;
  double kept = 1;        ///< share of the errors' variance that a fit leaves in residuals
  double neighbours = 0;  ///< correlation of neighbouring columns' residuals, as it is
  [[nodiscard]] double at(int distance) const;
};

/// The process whose residuals, after a fit of `per_plane` numbers of each plane (0: held) and of the shared
/// bias, are expected to be correlated as these are. A fit takes from residuals what its unknowns can follow:
/// their own variance and correlation are smaller than those of the errors, the more the shorter a wall is
/// beside what errs alike (Kendall, Biometrika 41, 1954). `columns` in the order of plane and cell.
[[nodiscard]] ColumnProcess column_process(std::span<const ColumnResidual> columns, int per_plane);

}  // namespace rigor::calibration::lidar

// Biases, angles and gains of the beams of a LiDAR, noise against remission, and detection.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct LidarCalibrationOptions : CalibrationInputs {
  /// Surveyed walls in the sensor's frame (x forward, y left, z up), YAML: `walls: [{ name: east, normal:
  /// [1, 0, 0], distance_m: 4.2, reflectance: 0.8 }]`; empty: walls are found.
  std::filesystem::path targets;
  std::string noise_model = "auto";  ///< constant, photon, photon+floor, power, offset, offset+floor, full
};

/// `inputs`: recordings (.mcap), packets of a Velodyne (.pcap), telegrams of a SICK scanner (.json). `base`
/// is needed: its beams are where the fit begins. Parameters in metres and radians. Details: `walls`,
/// `noise_bands`, errors on withheld returns, quantiles beside those of the simulated twin. Errors:
/// not_found, bad_input (no base, no walls in the recording, too few returns), protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_lidar(const LidarCalibrationOptions& options,
                                                        const StopToken& stop = {});

}  // namespace rigor

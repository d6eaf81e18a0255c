// Where a LiDAR or a time-of-flight camera is in the frame of a camera, from boards that both saw.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct ExtrinsicsCalibrationOptions : CalibrationInputs {
  std::string camera, second;               ///< channels; empty: the only one of its kind
  std::filesystem::path camera_model_file;  ///< sensor model of the camera
  std::filesystem::path
      second_model_file;  ///< that of a time-of-flight camera; empty: the second one is a LiDAR
  std::string target;     ///< as in CameraCalibrationOptions
  /// `x,y,z[,roll,pitch,yaw]`, metres and degrees: the second sensor in the camera's optical frame (x right,
  /// y down, z forward), turned against looking the same way.
  std::string rough;
  double margin_m = 0.15;  ///< how far `rough` may be off at the board
  double sigma_m = 0;      ///< noise of the second sensor's ranges; 0: from the data
  double still_m = 0.004;  ///< by how much a board may move between pictures
  int views = 60;          ///< at most so many are used
};

/// `inputs`: recordings (.mcap) with both sensors. The frames are the optical frame of the camera and the
/// frame of the second sensor. Details: `position_m`, `quaternion_wxyz`, `views`, `sigma_point_m`. Errors:
/// not_found, bad_input (no board, no points on it within `margin_m` of where `rough` puts them), protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_extrinsics(const ExtrinsicsCalibrationOptions& options,
                                                             const StopToken& stop = {});

}  // namespace rigor

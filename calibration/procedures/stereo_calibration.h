// Where the right of two cameras is in the frame of the left one, and both cameras with it.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct StereoCalibrationOptions : CalibrationInputs {
  /// Of the right camera, in the order of those of the left one, which are `inputs`; empty: one recording has
  /// both, and `channel` and `right_channel` name them.
  std::vector<std::filesystem::path> right;
  std::string right_channel;
  std::string target;  ///< as in CameraCalibrationOptions
  std::string size;    ///< WIDTHxHEIGHT of the pictures that a list of corners is about
  /// Sensor models whose intrinsics are held; empty: they are fitted.
  std::filesystem::path left_model_file, right_model_file;
  double within_ms = 1;  ///< views of recordings that belong together are no further apart
  /// Folder that gets looked_for.png where no picture has a board; empty: nothing is written.
  std::filesystem::path looked_for_folder;
};

/// Fits T_left_right (metres; optical frames: x right, y down, z forward). `parts` are the cameras whose
/// intrinsics were fitted: `left`, `right`. Details: `rms_per_corner_px`, `pairs`, `baseline_m`,
/// `T_left_right`. Errors as calibrate_camera(); bad_input where fewer than two instants have the whole board
/// on both sides.
[[nodiscard]] Result<CalibrationResult> calibrate_stereo(const StereoCalibrationOptions& options,
                                                         const StopToken& stop = {});

}  // namespace rigor

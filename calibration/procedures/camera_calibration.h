// Intrinsics and lens of a camera from pictures of a board.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct CameraCalibrationOptions : CalibrationInputs {
  /// `chessboard:9x6:0.025` (inner corners; square in metres), `circles:…`, `asymmetric:…`,
  /// `charuco:8x6:0.04:0.03[:DICTIONARY]`.
  std::string target;
  std::string size;              ///< WIDTHxHEIGHT of the pictures that a list of corners is about
  double start_fx_px = 0;        ///< focal length to begin with; 0: none is known
  bool all_corners = false;      ///< no outlier is left out
  bool rolling_shutter = false;  ///< fits the line time too; needs times: a recording, or `rate_hz`
  bool chromatic = false;  ///< fits the magnification of red and blue too; colour pictures of a chessboard
  bool twin = false;       ///< draws the views with the fitted camera and fits them, to compare the residuals
  double rate_hz = 0;      ///< of pictures in files, in the order of their names; 0: not known
  double longest_gap_ms = 200;  ///< views further apart do not say how the board moved between them
  /// Folder that gets looked_for.png where no picture has a board; empty: nothing is written.
  std::filesystem::path looked_for_folder;
};

/// `inputs`: pictures, folders of them, recordings (.mcap), lists of corners (.vnl). `model`: a lens model by
/// its name. Parameters are those of CameraModel, lengths in pixels; the sensor model is a camera's. Details:
/// `rms_per_corner_px`, `views` with their names, corners and RMS. Errors: not_found, bad_input (no board in
/// any picture, pictures of several sizes, too few views), protocol (a damaged recording).
[[nodiscard]] Result<CalibrationResult> calibrate_camera(const CameraCalibrationOptions& options,
                                                         const StopToken& stop = {});

}  // namespace rigor

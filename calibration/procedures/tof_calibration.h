// Wiggling, offsets, noise, saturation, drift and lens of a time-of-flight camera.
#pragma once

#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct TofCalibrationOptions : CalibrationInputs {
  std::vector<std::string> raw;  ///< `depth:FILE:WIDTHxHEIGHT[,amplitude:FILE]`, 16 bit, millimetres
  std::vector<std::filesystem::path> board;  ///< recordings of a board for the lens; with `target`
  std::string target;                        ///< as in CameraCalibrationOptions
  /// Metres along the axis to the plane that fills the picture, one for each recording, with commas between;
  /// or a CSV file of lines `recording,distance`. Empty: not known.
  std::string distances;
  std::string unit = "mm";       ///< of a series of readings: `mm`, `m`
  std::string amplitude_unit;    ///< `electrons`, `counts`; empty: counts of raw pictures, else electrons
  std::string noise = "auto";    ///< `temporal` (frames of a scene at rest), `spatial` (windows of a picture)
  double distance_sigma_m = -1;  ///< standard uncertainty of one distance; below 0: from the scenes
  double period_s = 0;           ///< between readings or frames; 0: from their times
  int window_px = 7;             ///< of the spatial estimate, odd
};

/// `inputs`: recordings with range images (.mcap), each of one scene at rest, or one series of readings
/// (.csv); may be empty where `raw` or `board` is given. `model`: names of a range model, a noise law and a
/// drift model with commas between. `base` is needed for `distances` and `board`. Ranges are along the ray,
/// in metres. Errors: not_found, bad_input (also what does not go together), protocol.
[[nodiscard]] Result<CalibrationResult> calibrate_tof(const TofCalibrationOptions& options,
                                                      const StopToken& stop = {});

}  // namespace rigor

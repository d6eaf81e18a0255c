// Pictures for the calibration of a sensor: files, lists and recordings, each frame with its exposure.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "calibration/photon/frame_stacks.h"
#include "calibration/procedures/calibration_result.h"

namespace rigor {

struct PhotonInputOptions {
  std::vector<std::filesystem::path> dark;  ///< files, folders, recordings: all of it without light
  double temperature_c = std::numeric_limits<double>::quiet_NaN();  ///< of all frames that say none
  bool exposure_needed = true;  ///< off: a frame without one counts as 1 s
};

/// Numbers in the low bits, row by row.
struct PhotonPicture {
  calibration::PhotonFrame frame;
  std::vector<std::uint16_t> pixels;
  int width_px = 0, height_px = 0;
  int bits = 0;  ///< of the format; 0: not told (a file of 16 bits)
  bool mosaic = false;
};

struct PhotonInput {
  std::vector<std::filesystem::path> files;
  std::vector<std::string> warnings;
};

/// Reads pictures (PNG, TIFF, PGM …: exposure and `dark` from their names, as in `x_dark_100ms_3.tif`,
/// `flat_20us_35C.png`), lists (.csv with lines `file, exposure_ms, light|dark[, temperature_c[, gain_db]]`,
/// files relative to the list) and recordings. `take` may refuse a picture. bad_input: colour, no exposure.
[[nodiscard]] Result<PhotonInput> read_photon_pictures(
    const CalibrationInputs& options, const PhotonInputOptions& more,
    const std::function<Status(const PhotonPicture&)>& take);

}  // namespace rigor

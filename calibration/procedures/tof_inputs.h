// What `rigor calibrate tof` reads: recordings, raw pictures, series of readings.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calibration/tof/tof_frames.h"
#include "rt-core/result.h"

namespace rigor {

struct TofInputs {
  std::vector<calibration::TofFrame> frames;
  std::vector<std::size_t> scene_of;  ///< index of the recording of each frame
  std::vector<std::filesystem::path> files;
  std::vector<std::string> warnings;
};

/// Range images of MCAP recordings. `distances`: comma-separated metres, one for each recording in their
/// order, or a CSV file of lines `recording,distance_m`; empty: not known.
[[nodiscard]] Status add_recordings(const std::vector<std::filesystem::path>& files,
                                    const std::string& channel, const std::string& distances, TofInputs& out);

/// `depth:FILE:640x576,amplitude:FILE`: unsigned 16-bit little-endian, depth (or `range:`) in millimetres.
[[nodiscard]] Status add_raw(const std::string& text, TofInputs& out, bool& is_depth);

struct TofSeries {
  std::vector<double> range_m;
  double period_s = 0;
  std::vector<std::string> warnings;
};

/// A CSV file: one column of readings, or two, of time in seconds and reading; lines before the numbers may
/// say `Fs,50` (Hz). Readings are in `unit` (mm, m), unless their column's name ends in `_mm` or `_m`.
/// `period_s` > 0 overrides what the file says. Readings that are no number become NaN. bad_input with
/// file:line.
[[nodiscard]] Result<TofSeries> read_series(const std::filesystem::path& file, const std::string& unit,
                                            double period_s);

}  // namespace rigor

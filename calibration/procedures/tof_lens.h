// The lens of a time-of-flight camera from recordings of a board: its amplitudes are the pictures.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calibration/camera/camera_fit.h"
#include "calibration/core/figures.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor {

struct TofLensOptions {
  std::vector<std::filesystem::path> recordings;
  std::string channel, target;
  int width_px = 0, height_px = 0;  ///< of the base sensor model
  StopToken stop{};
};

struct TofLens {
  calibration::CameraFit fit;
  std::vector<std::string> view_names;
  std::vector<calibration::Figure> figures;
  std::vector<std::string> notes;
  std::size_t frames = 0, boards = 0;  ///< looked at; with a board
};

/// bad_input: no board in any frame, pictures of another size than the base's; else as read_samples() and
/// fit_camera().
[[nodiscard]] Result<TofLens> fit_tof_lens(const TofLensOptions& options);

}  // namespace rigor

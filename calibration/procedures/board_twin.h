// A calibrated camera's simulated twin before the same board: pictures drawn through the fitted lens from the
// fitted poses, found and fitted as the real ones were.
//
// What it shows: how much of the residuals comes from finding corners in pictures with this sharpness and
// noise. What is left over in the real ones is what the model does not hold: a board that is not flat or not
// printed true, a lens that does more, compression, motion.
#pragma once

#include "calibration/camera/camera_fit.h"
#include "calibration/core/figures.h"

namespace rigor {

struct BoardTwin {
  calibration::CameraFit fit;
  std::size_t views = 0;                            ///< in which the board was found again
  double black_dn = 0, white_dn = 0, noise_dn = 0;  ///< medians of the pictures; else what was assumed
  bool measured = false;
};

/// `views` are those of `fit`; names that are files of pictures give brightness and noise of the squares. For
/// chessboards and circles. bad_input where the board is found in fewer than two of the drawn pictures.
/// Allocates; seconds.
[[nodiscard]] Result<BoardTwin> simulate_board_twin(const calibration::CameraFit& fit,
                                                    const std::vector<calibration::BoardView>& views,
                                                    const calibration::Board& board, StopToken stop);
/// Residuals of both: histogram, and quantiles of the one against the other.
[[nodiscard]] std::vector<calibration::Figure> twin_figures(const calibration::CameraFit& real,
                                                            const BoardTwin& twin);

}  // namespace rigor

// The lens of a time-of-flight camera from its amplitudes: pictures of a calibration board in infrared light
// of its own, for fit_camera() (calibration/camera).
#pragma once

#include <cstdint>
#include <vector>

#include "calibration/camera/board.h"
#include "calibration/tof/tof_frames.h"
#include "rt-core/result.h"

namespace rigor::calibration {

/// Amplitudes as a grey picture of the same size: their square roots, from the darkest two hundredth (0) to
/// the brightest (255), so that a board far away, or at the dark edge of the light, keeps its steps. Empty
/// where there are no amplitudes, or all are the same.
[[nodiscard]] std::vector<std::uint8_t> amplitude_picture(const TofFrame& frame);

/// A board in the amplitudes. Small pictures are enlarged for the search; the points are in pixels of the
/// frame, centres at integers. not_found; bad_input where the frame has no amplitudes.
[[nodiscard]] Result<BoardView> find_board_in_amplitude(const TofFrame& frame, const Board& board);

/// Views one after the other in which the board stood still, its points moving by less than `still_px` (RMS),
/// become one view of their means: as many pictures of one place are one place.
[[nodiscard]] std::vector<BoardView> resting_views(const std::vector<BoardView>& views,
                                                   double still_px = 0.5);

}  // namespace rigor::calibration

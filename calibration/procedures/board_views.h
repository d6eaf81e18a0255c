// Views of a board out of whatever a user names: pictures, folders of pictures, lists of corners, recordings.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calibration/camera/board.h"
#include "calibration/camera/chromatic.h"
#include "rt-core/stop.h"

namespace rigor {

struct BoardViewsOptions {
  std::vector<std::filesystem::path> inputs;
  std::string channel;           ///< of recordings
  std::string size;              ///< WIDTHxHEIGHT of the pictures that a list of corners is about
  std::filesystem::path report;  ///< where what was looked for is drawn, if nothing was found; empty: nowhere
  bool colours = false;          ///< corners in red, green and blue; a grey picture is bad_input
  double rate_hz = 0;            ///< pictures of files were taken at this rate; 0: not known
  StopToken stop{};              ///< what was found until then is returned
};

struct BoardViews {
  std::vector<calibration::BoardView> seen;
  std::vector<calibration::ColourViews> colours;  ///< where they were asked for; `seen` is green
  std::vector<std::size_t> picture;  ///< of each view: which one it was of all that were looked at
  std::vector<std::string> notes;    ///< pictures without a board and why; recordings that were cut short
  std::vector<std::filesystem::path> files;
  bool interrupted = false;
};

/// bad_input: no board in any picture (report/looked_for.png then shows the board beside the first picture),
/// pictures of several sizes are left to the fit. Else as read_samples() and find_board().
[[nodiscard]] Result<BoardViews> read_board_views(const BoardViewsOptions& options,
                                                  const calibration::Board& board);

}  // namespace rigor

// Calibration boards and what was seen of them.
//
//   chessboard:9x6:0.025        9 x 6 inner corners, squares of 25 mm
//   circles:7x5:0.03            a grid of discs; asymmetric:4x11:0.02 the staggered one of OpenCV
//   charuco:8x6:0.04:0.03       8 x 6 squares of 40 mm with markers of 30 mm (4x4 dictionary of 50;
//   `:5x5_100` …)
//
// Board frame: x along the columns, y along the rows, z away from the camera that sees it upright; metres.
#pragma once

#include <array>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::calibration {

enum class BoardKind : std::uint8_t { chessboard, circles, asymmetric_circles, charuco };

struct Board {
  BoardKind kind = BoardKind::chessboard;
  int columns = 0, rows = 0;  ///< inner corners, discs; squares of a ChArUco board
  double spacing_m = 0;
  double marker_m = 0;                ///< ChArUco
  std::string dictionary = "4x4_50";  ///< ChArUco
  [[nodiscard]] std::string text() const;
  /// How many points a full view has.
  [[nodiscard]] std::size_t points() const;
};

/// As above. bad_input that says what was expected.
[[nodiscard]] Result<Board> parse_board(const std::string& text);

struct BoardPoint {
  int column = 0, row = 0;
  double x_m = 0, y_m = 0;    ///< on the board
  double u_px = 0, v_px = 0;  ///< in the picture, pixel centres at integers
};

struct BoardView {
  std::string name;  ///< file or recording and index
  int width_px = 0, height_px = 0;
  std::vector<BoardPoint> points;
  double t_s = std::numeric_limits<double>::quiet_NaN();  ///< of the centre row, where it is known
};

/// Points of a board in a grey 8-bit picture. The window of the sub-pixel search is chosen for each corner of
/// a chessboard: of those from 2 px to half the distance to its nearest neighbour (at most 11) the one whose
/// gradients promise the smallest uncertainty, so that edges which are none of the corner's own widen it no
/// further. not_found where there is no board in it: the message says what was looked for.
[[nodiscard]] Result<BoardView> find_board(const std::string& name, const std::uint8_t* grey, int width_px,
                                           int height_px, const Board& board);
/// The same points in the planes of a colour picture (8 bits, R G B interleaved): red, green, blue. For
/// chessboards: bad_input for another board.
[[nodiscard]] Result<std::array<BoardView, 3>> find_board_in_planes(const std::string& name,
                                                                    const std::uint8_t* rgb, int width_px,
                                                                    int height_px, const Board& board);
/// The planes of a colour image file. bad_input where it is grey.
[[nodiscard]] Result<std::array<BoardView, 3>> find_board_in_planes_of_file(const std::filesystem::path& file,
                                                                            const Board& board);
/// As above, of an image file (PNG, JPEG, TIFF …). Colour is made grey. bad_input for no image.
[[nodiscard]] Result<BoardView> find_board_in_file(const std::filesystem::path& file, const Board& board);

/// Corners that somebody else found: lines `image x y level`, in the board's order row by row, as mrcal and
/// mrgingham write them (.vnl); `-` is none. The pictures' size is the caller's knowledge.
[[nodiscard]] Result<std::vector<BoardView>> read_corner_list(const std::filesystem::path& file,
                                                              const Board& board, int width_px,
                                                              int height_px);

/// Reflectance of the printed board at a place on it, 0 black to 1 white: chessboards, discs (their radius a
/// quarter of the spacing); white around them. A ChArUco board is shown without the markers.
[[nodiscard]] double board_brightness(const Board& board, double x_m, double y_m);

}  // namespace rigor::calibration

#include "calibration/camera/board.h"

#include <charconv>
#include <cmath>
#include <fstream>
#include <map>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

namespace rigor::calibration {
namespace {

const std::map<std::string, int> kDictionaries{
    {"4x4_50", cv::aruco::DICT_4X4_50},   {"4x4_100", cv::aruco::DICT_4X4_100},
    {"4x4_250", cv::aruco::DICT_4X4_250}, {"5x5_50", cv::aruco::DICT_5X5_50},
    {"5x5_100", cv::aruco::DICT_5X5_100}, {"5x5_250", cv::aruco::DICT_5X5_250},
    {"6x6_50", cv::aruco::DICT_6X6_50},   {"6x6_250", cv::aruco::DICT_6X6_250}};

constexpr const char* kExpected =
    "expected chessboard:COLUMNSxROWS:SQUARE_M, circles:COLUMNSxROWS:SPACING_M, "
    "asymmetric:COLUMNSxROWS:SPACING_M or charuco:COLUMNSxROWS:SQUARE_M:MARKER_M[:DICTIONARY]";

std::vector<std::string> split(const std::string& text, char by) {
  std::vector<std::string> parts;
  std::stringstream in(text);
  for (std::string part; std::getline(in, part, by);) parts.push_back(part);
  return parts;
}
template <class T>
bool number(const std::string& text, T& out) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
  return error == std::errc{} && end == text.data() + text.size();
}

BoardPoint point_of(const Board& board, int column, int row, double u, double v) {
  double x = column * board.spacing_m, y = row * board.spacing_m;
  if (board.kind == BoardKind::asymmetric_circles) x = (2 * column + row % 2) * board.spacing_m;
  return {column, row, x, y, u, v};
}

/// Half the distance to the nearest neighbour: the window must not hold another corner.
int largest_window(const std::vector<cv::Point2f>& corners, std::size_t i) {
  double nearest = 1e9;
  for (std::size_t j = 0; j < corners.size(); ++j)
    if (j != i) nearest = std::min(nearest, cv::norm(corners[i] - corners[j]));
  return std::clamp(static_cast<int>(nearest / 2 - 1), 2, 11);
}

/// Uncertainty that a window promises. A corner is where the gradient g at every p is at right angles to the
/// way there, gᵀ(q − p) = 0 (Förstner 1987): of this least squares the residuals and the normal matrix.
double promised_sigma_px(const cv::Mat& image, const cv::Point2f& q, int w) {
  const int cx = cvRound(q.x), cy = cvRound(q.y);
  if (cx - w < 1 || cy - w < 1 || cx + w >= image.cols - 1 || cy + w >= image.rows - 1) return 1e9;
  double xx = 0, xy = 0, yy = 0, square = 0;
  int n = 0;
  for (int y = cy - w; y <= cy + w; ++y)
    for (int x = cx - w; x <= cx + w; ++x) {
      const auto at = [&](int i, int k) { return static_cast<double>(image.at<std::uint8_t>(i, k)); };
      const double gx = 0.5 * (at(y, x + 1) - at(y, x - 1)), gy = 0.5 * (at(y + 1, x) - at(y - 1, x));
      const double dx = x - static_cast<double>(q.x), dy = y - static_cast<double>(q.y);
      const double weight = std::exp(-(dx * dx + dy * dy) / (w * w));  // that of cv::cornerSubPix
      const double e = gx * dx + gy * dy;
      xx += weight * gx * gx, xy += weight * gx * gy, yy += weight * gy * gy;
      square += weight * e * e;
      ++n;
    }
  const double det = xx * yy - xy * xy;
  if (!(det > 1e-9 * (xx + yy) * (xx + yy))) return 1e9;
  return std::sqrt(square / (n - 2) * (xx + yy) / det);
}

/// Each corner by the window that promises most. A result that leaves its window is none: the start stays.
std::vector<cv::Point2f> refine_corners(const cv::Mat& image, const std::vector<cv::Point2f>& coarse) {
  std::vector<cv::Point2f> fine = coarse;
  for (std::size_t i = 0; i < coarse.size(); ++i) {
    const int largest = largest_window(coarse, i);
    double least = 1e9;
    for (int w = std::max(2, largest / 2); w <= largest; ++w) {
      std::vector<cv::Point2f> one{coarse[i]};
      cv::cornerSubPix(image, one, cv::Size(w, w), cv::Size(-1, -1),
                       cv::TermCriteria(cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 100, 1e-3));
      if (cv::norm(one[0] - coarse[i]) > w) continue;
      const double sigma = promised_sigma_px(image, one[0], w);
      if (!(sigma < least)) continue;
      least = sigma;
      fine[i] = one[0];
    }
  }
  return fine;
}

}  // namespace

std::string Board::text() const {
  static constexpr const char* kNames[] = {"chessboard", "circles", "asymmetric", "charuco"};
  std::ostringstream out;
  out << kNames[static_cast<int>(kind)] << ':' << columns << 'x' << rows << ':' << spacing_m;
  if (kind == BoardKind::charuco) out << ':' << marker_m << ':' << dictionary;
  return out.str();
}

std::size_t Board::points() const {
  const auto c = static_cast<std::size_t>(columns), r = static_cast<std::size_t>(rows);
  return kind == BoardKind::charuco ? (c - 1) * (r - 1) : c * r;
}

Result<Board> parse_board(const std::string& text) {
  const auto wrong = [&](const std::string& why) {
    return fail(ErrorCode::bad_input, "--target", std::string(kExpected) + ", got " + text + ": " + why);
  };
  const auto parts = split(text, ':');
  if (parts.size() < 3) return wrong("kind, size and spacing belong together");
  Board b;
  if (parts[0] == "chessboard")
    b.kind = BoardKind::chessboard;
  else if (parts[0] == "circles")
    b.kind = BoardKind::circles;
  else if (parts[0] == "asymmetric")
    b.kind = BoardKind::asymmetric_circles;
  else if (parts[0] == "charuco")
    b.kind = BoardKind::charuco;
  else
    return wrong("no such kind");
  const auto size = split(parts[1], 'x');
  if (size.size() != 2 || !number(size[0], b.columns) || !number(size[1], b.rows) || b.columns < 3 ||
      b.rows < 3 || b.columns > 200 || b.rows > 200)
    return wrong("columns and rows are numbers from 3 to 200");
  if (!number(parts[2], b.spacing_m) || !(b.spacing_m > 0) || !std::isfinite(b.spacing_m))
    return wrong("the spacing is a length in metres above 0");
  if (b.kind != BoardKind::charuco) return parts.size() == 3 ? Result<Board>(b) : wrong("too many parts");
  if (parts.size() < 4 || parts.size() > 5 || !number(parts[3], b.marker_m) || !(b.marker_m > 0) ||
      b.marker_m >= b.spacing_m)
    return wrong("a marker's side is a length in metres, smaller than the square");
  if (parts.size() == 5) b.dictionary = parts[4];
  if (!kDictionaries.count(b.dictionary)) {
    std::string names;
    for (const auto& [name, id] : kDictionaries) names += (names.empty() ? "" : ", ") + name;
    return wrong("the dictionary is one of " + names);
  }
  return b;
}

Result<BoardView> find_board(const std::string& name, const std::uint8_t* grey, int width_px, int height_px,
                             const Board& board) {
  const cv::Mat image(height_px, width_px, CV_8UC1, const_cast<std::uint8_t*>(grey));
  const auto none = [&](const std::string& more) {
    return fail(ErrorCode::not_found, name,
                "expected a board " + board.text() + " that is wholly in the picture, found none" + more);
  };
  BoardView view{name, width_px, height_px, {}};
  const cv::Size size(board.columns, board.rows);
  if (board.kind == BoardKind::charuco) {
    const auto dictionary = cv::aruco::getPredefinedDictionary(kDictionaries.at(board.dictionary));
    const auto charuco =
        cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.spacing_m),
                                        static_cast<float>(board.marker_m), dictionary);
    std::vector<int> ids;
    std::vector<std::vector<cv::Point2f>> markers;
    cv::aruco::detectMarkers(image, dictionary, markers, ids);
    if (ids.empty()) return none(": no marker of dictionary " + board.dictionary);
    std::vector<cv::Point2f> corners;
    std::vector<int> corner_ids;
    cv::aruco::interpolateCornersCharuco(markers, ids, image, charuco, corners, corner_ids);
    if (corners.size() < 6)
      return none(": " + std::to_string(ids.size()) + " markers, and fewer than 6 corners between them");
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const int column = corner_ids[i] % (board.columns - 1), row = corner_ids[i] / (board.columns - 1);
      view.points.push_back(point_of(board, column, row, corners[i].x, corners[i].y));
    }
    return view;
  }
  std::vector<cv::Point2f> corners;
  if (board.kind == BoardKind::chessboard) {
    bool found = cv::findChessboardCorners(image, size, corners,
                                           cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE);
    if (!found) found = cv::findChessboardCornersSB(image, size, corners, cv::CALIB_CB_NORMALIZE_IMAGE);
    if (!found) return none("");
    corners = refine_corners(image, corners);
  } else {
    const int flags =
        board.kind == BoardKind::circles ? cv::CALIB_CB_SYMMETRIC_GRID : cv::CALIB_CB_ASYMMETRIC_GRID;
    if (!cv::findCirclesGrid(image, size, corners, flags)) return none("");
  }
  for (std::size_t i = 0; i < corners.size(); ++i)
    view.points.push_back(point_of(board, static_cast<int>(i) % board.columns,
                                   static_cast<int>(i) / board.columns, corners[i].x, corners[i].y));
  return view;
}

Result<BoardView> find_board_in_file(const std::filesystem::path& file, const Board& board) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(file, ec))
    return fail(ErrorCode::not_found, file.string(), "expected an image file, got nothing of that name");
  const cv::Mat image = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  if (image.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected an image (PNG, JPEG, TIFF, BMP), got something that cannot be decoded");
  return find_board(file.string(), image.data, image.cols, image.rows, board);
}

Result<std::array<BoardView, 3>> find_board_in_planes(const std::string& name, const std::uint8_t* rgb,
                                                      int width_px, int height_px, const Board& board) {
  if (board.kind != BoardKind::chessboard)
    return fail(ErrorCode::bad_input, "--target",
                "expected a chessboard for the corners of each colour, got " + board.text());
  const cv::Mat colour(height_px, width_px, CV_8UC3, const_cast<std::uint8_t*>(rgb));
  std::vector<cv::Mat> planes;
  cv::split(colour, planes);
  const auto found = find_board(name, planes[1].data, width_px, height_px, board);
  if (!found) return tl::unexpected<Error>(found.error());
  std::vector<cv::Point2f> green;
  for (const BoardPoint& p : found->points)
    green.emplace_back(static_cast<float>(p.u_px), static_cast<float>(p.v_px));
  static constexpr const char* kColours[] = {" red", " green", " blue"};
  std::array<BoardView, 3> views{*found, *found, *found};
  for (std::size_t c = 0; c < 3; ++c) {
    views[c].name = name + kColours[c];
    const auto corners = refine_corners(planes[c], green);
    for (std::size_t i = 0; i < corners.size(); ++i)
      views[c].points[i].u_px = corners[i].x, views[c].points[i].v_px = corners[i].y;
  }
  return views;
}

Result<std::array<BoardView, 3>> find_board_in_planes_of_file(const std::filesystem::path& file,
                                                              const Board& board) {
  cv::Mat image = cv::imread(file.string(), cv::IMREAD_UNCHANGED);
  if (image.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected an image (PNG, JPEG, TIFF, BMP), got something that cannot be decoded");
  if (image.channels() != 3 || image.depth() != CV_8U)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a colour picture of 8 bits for --chromatic, got " +
                    std::to_string(image.channels()) + " channel(s)");
  cv::cvtColor(image, image, cv::COLOR_BGR2RGB);
  return find_board_in_planes(file.string(), image.data, image.cols, image.rows, board);
}

double board_brightness(const Board& board, double x_m, double y_m) {
  const double c = x_m / board.spacing_m, r = y_m / board.spacing_m;
  if (board.kind == BoardKind::chessboard || board.kind == BoardKind::charuco) {
    // Inner corners of a chessboard begin one square in; a ChArUco board counts squares and has its first
    // inner corner at the origin, too.
    const int columns = board.kind == BoardKind::charuco ? board.columns - 1 : board.columns;
    const int rows = board.kind == BoardKind::charuco ? board.rows - 1 : board.rows;
    if (c < -1 || r < -1 || c >= columns || r >= rows) return 1;
    return (static_cast<int>(std::floor(c)) + static_cast<int>(std::floor(r))) & 1 ? 1 : 0;
  }
  for (int row = static_cast<int>(std::floor(r)); row <= static_cast<int>(std::floor(r)) + 1; ++row)
    for (int column = 0; column < board.columns; ++column) {
      if (row < 0 || row >= board.rows) continue;
      const BoardPoint p = point_of(board, column, row, 0, 0);
      if (std::hypot(x_m - p.x_m, y_m - p.y_m) < 0.25 * board.spacing_m) return 0;
    }
  return 1;
}

Result<std::vector<BoardView>> read_corner_list(const std::filesystem::path& file, const Board& board,
                                                int width_px, int height_px) {
  std::ifstream in(file);
  if (!in) return fail(ErrorCode::not_found, file.string(), "expected a list of corners, got no such file");
  std::vector<BoardView> views;
  std::map<std::string, std::size_t> index, count;
  std::string line;
  for (int number_of_line = 1; std::getline(in, line); ++number_of_line) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    std::string name, x, y;
    const std::string place = file.string() + ":" + std::to_string(number_of_line);
    if (!(words >> name >> x))
      return fail(ErrorCode::bad_input, place, "expected `image x y [level]`, got " + line);
    std::size_t& n = count[name];
    if (x == "-" && n == 0) continue;  // no board in that picture
    double u = 0, v = 0;
    words >> y;
    const bool none = x == "-";
    if (!none && (!number(x, u) || !number(y, v) || !std::isfinite(u) || !std::isfinite(v)))
      return fail(ErrorCode::bad_input, place, "expected two numbers of pixels, got " + x + " " + y);
    if (!index.count(name)) {
      index[name] = views.size();
      views.push_back({name, width_px, height_px, {}});
    }
    if (n >= board.points())
      return fail(ErrorCode::bad_input, place,
                  "expected " + std::to_string(board.points()) + " corners of " + name + " for " +
                      board.text() + ", got more");
    const int column = static_cast<int>(n) % board.columns, row = static_cast<int>(n) / board.columns;
    if (!none) views[index[name]].points.push_back(point_of(board, column, row, u, v));
    ++n;
  }
  for (const auto& [name, n] : count)
    if (index.count(name) && n != board.points())
      return fail(ErrorCode::bad_input, file.string(),
                  "expected " + std::to_string(board.points()) + " corners of " + name + " for " +
                      board.text() + ", got " + std::to_string(n));
  return views;
}

}  // namespace rigor::calibration

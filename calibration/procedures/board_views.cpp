#include "calibration/procedures/board_views.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/console/progress.h"
#include "bench/files/output_file.h"
#include "bench/files/picture.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recording_input.h"

namespace rigor {
namespace {

using namespace calibration;

Status parse_size(const std::string& text, int& width_px, int& height_px) {
  char rest = 0;
  if (std::sscanf(text.c_str(), "%dx%d%c", &width_px, &height_px, &rest) == 2 && width_px >= 16 &&
      height_px >= 16 && width_px <= 16384 && height_px <= 16384)
    return {};
  return fail(ErrorCode::bad_input, "--size",
              "expected WIDTHxHEIGHT in pixels for a list of corners, as in 640x480, got " +
                  (text.empty() ? "nothing" : text));
}

/// The board as it was looked for, and the first picture beside it.
std::string draw_looked_for(const std::filesystem::path& folder, const Board& board, const cv::Mat& picture) {
  constexpr int kSquare = 40;
  cv::Mat drawn((board.rows + 3) * kSquare, (board.columns + 3) * kSquare, CV_8UC1);
  for (int v = 0; v < drawn.rows; ++v)
    for (int u = 0; u < drawn.cols; ++u)
      drawn.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(
          255 * board_brightness(board, (u - 2.0 * kSquare) / kSquare * board.spacing_m,
                                 (v - 2.0 * kSquare) / kSquare * board.spacing_m));
  cv::Mat page;
  if (picture.empty()) {
    page = drawn;
  } else {
    cv::Mat beside;
    const double scale = static_cast<double>(drawn.rows) / picture.rows;
    cv::resize(picture, beside, {}, scale, scale, cv::INTER_AREA);
    cv::hconcat(drawn, beside, page);
  }
  const auto file = folder / "looked_for.png";
  std::vector<std::uint8_t> png;
  if (!cv::imencode(".png", page, png)) return "";
  const std::string_view bytes(reinterpret_cast<const char*>(png.data()), png.size());
  return write_output(file, bytes) ? file.string() : "";
}

struct Reader {
  const BoardViewsOptions& options;
  const Board& board;
  BoardViews views{};
  double total = 0;  ///< pictures; 0: not known
  ProgressTask progress{"look for boards", total, "pictures"};
  std::size_t looked = 0;
  cv::Mat first{};

  void tell() {
    progress.set(static_cast<double>(looked));
    progress.note(fmt::format("{} found", views.seen.size()));
  }
  void take(BoardView view) {
    if (options.rate_hz > 0 && !std::isfinite(view.t_s))
      view.t_s = static_cast<double>(looked) / options.rate_hz;
    views.seen.push_back(std::move(view));
    views.picture.push_back(looked);
  }
  void take(Result<ColourViews> planes, const std::string& name, Result<BoardView>& view) {
    if (!planes) {
      view = tl::unexpected<Error>(planes.error());
      return;
    }
    view = (*planes)[1];
    view->name = name;
    views.colours.push_back(std::move(*planes));
  }
  Status one_recording(const std::filesystem::path& file) {
    Status bad;
    const auto read = read_samples(file, options.channel, SampleKind::image, [&](const Sample& sample) {
      const auto* info = sample.as<ImageInfo>();
      auto grey = grey_picture(*info, sample.bytes());
      if (!grey) {
        bad = tl::unexpected<Error>(grey.error());
        return false;
      }
      const int width = static_cast<int>(info->width_px), height = static_cast<int>(info->height_px);
      if (first.empty()) first = cv::Mat(height, width, CV_8UC1, grey->data()).clone();
      const std::string name = fmt::format("{}#{}", file.filename().string(), sample.stamp.sequence);
      Result<BoardView> view = BoardView{};
      if (!options.colours) {
        view = find_board(name, grey->data(), width, height, board);
      } else if (info->format != PixelFormat::rgb8) {
        bad = fail(ErrorCode::bad_input, name,
                   "expected pictures of three colours a pixel (rgb8) for --chromatic, got grey, a mosaic or "
                   "video");
        return false;
      } else {
        take(find_board_in_planes(name, reinterpret_cast<const std::uint8_t*>(sample.bytes().data()), width,
                                  height, board),
             name, view);
        if (!view && view.error().code != ErrorCode::not_found) {
          bad = tl::unexpected<Error>(view.error());
          return false;
        }
      }
      if (view) {
        view->t_s = 1e-9 * static_cast<double>(sample.stamp.t_capture.ns());
        take(std::move(*view));
      }
      ++looked;
      tell();
      views.interrupted = options.stop.stop_requested();
      return !views.interrupted;
    });
    if (!bad) return bad;
    if (!read) return tl::unexpected<Error>(read.error());
    views.notes.insert(views.notes.end(), read->warnings.begin(), read->warnings.end());
    return {};
  }
};

}  // namespace

Result<BoardViews> read_board_views(const BoardViewsOptions& options, const Board& board) {
  auto files = input_files(options.inputs, {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"});
  if (!files) return tl::unexpected<Error>(files.error());
  const bool pictures = std::none_of(files->begin(), files->end(), [](const std::filesystem::path& f) {
    return is_recording(f) || f.extension() == ".vnl";
  });
  Reader reader{
      .options = options, .board = board, .total = pictures ? static_cast<double>(files->size()) : 0};
  BoardViews& views = reader.views;
  views.files = *files;
  std::size_t without = 0;
  for (const auto& file : *files) {
    if (options.stop.stop_requested()) {
      views.interrupted = true;
      break;
    }
    if (is_recording(file)) {
      if (auto s = reader.one_recording(file); !s) return tl::unexpected<Error>(s.error());
      continue;
    }
    if (file.extension() == ".vnl") {
      if (options.colours)
        return fail(ErrorCode::bad_input, file.string(),
                    "expected pictures of colour for --chromatic, got a list of corners");
      int width = 0, height = 0;
      if (auto s = parse_size(options.size, width, height); !s) return tl::unexpected<Error>(s.error());
      auto list = read_corner_list(file, board, width, height);
      if (!list) return tl::unexpected<Error>(list.error());
      for (BoardView& view : *list) {
        reader.take(std::move(view));
        ++reader.looked;
      }
      continue;
    }
    Result<BoardView> view = BoardView{};
    if (options.colours)
      reader.take(find_board_in_planes_of_file(file, board), file.string(), view);
    else
      view = find_board_in_file(file, board);
    if (view) {
      reader.take(std::move(*view));
    } else if (view.error().code == ErrorCode::not_found) {
      if (reader.first.empty()) reader.first = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
      if (++without <= 20) views.notes.push_back(view.error().text());
    } else {
      return tl::unexpected<Error>(view.error());
    }
    ++reader.looked;
    reader.tell();
  }
  reader.progress.finish();
  if (without > 20)
    views.notes.push_back(fmt::format("… and {} more pictures without a board", without - 20));
  if (!views.seen.empty()) return std::move(views);
  std::string drawn = "; with --report FOLDER the board that was looked for is drawn there";
  if (!options.report.empty()) {
    const std::string name = draw_looked_for(options.report, board, reader.first);
    drawn = name.empty() ? "" : "; the board that was looked for is drawn in " + name;
  }
  return fail(
      ErrorCode::bad_input, files->empty() ? "INPUT" : files->front().string(),
      fmt::format("expected at least one picture with a board {}, found none in {}; check the number of "
                  "inner corners (--target) and that the whole board is in the picture{}",
                  board.text(), reader.looked, drawn));
}

}  // namespace rigor

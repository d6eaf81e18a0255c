#include "calibration/tof/lens.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace rigor::calibration {

std::vector<std::uint8_t> amplitude_picture(const TofFrame& frame) {
  std::vector<float> sorted;
  for (const float a : frame.amplitude)
    if (a >= 0 && std::isfinite(a)) sorted.push_back(std::sqrt(a));
  if (sorted.empty()) return {};
  std::sort(sorted.begin(), sorted.end());
  const auto at = [&](double q) {
    return sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size() - 1))];
  };
  const float low = at(0.005), high = at(0.995);
  if (!(high > low)) return {};
  std::vector<std::uint8_t> grey;
  grey.reserve(frame.amplitude.size());
  for (const float a : frame.amplitude) {
    const float v = a >= 0 && std::isfinite(a) ? (std::sqrt(a) - low) / (high - low) : 0;
    grey.push_back(static_cast<std::uint8_t>(std::lround(255 * std::clamp(v, 0.0F, 1.0F))));
  }
  return grey;
}

Result<BoardView> find_board_in_amplitude(const TofFrame& frame, const Board& board) {
  auto grey = amplitude_picture(frame);
  if (grey.empty())
    return fail(
        ErrorCode::bad_input, frame.name,
        "expected amplitudes beside the ranges, of surfaces that differ, got none: the board is looked "
        "for in them");
  const cv::Mat small(frame.height_px, frame.width_px, CV_8UC1, grey.data());
  // The search wants squares of ten pixels and more.
  const int times = std::clamp(static_cast<int>(std::lround(640.0 / std::max(1, frame.width_px))), 1, 4);
  cv::Mat picture = small;
  if (times > 1) cv::resize(small, picture, {}, times, times, cv::INTER_CUBIC);
  auto view = find_board(frame.name, picture.data, picture.cols, picture.rows, board);
  if (!view) return view;
  view->width_px = frame.width_px, view->height_px = frame.height_px;
  view->t_s = frame.t_s;
  for (BoardPoint& p : view->points) {
    p.u_px = (p.u_px + 0.5) / times - 0.5;
    p.v_px = (p.v_px + 0.5) / times - 0.5;
  }
  return view;
}

std::vector<BoardView> resting_views(const std::vector<BoardView>& views, double still_px) {
  std::vector<BoardView> out;
  double count = 0;
  for (const BoardView& v : views) {
    bool same = !out.empty() && out.back().points.size() == v.points.size();
    double squares = 0;
    for (std::size_t i = 0; same && i < v.points.size(); ++i) {
      const BoardPoint &a = out.back().points[i], &b = v.points[i];
      same = a.column == b.column && a.row == b.row;
      squares += (a.u_px - b.u_px) * (a.u_px - b.u_px) + (a.v_px - b.v_px) * (a.v_px - b.v_px);
    }
    same = same && squares < still_px * still_px * static_cast<double>(v.points.size());
    if (!same) {
      out.push_back(v);
      count = 1;
      continue;
    }
    count += 1;
    for (std::size_t i = 0; i < v.points.size(); ++i) {
      BoardPoint& a = out.back().points[i];
      a.u_px += (v.points[i].u_px - a.u_px) / count;
      a.v_px += (v.points[i].v_px - a.v_px) / count;
    }
  }
  return out;
}

}  // namespace rigor::calibration

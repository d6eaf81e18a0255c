#include "apps/stereo-depth/picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "apps/stereo-depth/matcher.h"

namespace rigor::stereo {
namespace {

constexpr double kErrorScale_px = 2;

cv::Mat false_colour(const cv::Mat& disparity, double full_scale_px) {
  cv::Mat grey(disparity.size(), CV_8U), colour;
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x)
      grey.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(
          std::lround(std::clamp(disparity.at<float>(y, x) / full_scale_px, 0.0, 1.0) * 255));
  cv::applyColorMap(grey, colour, cv::COLORMAP_JET);
  colour.setTo(cv::Scalar(0, 0, 0), disparity < 0);
  return colour;
}

cv::Mat error_map(const cv::Mat& disparity, const cv::Mat& truth, const cv::Mat& judged) {
  cv::Mat out(disparity.size(), CV_8UC3, cv::Scalar(128, 128, 128));
  for (int y = 0; y < out.rows; ++y)
    for (int x = 0; x < out.cols; ++x) {
      if (judged.at<std::uint8_t>(y, x) == 0) continue;
      const float d = disparity.at<float>(y, x);
      cv::Vec3b& pixel = out.at<cv::Vec3b>(y, x);
      if (d < 0) {
        pixel = {0, 0, 0};
        continue;
      }
      const double e = std::clamp((d - truth.at<float>(y, x)) / kErrorScale_px, -1.0, 1.0);
      const auto rest = static_cast<std::uint8_t>(std::lround(255 * (1 - std::abs(e))));
      pixel = e > 0 ? cv::Vec3b{rest, rest, 255} : cv::Vec3b{255, rest, rest};
    }
  return out;
}

}  // namespace

cv::Mat side_by_side(const cv::Mat& left, const cv::Mat& disparity, const cv::Mat& truth,
                     const cv::Mat& judged, double full_scale_px) {
  cv::Mat shown;
  cv::cvtColor(left, shown, cv::COLOR_GRAY2BGR);
  std::vector<cv::Mat> columns{shown, false_colour(disparity, full_scale_px)};
  if (!truth.empty()) {
    columns.push_back(false_colour(truth, full_scale_px));
    columns.push_back(error_map(disparity, truth, judged));
  }
  cv::Mat out;
  cv::hconcat(columns, out);
  return out;
}

}  // namespace rigor::stereo

#include "apps/stereo-depth/matcher.h"

namespace rigor::stereo {

Matcher::Matcher(const MatcherConfig& config) : config_(config) {
  // P1, P2: as OpenCV's documentation recommends for a block of one channel.
  const int area = config.block_px * config.block_px;
  sgbm_ = cv::StereoSGBM::create(0, config.disparities, config.block_px, 8 * area, 32 * area,
                                 config.left_right_px, 63, config.uniqueness_percent, config.speckle_px,
                                 config.speckle_px > 0 ? 2 : 0,
                                 config.full ? cv::StereoSGBM::MODE_HH : cv::StereoSGBM::MODE_SGBM);
}

cv::Mat Matcher::match(const cv::Mat& left, const cv::Mat& right) {
  cv::Mat wide_left, wide_right, fixed;
  const int margin = config_.disparities;
  cv::copyMakeBorder(left, wide_left, 0, 0, margin, 0, cv::BORDER_REPLICATE);
  cv::copyMakeBorder(right, wide_right, 0, 0, margin, 0, cv::BORDER_REPLICATE);
  sgbm_->compute(wide_left, wide_right, fixed);
  cv::Mat out(left.size(), CV_32F);
  for (int y = 0; y < out.rows; ++y)
    for (int x = 0; x < out.cols; ++x) {
      const float d =
          static_cast<float>(fixed.at<short>(y, x + margin)) / float{cv::StereoMatcher::DISP_SCALE};
      // A match beyond the picture's edge is one with pixels that were put there.
      out.at<float>(y, x) = d < 0 || d > static_cast<float>(x) ? kNoDisparity : d;
    }
  return out;
}

}  // namespace rigor::stereo

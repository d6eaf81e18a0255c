// Disparities of a rectified pair by OpenCV's semi-global block matching (Hirschmüller, PAMI 2008).
#pragma once

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

namespace rigor::stereo {

struct MatcherConfig {
  int disparities = 128;  ///< searched from 0 on; a multiple of 16
  int block_px = 5;       ///< odd
  int uniqueness_percent = 10;
  int left_right_px = 1;  ///< by how much the match from right to left may differ; -1: not checked
  int speckle_px = 100;   ///< smaller patches of one disparity are dropped; 0: none
  bool full = false;      ///< eight directions in place of five
};

/// What says that a pixel has no disparity.
inline constexpr float kNoDisparity = -1;

class Matcher {
 public:
  explicit Matcher(const MatcherConfig& config);
  /// 32-bit floats in pixels, in steps of 1/16; kNoDisparity where none was found. The pictures are widened
  /// to the left for the search, so that the left edge is searched as the rest is. Allocates; one thread at a
  /// time.
  [[nodiscard]] cv::Mat match(const cv::Mat& left, const cv::Mat& right);

 private:
  MatcherConfig config_;
  cv::Ptr<cv::StereoSGBM> sgbm_;
};

}  // namespace rigor::stereo

// What a person looks at: the rectified left picture, disparity, true disparity and error, side by side.
#pragma once

#include <opencv2/core.hpp>

namespace rigor::stereo {

/// Four columns of the pictures' size, BGR. Disparities in false colour from 0 (blue) to `full_scale_px`
/// (red), black: none. Error: white none to red 2 px and more too large, to blue too small; black: judged and
/// not found; grey: not judged. `truth` and `judged` may be empty: then the first two columns alone.
[[nodiscard]] cv::Mat side_by_side(const cv::Mat& left, const cv::Mat& disparity, const cv::Mat& truth,
                                   const cv::Mat& judged, double full_scale_px);

}  // namespace rigor::stereo

// How far a disparity image is from the truth.
//
// Judged are pixels of which there is a truth within the search, that the left camera and, there, the right
// camera sees, and in front of which nothing stands as the right camera sees it (half-occluded pixels have no
// counterpart).
//
//   completeness   share of the judged pixels that got a disparity
//   bad1, bad2     share of these that are off by more than 1, 2 px
//   correct        share of the judged pixels that got a disparity within 1 px
//   invented       share of the pixels without anything in reach (sky) that got a disparity of more than 1 px
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <nlohmann/json_fwd.hpp>
#include <opencv2/core.hpp>
#include <vector>

#include "apps/stereo-depth/rectifier.h"

namespace rigor::stereo {

/// Depths along the optical axis [m] that the rectified left camera would see, NaN where there is nothing,
/// from true ranges along the rays of a pinhole that stands where the left camera stands and looks as it
/// does. Between four pixels of one surface 1/z is bilinear, which is exact on planes; at edges the nearest
/// pixel counts.
[[nodiscard]] cv::Mat true_depth(const RectifiedCamera& camera, const CameraModel& pinhole,
                                 const float* range_m);

/// focal * baseline / z; kNoDisparity where there is nothing.
[[nodiscard]] cv::Mat true_disparity(const RectifiedCamera& camera, const cv::Mat& depth_m);

/// 255: judged. `disparities`: of the search.
[[nodiscard]] cv::Mat judged_pixels(const Rectifier& rectifier, const cv::Mat& true_disparity,
                                    int disparities);

/// Errors of many pixels: count, root mean square, and medians to a 32000th of `limit`.
class ErrorSum {
 public:
  explicit ErrorSum(double limit) : limit_(limit), bins_(2 * kBins + 1) {}
  void add(double error);
  [[nodiscard]] std::uint64_t count() const { return count_; }
  [[nodiscard]] double rms() const;
  [[nodiscard]] double median() const;  ///< signed: bias
  [[nodiscard]] double median_magnitude() const;

 private:
  static constexpr int kBins = 32000;
  double limit_;  ///< what is beyond counts as this in the medians
  std::vector<std::uint64_t> bins_;
  std::uint64_t count_ = 0;
  double squares_ = 0;
};

/// Sums over views; one for all ranges or for those of a bin.
struct Score {
  double from_m = 0, to_m = std::numeric_limits<double>::infinity();
  std::uint64_t judged = 0, found = 0, bad1 = 0, bad2 = 0;
  ErrorSum disparity_px{64}, depth_share{1};  ///< measured - true; and that of the depth over the true depth
  double depth_squares_m2 = 0;
};

class Evaluation {
 public:
  /// Bins of depth: 0-2, 2-4, 4-8, 8-16, 16-32, 32- m.
  Evaluation();
  void add(const Rectifier& rectifier, const cv::Mat& disparity, const cv::Mat& depth_m, int disparities);
  [[nodiscard]] const Score& all() const { return scores_.front(); }
  [[nodiscard]] nlohmann::json json() const;

 private:
  std::vector<Score> scores_;
  std::uint64_t views_ = 0, pixels_ = 0, dense_ = 0, empty_ = 0, invented_ = 0;
};

}  // namespace rigor::stereo

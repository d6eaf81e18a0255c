#include "apps/stereo-depth/evaluation.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "apps/stereo-depth/matcher.h"

namespace rigor::stereo {
namespace {

/// Neighbours whose depths differ by more belong to two surfaces.
constexpr double kSameSurface = 0.05;

double share(std::uint64_t part, std::uint64_t of) {
  return of > 0 ? static_cast<double>(part) / static_cast<double>(of) : 0;
}

}  // namespace

cv::Mat true_depth(const RectifiedCamera& camera, const CameraModel& pinhole, const float* range_m) {
  const int w = pinhole.width_px, h = pinhole.height_px;
  const Eigen::Matrix3d R_left_rectified = camera.R_rectified_left.transpose();
  // Of a pixel of the pinhole: depth along the rectified camera's axis.
  const auto depth_at = [&](int u, int v) -> double {
    const Eigen::Vector3d ray((u - pinhole.cx_px) / pinhole.fx_px, (v - pinhole.cy_px) / pinhole.fy_px, 1);
    return range_m[static_cast<std::size_t>(v) * static_cast<std::size_t>(w) + static_cast<std::size_t>(u)] *
           (camera.R_rectified_left.row(2) * ray.normalized()).value();
  };
  cv::Mat out(camera.height_px, camera.width_px, CV_32F, cv::Scalar(std::nanf("")));
  for (int y = 0; y < out.rows; ++y)
    for (int x = 0; x < out.cols; ++x) {
      const Eigen::Vector3d ray = R_left_rectified * Eigen::Vector3d((x - camera.cx_px) / camera.focal_px,
                                                                     (y - camera.cy_px) / camera.focal_px, 1);
      const double u = ray.x() / ray.z() * pinhole.fx_px + pinhole.cx_px;
      const double v = ray.y() / ray.z() * pinhole.fy_px + pinhole.cy_px;
      if (!(u >= 0 && v >= 0 && u <= w - 1 && v <= h - 1)) continue;
      const int u0 = std::min(static_cast<int>(u), w - 2), v0 = std::min(static_cast<int>(v), h - 2);
      const double a = u - u0, b = v - v0;
      const std::array<double, 4> z{depth_at(u0, v0), depth_at(u0 + 1, v0), depth_at(u0, v0 + 1),
                                    depth_at(u0 + 1, v0 + 1)};
      const double near = *std::min_element(z.begin(), z.end()), far = *std::max_element(z.begin(), z.end());
      const bool all = std::all_of(z.begin(), z.end(), [](double d) { return std::isfinite(d); });
      double depth = z[static_cast<std::size_t>((b > 0.5 ? 2 : 0) + (a > 0.5 ? 1 : 0))];
      if (all && far < near * (1 + kSameSurface))
        depth = 1 / ((1 - b) * ((1 - a) / z[0] + a / z[1]) + b * ((1 - a) / z[2] + a / z[3]));
      out.at<float>(y, x) = static_cast<float>(depth);
    }
  return out;
}

cv::Mat true_disparity(const RectifiedCamera& camera, const cv::Mat& depth_m) {
  cv::Mat out(depth_m.size(), CV_32F);
  for (int y = 0; y < out.rows; ++y)
    for (int x = 0; x < out.cols; ++x) {
      const float z = depth_m.at<float>(y, x);
      out.at<float>(y, x) =
          z > 0 ? static_cast<float>(camera.focal_px * camera.baseline_m / z) : kNoDisparity;
    }
  return out;
}

cv::Mat judged_pixels(const Rectifier& rectifier, const cv::Mat& true_disparity, int disparities) {
  const int w = true_disparity.cols;
  cv::Mat judged(true_disparity.size(), CV_8U, cv::Scalar(0));
  std::vector<float> front(
      static_cast<std::size_t>(w));  // the nearest thing that a pixel of the right camera sees
  for (int y = 0; y < judged.rows; ++y) {
    const float* d = true_disparity.ptr<float>(y);
    std::fill(front.begin(), front.end(), kNoDisparity);
    const auto counterpart = [&](int x) {
      return static_cast<int>(std::lround(static_cast<float>(x) - d[x]));
    };
    for (int x = 0; x < w; ++x)
      if (d[x] >= 0)
        if (const int at = counterpart(x); at >= 0 && at < w)
          front[static_cast<std::size_t>(at)] = std::max(front[static_cast<std::size_t>(at)], d[x]);
    for (int x = 0; x < w; ++x) {
      if (!(d[x] >= 0) || d[x] > static_cast<float>(disparities - 1)) continue;
      const int at = counterpart(x);
      if (at < 0 || at >= w) continue;
      if (rectifier.left_mask().at<std::uint8_t>(y, x) == 0 ||
          rectifier.right_mask().at<std::uint8_t>(y, at) == 0)
        continue;
      if (front[static_cast<std::size_t>(at)] <= d[x] + 1) judged.at<std::uint8_t>(y, x) = 255;
    }
  }
  return judged;
}

void ErrorSum::add(double error) {
  ++count_;
  squares_ += error * error;
  const double at = std::clamp(error / limit_, -1.0, 1.0) * kBins;
  ++bins_[static_cast<std::size_t>(std::lround(at) + kBins)];
}

double ErrorSum::rms() const { return count_ > 0 ? std::sqrt(squares_ / static_cast<double>(count_)) : 0; }

double ErrorSum::median() const {
  std::uint64_t below = 0;
  for (int i = 0; i <= 2 * kBins; ++i)
    if ((below += bins_[static_cast<std::size_t>(i)]) * 2 >= count_ && count_ > 0)
      return (i - kBins) * limit_ / kBins;
  return 0;
}

double ErrorSum::median_magnitude() const {
  std::uint64_t below = 0;
  for (int i = 0; i <= kBins && count_ > 0; ++i) {
    below += bins_[static_cast<std::size_t>(kBins + i)];
    if (i > 0) below += bins_[static_cast<std::size_t>(kBins - i)];
    if (below * 2 >= count_) return i * limit_ / kBins;
  }
  return 0;
}

Evaluation::Evaluation() {
  scores_.emplace_back();
  const std::array<double, 6> edges{0, 2, 4, 8, 16, 32};
  for (std::size_t i = 0; i < edges.size(); ++i) {
    Score s;
    s.from_m = edges[i];
    if (i + 1 < edges.size()) s.to_m = edges[i + 1];
    scores_.push_back(std::move(s));
  }
}

void Evaluation::add(const Rectifier& rectifier, const cv::Mat& disparity, const cv::Mat& depth_m,
                     int disparities) {
  const RectifiedCamera& camera = rectifier.camera();
  const cv::Mat truth = true_disparity(camera, depth_m);
  const cv::Mat judged = judged_pixels(rectifier, truth, disparities);
  ++views_;
  for (int y = 0; y < disparity.rows; ++y)
    for (int x = 0; x < disparity.cols; ++x) {
      const float d = disparity.at<float>(y, x), z = depth_m.at<float>(y, x);
      if (rectifier.left_mask().at<std::uint8_t>(y, x) == 0) continue;
      ++pixels_;
      if (d >= 0) ++dense_;
      if (!(z > 0)) {
        ++empty_;
        if (d > 1) ++invented_;
      }
      if (judged.at<std::uint8_t>(y, x) == 0) continue;
      for (Score& s : scores_) {
        if (z < s.from_m || z >= s.to_m) continue;
        ++s.judged;
        if (d < 0) continue;
        ++s.found;
        const double error = d - truth.at<float>(y, x);
        s.bad1 += std::abs(error) > 1;
        s.bad2 += std::abs(error) > 2;
        s.disparity_px.add(error);
        // A disparity of 0 is a depth without bounds: it counts as one of half a step.
        const double depth_error_m = camera.focal_px * camera.baseline_m / std::max<double>(d, 1.0 / 32) - z;
        s.depth_share.add(depth_error_m / z);
        s.depth_squares_m2 += depth_error_m * depth_error_m;
      }
    }
}

nlohmann::json Evaluation::json() const {
  nlohmann::json out{{"views", views_},
                     {"density", share(dense_, pixels_)},
                     {"invented", share(invented_, empty_)},
                     {"empty", share(empty_, pixels_)},
                     {"by_depth", nlohmann::json::array()}};
  for (const Score& s : scores_) {
    if (s.judged == 0) continue;
    nlohmann::json j{
        {"judged_px", s.judged},
        {"completeness", share(s.found, s.judged)},
        {"correct", share(s.found - s.bad1, s.judged)},
        {"bad1", share(s.bad1, s.found)},
        {"bad2", share(s.bad2, s.found)},
        {"disparity_rms_px", s.disparity_px.rms()},
        {"disparity_median_px", s.disparity_px.median_magnitude()},
        {"disparity_bias_px", s.disparity_px.median()},
        {"depth_rms_m", s.found > 0 ? std::sqrt(s.depth_squares_m2 / static_cast<double>(s.found)) : 0},
        {"depth_median_percent", 100 * s.depth_share.median_magnitude()},
        {"depth_bias_percent", 100 * s.depth_share.median()}};
    if (&s == &scores_.front()) {
      out["all"] = std::move(j);
      continue;
    }
    j["from_m"] = s.from_m;
    if (std::isfinite(s.to_m)) j["to_m"] = s.to_m;
    out["by_depth"].push_back(std::move(j));
  }
  return out;
}

}  // namespace rigor::stereo

// The geometry that disparities stand on, the search, and the judge: on surfaces whose pictures are worked
// out here, ray by ray, through the lenses of the stereo module's sensor models.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "apps/stereo-depth/evaluation.h"
#include "apps/stereo-depth/matcher.h"
#include "apps/stereo-depth/rectifier.h"
#include "sim/world/pose.h"

namespace rigor::stereo {
namespace {

CameraModel half_size(const OpenCvLens& lens, double fx_px, double cx_px, double cy_px) {
  CameraModel m;
  m.width_px = 376, m.height_px = 240;
  m.fx_px = fx_px, m.fy_px = fx_px * 0.9996;
  m.cx_px = cx_px, m.cy_px = cy_px;
  m.lens = lens;
  return m;
}
CameraModel left_camera() { return half_size({-0.291, 0.094, 0.0003, 0.0001, -0.014}, 268.1, 186.0, 121.3); }
CameraModel right_camera() {
  return half_size({-0.288, 0.091, -0.0002, 0.0004, -0.013}, 267.5, 189.2, 119.1);
}

Pose mounted(double roll_deg, double pitch_deg, double yaw_deg) {
  const auto turn = [](double deg, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(deg * std::numbers::pi / 180, axis);
  };
  const Eigen::Quaterniond q = turn(yaw_deg, Eigen::Vector3d::UnitZ()) *
                               turn(pitch_deg, Eigen::Vector3d::UnitY()) *
                               turn(roll_deg, Eigen::Vector3d::UnitX());
  return {{0.2, 0.003, -0.002}, {q.w(), q.x(), q.y(), q.z()}};
}

/// A plane in the left camera's frame, m · X = 1, with a pattern of sums of waves down to 6 px.
struct Plane {
  Eigen::Vector3d m;
  [[nodiscard]] double depth(const Eigen::Vector3d& at, const Eigen::Vector3d& ray) const {
    return (1 - m.dot(at)) / m.dot(ray);
  }
  [[nodiscard]] double brightness(const Eigen::Vector3d& p) const {
    double sum = 128;
    for (int i = 0; i < 24; ++i) {
      // Wavelengths from a quarter of a metre down, directions and phases that do not repeat.
      const double k = 25 * std::pow(1.09, i), a = 2.4 * i, phase = 1.7 * i * i;
      sum += 14 * std::sin(k * (std::cos(a) * p.x() + std::sin(a) * (p.y() + 0.3 * p.z())) + phase);
    }
    return std::clamp(sum, 0.0, 255.0);
  }
};

cv::Mat picture(const CameraModel& camera, const Eigen::Isometry3d& T_left_camera, const Plane& plane) {
  cv::Mat out(camera.height_px, camera.width_px, CV_8U);
  for (int v = 0; v < out.rows; ++v)
    for (int u = 0; u < out.cols; ++u) {
      double sum = 0;
      int n = 0;
      for (const double a : {-0.25, 0.25})
        for (const double b : {-0.25, 0.25})
          if (const auto ray = unproject(camera, {u + a, v + b})) {
            const Eigen::Vector3d at = T_left_camera.translation(),
                                  d = T_left_camera.linear() * Eigen::Vector3d(ray->x, ray->y, 1);
            sum += plane.brightness(at + plane.depth(at, d) * d);
            ++n;
          }
      out.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(std::lround(sum / std::max(n, 1)));
    }
  return out;
}

/// True ranges of the plane for a pinhole at the left camera's place.
std::vector<float> ranges(const CameraModel& pinhole, const Plane& plane) {
  std::vector<float> out;
  for (int v = 0; v < pinhole.height_px; ++v)
    for (int u = 0; u < pinhole.width_px; ++u) {
      const Eigen::Vector3d d =
          Eigen::Vector3d((u - pinhole.cx_px) / pinhole.fx_px, (v - pinhole.cy_px) / pinhole.fy_px, 1)
              .normalized();
      out.push_back(static_cast<float>(1 / plane.m.dot(d)));
    }
  return out;
}

CameraModel truth_camera() { return half_size({}, 268.1, 199.5, 129.5); }
CameraModel wide_truth_camera() {
  CameraModel m = truth_camera();
  m.width_px = 400, m.height_px = 260;
  m.fy_px = m.fx_px;
  return m;
}

Rectifier rectifier(const Pose& T_left_right = mounted(0.2, 0.3, -0.25)) {
  auto r = Rectifier::make(left_camera(), right_camera(), T_left_right);
  EXPECT_TRUE(r) << (r ? "" : r.error().text());
  return std::move(*r);
}

TEST(StereoRectifier, PutsAPointOnOneRowAtTheDisparityOfItsDepth) {
  // Through the maps themselves: the rectified pixel of a point, looked up in both cameras' pictures of where
  // they see it.
  const Pose pose = mounted(1.2, 2, -1.5);
  const Rectifier r = rectifier(pose);
  const RectifiedCamera& c = r.camera();
  const Eigen::Isometry3d T_right_left = isometry_of(pose).inverse();
  EXPECT_NEAR(c.baseline_m, std::hypot(0.2, std::hypot(0.003, 0.002)), 1e-12);
  // Two pictures whose brightness is the place itself: remap then reads the maps out.
  const auto coordinate = [](const CameraModel& m, bool row) {
    cv::Mat p(m.height_px, m.width_px, CV_32F);
    for (int v = 0; v < p.rows; ++v)
      for (int u = 0; u < p.cols; ++u) p.at<float>(v, u) = static_cast<float>(row ? v : u);
    return p;
  };
  const RectifiedPair at_u = r.rectify(coordinate(left_camera(), false), coordinate(right_camera(), false));
  const RectifiedPair at_v = r.rectify(coordinate(left_camera(), true), coordinate(right_camera(), true));
  for (const double z_m : {1.0, 3.0, 20.0})
    for (const int x : {120, 200, 300})
      for (const int y : {40, 120, 200}) {
        const Eigen::Vector3d p_rectified =
            z_m * Eigen::Vector3d((x - c.cx_px) / c.focal_px, (y - c.cy_px) / c.focal_px, 1);
        const Eigen::Vector3d p_left = c.R_rectified_left.transpose() * p_rectified;
        const auto in_left = project(left_camera(), {p_left.x(), p_left.y(), p_left.z()});
        ASSERT_TRUE(in_left);
        EXPECT_NEAR(at_u.left.at<float>(y, x), in_left->u_px, 0.05);
        EXPECT_NEAR(at_v.left.at<float>(y, x), in_left->v_px, 0.05);
        const double other = x - c.focal_px * c.baseline_m / z_m;
        if (other < 1) continue;
        const Eigen::Vector3d p_right = T_right_left * p_left;
        const auto in_right = project(right_camera(), {p_right.x(), p_right.y(), p_right.z()});
        ASSERT_TRUE(in_right);
        const int x0 = static_cast<int>(other);
        const auto between = [&](const cv::Mat& m) {
          return m.at<float>(y, x0) + (other - x0) * (m.at<float>(y, x0 + 1) - m.at<float>(y, x0));
        };
        // remap's own table has steps of 1/32 px.
        EXPECT_NEAR(between(at_u.right), in_right->u_px, 0.05) << z_m << " m at " << x << ", " << y;
        EXPECT_NEAR(between(at_v.right), in_right->v_px, 0.05) << z_m << " m at " << x << ", " << y;
      }
}

TEST(StereoRectifier, RefusesWhatIsNoPair) {
  EXPECT_FALSE(Rectifier::make(left_camera(), right_camera(), {}));
  EXPECT_FALSE(Rectifier::make(left_camera(), right_camera(), {{-0.2, 0, 0}, {1, 0, 0, 0}}));  // swapped
  EXPECT_FALSE(Rectifier::make(left_camera(), right_camera(), {{0.1, 0, 0.3}, {1, 0, 0, 0}}));
  CameraModel fisheye = left_camera();
  fisheye.projection = Projection::kannala_brandt;
  EXPECT_FALSE(Rectifier::make(fisheye, right_camera(), mounted(0, 0, 0)));
}

TEST(StereoTruth, IsExactOnPlanesAndNearestAtEdges) {
  const Rectifier r = rectifier(mounted(1, 2, -1));
  const RectifiedCamera& c = r.camera();
  const Plane slanted{Eigen::Vector3d(0.1, -0.15, 0.4)};
  const CameraModel pinhole = wide_truth_camera();
  std::vector<float> range = ranges(pinhole, slanted);
  cv::Mat depth = true_depth(c, pinhole, range.data());
  for (int y = 20; y < 220; y += 7)
    for (int x = 20; x < 356; x += 7) {
      const Eigen::Vector3d ray((x - c.cx_px) / c.focal_px, (y - c.cy_px) / c.focal_px, 1);
      const double z = 1 / slanted.m.dot(c.R_rectified_left.transpose() * ray);
      ASSERT_NEAR(depth.at<float>(y, x), z, 2e-6 * z) << x << ", " << y;
    }
  // A step from 2 m to 8 m: no depth between the two.
  for (int v = 0; v < pinhole.height_px; ++v)
    for (int u = 0; u < pinhole.width_px; ++u)
      range[static_cast<std::size_t>(v * pinhole.width_px + u)] = u < 200 ? 2.F : 8.F;
  depth = true_depth(c, pinhole, range.data());
  int near = 0, far = 0;
  for (int x = 0; x < depth.cols; ++x) {
    const float z = depth.at<float>(120, x);
    if (std::isnan(z)) continue;
    ASSERT_TRUE(z < 2.01F || z > 5.5F) << x << ": " << z;
    ++(z < 3 ? near : far);
  }
  EXPECT_GT(near, 100);
  EXPECT_GT(far, 100);
}

TEST(StereoMatcher, APlaneAtAKnownDistanceThroughBothLenses) {
  const Pose pose = mounted(0.2, 0.3, -0.25);
  const Rectifier r = rectifier(pose);
  const CameraModel pinhole = wide_truth_camera();
  for (const Eigen::Vector3d& m : {Eigen::Vector3d(0, 0, 1 / 2.5), Eigen::Vector3d(0.08, -0.05, 1 / 1.9)}) {
    const Plane plane{m};
    const RectifiedPair pair = r.rectify(picture(left_camera(), Eigen::Isometry3d::Identity(), plane),
                                         picture(right_camera(), isometry_of(pose), plane));
    Matcher matcher({.disparities = 64});
    const cv::Mat disparity = matcher.match(pair.left, pair.right);
    const auto range = ranges(pinhole, plane);
    Evaluation evaluation;
    evaluation.add(r, disparity, true_depth(r.camera(), pinhole, range.data()), 64);
    const Score& s = evaluation.all();
    EXPECT_GT(s.judged, 60000u);
    EXPECT_GT(static_cast<double>(s.found) / static_cast<double>(s.judged), 0.99);
    EXPECT_LT(static_cast<double>(s.bad1), 0.001 * static_cast<double>(s.found));
    // SGBM fits a parabola to its costs, and its errors lean to whole pixels: over a slanted plane, which has
    // all fractions, they cancel; over one that faces the cameras up to 0.15 px are left. Half a pixel in a
    // convention would show in either.
    EXPECT_LT(std::abs(s.disparity_px.median()), m.x() == 0 ? 0.15 : 0.06);
    EXPECT_LT(s.disparity_px.rms(), 0.3);
    std::printf("bias %.4f px, median of the error %.4f px, rms %.4f px\n", s.disparity_px.median(),
                s.disparity_px.median_magnitude(), s.disparity_px.rms());
  }
}

TEST(StereoJudge, LeavesOutWhatTheRightCameraCannotSee) {
  auto made = Rectifier::make(half_size({}, 268.1, 187.5, 119.5), half_size({}, 268.1, 187.5, 119.5),
                              {{0.2, 0, 0}, {1, 0, 0, 0}});
  ASSERT_TRUE(made);
  // A near box (20 px) before a far wall (5 px): of the wall the 15 px to the left of the box are hidden from
  // the right camera, and the leftmost 5 px lie beyond its picture.
  cv::Mat truth(240, 376, CV_32F, cv::Scalar(5));
  truth.colRange(150, 200).setTo(cv::Scalar(20));
  truth.row(7).setTo(cv::Scalar(kNoDisparity));
  const cv::Mat judged = judged_pixels(*made, truth, 64);
  std::vector<int> left_out;
  for (int x = 0; x < judged.cols; ++x)
    if (judged.at<std::uint8_t>(100, x) == 0) left_out.push_back(x);
  std::vector<int> expected{0, 1, 2, 3, 4};
  for (int x = 135; x < 150; ++x) expected.push_back(x);
  EXPECT_EQ(left_out, expected);
  EXPECT_EQ(cv::countNonZero(judged.row(7)), 0);
  EXPECT_EQ(cv::countNonZero(judged_pixels(*made, truth, 16).row(100).colRange(150, 200)),
            0);  // beyond the search
}

TEST(StereoJudge, CountsWhatWasMissedWrongAndInvented) {
  auto made = Rectifier::make(half_size({}, 268.1, 187.5, 119.5), half_size({}, 268.1, 187.5, 119.5),
                              {{0.2, 0, 0}, {1, 0, 0, 0}});
  ASSERT_TRUE(made);
  const auto depth_of = [&](double d_px) { return static_cast<float>(268.1 * 0.2 / d_px); };
  cv::Mat depth(240, 376, CV_32F, cv::Scalar(depth_of(10))), disparity(240, 376, CV_32F, cv::Scalar(10.25));
  depth.rowRange(0, 40).setTo(cv::Scalar(std::nanf("")));      // sky
  disparity.rowRange(0, 10).setTo(cv::Scalar(30));             // a quarter of it invented
  disparity.rowRange(10, 40).setTo(cv::Scalar(0.5));           // nearly infinitely far: right
  disparity.rowRange(40, 90).setTo(cv::Scalar(kNoDisparity));  // of 200 rows a quarter missed
  disparity.rowRange(90, 120).setTo(cv::Scalar(11.5));         // of 150 found a fifth off by 1.5
  disparity.rowRange(120, 135).setTo(cv::Scalar(7));           // and a tenth by 3
  Evaluation evaluation;
  evaluation.add(*made, disparity, depth, 64);
  const Score& s = evaluation.all();
  EXPECT_EQ(s.judged, 200u * 366u);
  EXPECT_EQ(s.found, 150u * 366u);
  EXPECT_EQ(s.bad1, 45u * 366u);
  EXPECT_EQ(s.bad2, 15u * 366u);
  EXPECT_NEAR(s.disparity_px.median(), 0.25, 0.002);
  EXPECT_NEAR(s.disparity_px.median_magnitude(), 0.25, 0.002);
  EXPECT_NEAR(s.disparity_px.rms(), std::sqrt(0.7 * 0.0625 + 0.2 * 2.25 + 0.1 * 9), 1e-5);
  EXPECT_NEAR(s.depth_share.median(), 10 / 10.25 - 1, 1e-4);
}

}  // namespace
}  // namespace rigor::stereo

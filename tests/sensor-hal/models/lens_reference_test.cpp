// The lens against OpenCV's own implementation.
#include <gtest/gtest.h>

#include <opencv2/calib3d.hpp>
#include <random>

#include "sensor-hal/models/camera_model.h"
#include "tests/sensor-hal/models/test_lenses.h"

namespace rigor {
namespace {

TEST(OpenCvLens, ProjectsAsOpenCvDoes) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> xy(-0.55, 0.55), depth(0.3, 20.0);
  for (const OpenCvLens& l : test::kLenses) {
    const CameraModel c = test::camera_with(l);
    std::vector<cv::Point3d> points;
    for (int i = 0; i < 3000; ++i) {
      const double z = depth(random);
      points.emplace_back(xy(random) * z, xy(random) * z, z);
    }
    const cv::Matx33d camera_matrix(c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1);
    const cv::Vec<double, 8> coefficients(l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6);
    std::vector<cv::Point2d> expected;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), camera_matrix, coefficients, expected);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto p = project(c, {points[i].x, points[i].y, points[i].z});
      ASSERT_TRUE(p);
      // Two orders of evaluation of one formula in double: some 1e3 ulp of 640 px at the most.
      EXPECT_NEAR(p->u_px, expected[i].x, 1e-10);
      EXPECT_NEAR(p->v_px, expected[i].y, 1e-10);
    }
  }
}

// cv::fisheye takes points before the camera alone.
TEST(Fisheye, ProjectsAsOpenCvDoes) {
  std::mt19937 random(8);
  std::uniform_real_distribution<double> xy(-3.0, 3.0), depth(0.3, 20.0);
  for (const KannalaBrandtLens& l : test::kFisheyes) {
    const CameraModel c = test::fisheye_camera_with(l);
    std::vector<cv::Point3d> points;
    for (int i = 0; i < 3000; ++i) {
      const double z = depth(random);
      points.emplace_back(xy(random) * z, xy(random) * z, z);
    }
    const cv::Matx33d camera_matrix(c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1);
    const cv::Vec4d coefficients(l.k1, l.k2, l.k3, l.k4);
    std::vector<cv::Point2d> expected;
    cv::fisheye::projectPoints(points, expected, cv::Vec3d(), cv::Vec3d(), camera_matrix, coefficients);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto p = project(c, {points[i].x, points[i].y, points[i].z});
      ASSERT_TRUE(p);
      EXPECT_NEAR(p->u_px, expected[i].x, 1e-10);
      EXPECT_NEAR(p->v_px, expected[i].y, 1e-10);
    }
  }
}

}  // namespace
}  // namespace rigor

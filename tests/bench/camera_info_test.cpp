// CameraInfo from a camera's model, alone and of a stereo pair: a point projected by P and R lies where the
// rectified pictures have it.
#include "bench/sensing/camera_info.h"

#include <gtest/gtest.h>

#include "sim/world/pose.h"

namespace rigor {
namespace {

CameraModel camera(double f_px, double cx_px, double cy_px) {
  CameraModel m;
  m.width_px = 640;
  m.height_px = 480;
  m.fx_px = m.fy_px = f_px;
  m.cx_px = cx_px;
  m.cy_px = cy_px;
  m.lens = {};
  return m;
}

TEST(CameraInfo, NamesTheModelThatTheCoefficientsNeed) {
  CameraModel m = camera(500, 320, 240);
  m.lens.k1 = -0.1;
  m.lens.p2 = 1e-3;
  EXPECT_EQ(camera_info(m).distortion_model, "plumb_bob");
  EXPECT_EQ(camera_info(m).d, (std::vector<double>{-0.1, 0, 0, 1e-3, 0}));
  m.lens.k5 = 0.01;
  EXPECT_EQ(camera_info(m).distortion_model, "rational_polynomial");
  EXPECT_EQ(camera_info(m).d.size(), 8U);
  m.projection = Projection::kannala_brandt;
  EXPECT_EQ(camera_info(m).distortion_model, "equidistant");
  EXPECT_EQ(camera_info(m).d.size(), 4U);
}

TEST(CameraInfo, OfAPairRectifiesBothPictures) {
  const CameraModel left = camera(500, 320, 240), right = camera(510, 318, 243);
  // 12 cm to the right, a little forward and down, turned inwards by 3 degrees and rolled by 1.
  Eigen::Isometry3d T_left_right = Eigen::Isometry3d::Identity();
  T_left_right.translation() << 0.12, 0.003, -0.004;
  T_left_right.linear() = (Eigen::AngleAxisd(-0.052, Eigen::Vector3d::UnitY()) *
                           Eigen::AngleAxisd(0.017, Eigen::Vector3d::UnitZ()))
                              .toRotationMatrix();
  const auto both = stereo_camera_info(left, right, pose_of(T_left_right));
  ASSERT_TRUE(both);
  const auto rectified = [](const record::msg::CameraInfo& info, const Eigen::Vector3d& p) {
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(info.r.data());
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> P(info.p.data());
    EXPECT_NEAR((R * R.transpose() - Eigen::Matrix3d::Identity()).norm(), 0, 1e-12);
    // sensor_msgs/CameraInfo: P projects points of the rectified frame of the left camera.
    return std::pair<Eigen::Vector3d, Eigen::Matrix<double, 3, 4>>(R * p, P);
  };
  for (const Eigen::Vector3d& p_left :
       {Eigen::Vector3d(0, 0, 2), Eigen::Vector3d(-0.7, 0.4, 3), Eigen::Vector3d(1.5, -1, 8)}) {
    const Eigen::Vector3d p_right = T_left_right.inverse() * p_left;
    const auto [q, P_left] = rectified(both->left, p_left);
    const auto [r, P_right] = rectified(both->right, p_right);
    const double f_px = both->left.p[0], baseline_m = T_left_right.translation().norm();
    EXPECT_NEAR(q.z(), r.z(), 1e-12) << "one depth";
    EXPECT_NEAR(q.y(), r.y(), 1e-12) << "one row";
    EXPECT_NEAR(q.x() - r.x(), baseline_m, 1e-12);
    const Eigen::Vector3d u = P_left * q.homogeneous(), v = P_right * q.homogeneous();
    EXPECT_NEAR(u.y() / u.z(), v.y() / v.z(), 1e-9);
    EXPECT_NEAR(u.x() / u.z() - v.x() / v.z(), f_px * baseline_m / q.z(), 1e-9) << "the disparity";
    // Where the right camera's own rectified ray falls by its K part alone.
    EXPECT_NEAR(v.x() / v.z(), f_px * r.x() / r.z() + both->right.p[2], 1e-9);
  }
  EXPECT_FALSE(stereo_camera_info(left, right, Pose{})) << "no baseline";
  EXPECT_FALSE(stereo_camera_info(left, right, Pose{{0, 0, 0.1}, {1, 0, 0, 0}})) << "one behind the other";
}

}  // namespace
}  // namespace rigor

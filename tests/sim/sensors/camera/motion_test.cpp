// When light falls: motion blur and rolling shutter.
#include <cmath>

#include "tests/sim/sensors/camera/plate_world.h"

namespace rigor::test {
namespace {

constexpr double kDepth_m = 2, kSpeed_mps = 3, kExposure_s = 0.08;

/// Variance of light that is spread evenly over a length: length²/12.
double length_px(double blurred, double sharp) { return std::sqrt(12 * (blurred - sharp)); }

TEST_P(CameraOptics, ABodyThatMovesIsBlurredBySpeedTimesExposure) {
  CameraModel m = small_camera();
  const Plate plate{
      {0.05F, 1e-3F, 0.05F}, [](double s) { return at_place(in_front(kSpeed_mps * s, 0, kDepth_m)); }, true};
  world_.add(plate);
  const Spot sharp = spot(shoot(m, fine(), {.exposure_s = kExposure_s}));
  EXPECT_NEAR(sharp.u, 31.5, 0.05);
  m.shutter.motion_blur = true;
  const Spot blurred = spot(shoot(m, fine(), {.exposure_s = kExposure_s}));
  EXPECT_NEAR(blurred.u, 31.5, 0.05) << "the middle of the exposure is t_capture";
  EXPECT_NEAR(blurred.sum, sharp.sum, 0.02 * sharp.sum) << "light is kept";
  const double wanted = kSpeed_mps * kExposure_s * m.fx_px / kDepth_m;
  EXPECT_NEAR(length_px(blurred.variance_u, sharp.variance_u), wanted, 0.04 * wanted);
}

TEST_P(CameraOptics, ASensorThatMovesBlursWhatStands) {
  CameraModel m = small_camera();
  world_.put({0.05F, 1e-3F, 0.05F}, in_front(0, 0, kDepth_m));
  const Spot sharp = spot(shoot(m, fine(), {.exposure_s = kExposure_s}));
  m.shutter.motion_blur = true;
  pose_ = [](BenchTime t) {
    Eigen::Isometry3d T = northward();
    T.translation().x() -= kSpeed_mps * seconds_of(t);
    return T;
  };
  const Spot moved = spot(shoot(m, fine(), {.exposure_s = kExposure_s}));
  const double wanted = kSpeed_mps * kExposure_s * m.fx_px / kDepth_m;
  EXPECT_NEAR(length_px(moved.variance_u, sharp.variance_u), wanted, 0.04 * wanted);
  EXPECT_NEAR(moved.u, 31.5, 0.1);
  constexpr double kRate_radps = 1.5;
  pose_ = [](BenchTime t) {
    Eigen::Isometry3d T = northward();
    T.linear() = Eigen::AngleAxisd(kRate_radps * seconds_of(t), Eigen::Vector3d::UnitZ()).toRotationMatrix() *
                 T.linear();
    return T;
  };
  const Spot turned = spot(shoot(m, fine(), {.exposure_s = kExposure_s}));
  EXPECT_NEAR(length_px(turned.variance_u, sharp.variance_u), kRate_radps * kExposure_s * m.fx_px,
              0.04 * kRate_radps * kExposure_s * m.fx_px);
}

double skew_px_per_row(const std::function<double(int)>& centre_of_row) {
  double vv = 0, uv = 0;
  for (int v = 4; v < 44; ++v) {
    vv += (v - 23.5) * (v - 23.5);
    uv += (v - 23.5) * centre_of_row(v);
  }
  return uv / vv;
}

TEST_P(CameraOptics, ARollingShutterSkewsWhatMoves) {
  CameraModel m = small_camera();
  world_.add(
      {{0.05F, 1e-3F, 3}, [](double s) { return at_place(in_front(kSpeed_mps * s, 0, kDepth_m)); }, true});
  for (const bool blur : {false, true})
    for (const double line_time_s : {0.0, 0.001, 0.002}) {
      m.shutter = {.line_time_s = line_time_s, .motion_blur = blur};
      const OpticsPicture p = shoot(m, fine(), {.exposure_s = 0.01});
      const double skew = skew_px_per_row([&](int v) { return spot(p, 0, v, v + 1).u; });
      EXPECT_NEAR(skew, line_time_s * kSpeed_mps * m.fx_px / kDepth_m, 0.003) << line_time_s << " " << blur;
      EXPECT_NEAR(0.5 * (spot(p, 0, 23, 24).u + spot(p, 0, 24, 25).u), 31.5, 0.1)
          << "the centre row exposes at t_capture";
    }
}

TEST_P(CameraOptics, ARollingShutterSkewsWhatStandsWhereTheSensorTurns) {
  CameraModel m = small_camera();
  m.shutter.line_time_s = 0.002;
  world_.put({0.05F, 1e-3F, 3}, in_front(0, 0, kDepth_m));
  pose_ = [](BenchTime t) {
    Eigen::Isometry3d T = northward();
    T.linear() = Eigen::AngleAxisd(seconds_of(t), Eigen::Vector3d::UnitZ()).toRotationMatrix() * T.linear();
    return T;
  };
  const OpticsPicture p = shoot(m, fine());
  EXPECT_NEAR(skew_px_per_row([&](int v) { return spot(p, 0, v, v + 1).u; }), 0.002 * m.fx_px, 0.003);
}

TEST_P(CameraOptics, TruthKnowsRangeNodeClassNormalAndFlow) {
  CameraModel m = small_camera();
  m.lens = {.k1 = -0.2, .k2 = 0.03};
  m.shutter = {.line_time_s = 0.0005, .motion_blur = true};
  world_.put({2, 1e-3F, 2}, in_front(-2.2, 0, 4));
  const auto plate_pose = [](double s) {
    Eigen::Isometry3d T = at_place(in_front(1.0 + kSpeed_mps * s, 0.2 * s, 2 + 0.7 * s));
    T.linear() = Eigen::AngleAxisd(0.5 + 2 * s, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    return T;
  };
  world_.add({{0.6F, 1e-3F, 3}, plate_pose, true});
  const BenchTime t(1'000'000);
  pose_ = [](BenchTime at) {
    const double s = seconds_of(at);
    Eigen::Isometry3d T = northward();
    T.linear() = Eigen::AngleAxisd(0.8 * s, Eigen::Vector3d::UnitZ()).toRotationMatrix() * T.linear();
    T.translation() += Eigen::Vector3d(0.4, 1.1, -0.3) * s;
    return T;
  };
  GroundTruth truth;
  shoot(m, plain(), {.measure = {.t_capture = t}, .exposure_s = 0.004}, &truth);
  ASSERT_EQ(truth.width, 64U);
  ASSERT_EQ(truth.height, 48U);
  ASSERT_EQ(truth.class_names, (std::vector<std::string>{"", "Plate"}));
  int seen[3] = {0, 0, 0};
  for (int v = 1; v < 48; v += 5)
    for (int u = 1; u < 64; u += 3) {
      const auto i = static_cast<std::size_t>(v * 64 + u);
      const BenchTime row = t + seconds_from((v - 23.5) * 0.0005);
      const Eigen::Isometry3d T = pose_(row);
      const auto ray = unproject_ray(m, {static_cast<double>(u), static_cast<double>(v)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = T.linear() * Eigen::Vector3d(ray->x, ray->y, ray->z);
      const std::uint64_t node = truth.node[i];
      ASSERT_LE(node, 2U);
      ++seen[node];
      Eigen::Vector3d p_before, p_after;
      const double dt = 1e-5;
      const BenchTime before = row - seconds_from(dt), after = row + seconds_from(dt);
      if (node == 0) {
        EXPECT_TRUE(std::isinf(truth.range_m[i]));
        EXPECT_EQ(truth.class_index[i], 0);
        p_before = pose_(before).translation() + 1e9 * d;
        p_after = pose_(after).translation() + 1e9 * d;
      } else {
        EXPECT_EQ(truth.class_index[i], 1);
        const Eigen::Isometry3d plate = world_.T_world_node(NodeId{node}, row);
        // The face towards the camera: a plane 1 mm before the plate's middle.
        const Eigen::Vector3d n = -plate.linear().col(1);
        const double range = n.dot(plate * Eigen::Vector3d(0, -1e-3, 0) - T.translation()) / n.dot(d);
        const Eigen::Vector3d local = plate.inverse() * (T.translation() + range * d);
        if (node == 2 && std::abs(local.x()) > 0.59) continue;  // it may be the plate's narrow side
        EXPECT_NEAR(truth.range_m[i], range, 2e-4 * range) << u << " " << v << " node " << node;
        const Eigen::Vector3d normal = T.linear().transpose() * n;
        for (int k = 0; k < 3; ++k)
          EXPECT_NEAR(truth.normal[3 * i + static_cast<std::size_t>(k)], normal[k], 1e-3);
        p_before = world_.T_world_node(NodeId{node}, before) * local;
        p_after = world_.T_world_node(NodeId{node}, after) * local;
      }
      const auto image = [&](BenchTime at, const Eigen::Vector3d& p) {
        const Eigen::Vector3d q = pose_(at).inverse() * p;
        return *project_ray(m, {q.x(), q.y(), q.z()});
      };
      const auto a = image(before, p_before), b = image(after, p_after);
      const double flow_u = (b.u_px - a.u_px) / (2 * dt), flow_v = (b.v_px - a.v_px) / (2 * dt);
      const double size = std::hypot(flow_u, flow_v) + 1;
      EXPECT_NEAR(truth.flow_px[2 * i], flow_u, 2e-3 * size) << u << " " << v << " node " << node;
      EXPECT_NEAR(truth.flow_px[2 * i + 1], flow_v, 2e-3 * size);
    }
  for (const int n : seen) EXPECT_GT(n, 5);
}

}  // namespace
}  // namespace rigor::test

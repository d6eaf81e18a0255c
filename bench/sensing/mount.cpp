#include "bench/sensing/mount.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "sim/sensors/camera_simulator.h"

namespace rigor {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180;

Eigen::Vector3d vector(const std::vector<double>& v) { return {v[0], v[1], v[2]}; }

}  // namespace

Eigen::Isometry3d read_pose(ConfigNode n, SensorAxes axes,
                            const std::function<double(double, double)>& ground_z_m) {
  const bool above_ground = n.flag_or("above_ground", false);
  if (above_ground && !ground_z_m)
    throw n.error("above_ground", "expected it of a pose in the world, got one in the frame of a node");
  const auto placed = [&](const char* key) {
    Eigen::Vector3d p = vector(n.numbers(key, 3));
    if (!above_ground) return p;
    const double z = ground_z_m(p.x(), p.y());
    if (!std::isfinite(z))
      throw n.error(key, fmt::format("expected a place on the terrain, got {:g}, {:g}, where there is none; "
                                     "`rigor world info` says how far it reaches",
                                     p.x(), p.y()));
    p.z() += z;
    return p;
  };
  const Eigen::Vector3d position = placed("position_m");
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  const int ways = int{n.has("look_at_m")} + int{n.has("quaternion_wxyz")} + int{n.has("roll_pitch_yaw_deg")};
  if (ways > 1)
    throw n.error("", "expected one of look_at_m, quaternion_wxyz and roll_pitch_yaw_deg, got several");
  if (n.has("look_at_m")) {
    const Eigen::Vector3d target = placed("look_at_m");
    const Eigen::Vector3d up = n.has("up") ? vector(n.numbers("up", 3)) : Eigen::Vector3d::UnitZ();
    if ((target - position).cross(up).norm() < 1e-9)
      throw n.error(
          "look_at_m",
          "expected a point that is neither the position nor straight along `up` from it; give another `up`");
    pose = look_at(position, target, up);
    if (axes == SensorAxes::forward) {
      Eigen::Matrix3d optical_of_forward;  // x forward, y left, z up in optical axes
      optical_of_forward << 0, -1, 0, 0, 0, -1, 1, 0, 0;
      pose.linear() = pose.linear() * optical_of_forward;
    }
  } else if (n.has("roll_pitch_yaw_deg")) {
    const Eigen::Vector3d rpy = vector(n.numbers("roll_pitch_yaw_deg", 3)) * kRadPerDeg;
    pose.linear() = (Eigen::AngleAxisd(rpy.z(), Eigen::Vector3d::UnitZ()) *
                     Eigen::AngleAxisd(rpy.y(), Eigen::Vector3d::UnitY()) *
                     Eigen::AngleAxisd(rpy.x(), Eigen::Vector3d::UnitX()))
                        .toRotationMatrix();
    pose.translation() = position;
  } else {
    const std::vector<double> q = n.numbers("quaternion_wxyz", 4);
    const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
    if (std::abs(rotation.norm() - 1) > 1e-3)
      throw n.error("quaternion_wxyz",
                    fmt::format("expected a quaternion of length 1, got length {:.6g}", rotation.norm()));
    pose.linear() = rotation.normalized().toRotationMatrix();
    pose.translation() = position;
  }
  n.finish();
  return pose;
}

Mount read_mount(ConfigNode params, const SensorWorld& world, SensorAxes axes) {
  Mount m;
  const bool carried = params.has("parent");
  m.T_parent_sensor =
      carried ? read_pose(params.map("T_parent_sensor"), axes)
              : read_pose(params.map("T_world_sensor"), axes,
                          [&world](double x_m, double y_m) { return world.ground_z_m(x_m, y_m); });
  if (carried) {
    const auto body = world.platform_named(params.text("parent"));
    const auto node = world.frame_named(params.text("parent"));
    if (!body && !node) throw params.error("parent", node.error().message);
    if (body)
      m.body = static_cast<int>(*body);
    else
      m.parent = *node;
  }
  if (const ConfigNode motion = params.map_or_absent("motion"); motion.present()) {
    m.velocity_m_per_s = vector(motion.numbers_or("velocity_m_per_s", {0, 0, 0}));
    m.yaw_rate_radps = motion.number_or("yaw_rate_deg_per_s", 0, {.min = -36000, .max = 36000}) * kRadPerDeg;
    motion.finish();
  }
  return m;
}

Eigen::Isometry3d Mount::at(Duration since_start) const {
  if (!moves()) return T_parent_sensor;
  const double t_s = since_start.seconds(), turn = yaw_rate_radps * t_s;
  // The integral of Rz(ω s) over s from 0 to t: sin and 1 − cos over ω, by their series where ω t is small.
  const double along = std::abs(turn) < 1e-6 ? t_s * (1 - turn * turn / 6) : std::sin(turn) / yaw_rate_radps;
  const double across = std::abs(turn) < 1e-6 ? t_s * turn / 2 : (1 - std::cos(turn)) / yaw_rate_radps;
  const Eigen::Vector3d& v = velocity_m_per_s;
  Eigen::Isometry3d pose = T_parent_sensor;
  pose.translation() +=
      Eigen::Vector3d(along * v.x() - across * v.y(), across * v.x() + along * v.y(), t_s * v.z());
  pose.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()) * T_parent_sensor.linear();
  return pose;
}

render::PoseFunction Mount::T_world_sensor(const SensorWorld::Moment& world, BenchTime t_start) const {
  return [mount = *this, &world, t_start](BenchTime t) {
    const Eigen::Isometry3d T_parent = mount.at(t - t_start);
    if (mount.T_world_carrier) return *mount.T_world_carrier * T_parent;
    if (mount.body >= 0) return world.T_world_platform(static_cast<std::size_t>(mount.body), t) * T_parent;
    return mount.parent ? world.T_world_node(mount.parent, t) * T_parent : T_parent;
  };
}

}  // namespace rigor

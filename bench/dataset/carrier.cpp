#include "bench/dataset/carrier.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "sim/platform/ground.h"
#include "sim/world/pose.h"

namespace rigor::dataset {
namespace {

/// A level frame at the sensor's place that looks its way.
Eigen::Isometry3d level_frame(const Eigen::Isometry3d& T_world_sensor, SampleKind kind) {
  const bool optical = kind != SampleKind::point_cloud;
  Eigen::Vector3d forward =
      T_world_sensor.linear() * (optical ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX());
  if (forward.head<2>().norm() < 1e-6)  // straight up or down: where the upper edge of the picture looks
    forward = T_world_sensor.linear() * (optical ? Eigen::Vector3d(0, -1, 0) : Eigen::Vector3d::UnitY());
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() =
      Eigen::AngleAxisd(std::atan2(forward.y(), forward.x()), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = T_world_sensor.translation();
  return T;
}

/// Wheels of any vehicle that is about a metre long, for its tilt on a slope.
constexpr std::array<std::array<double, 2>, 4> kWheels_m{
    {{0.4, 0.3}, {0.4, -0.3}, {-0.4, 0.3}, {-0.4, -0.3}}};

}  // namespace

Result<Carrier> Carrier::of(const std::vector<MountedChannel>& channels, Simulation& simulation) {
  Carrier c;
  bool first = true;
  for (const MountedChannel& channel : channels) {
    auto mount = catch_config([&] {
      return read_mount(channel.params, simulation.world(),
                        channel.kind == SampleKind::point_cloud ? SensorAxes::forward : SensorAxes::optical);
    });
    if (!mount) return tl::unexpected<Error>(mount.error());
    std::string platform;
    if (channel.params.has("parent")) {
      const std::string parent = channel.params.text("parent");
      for (const WorldPlatform& p : simulation.platforms())
        if (parent == p.name || parent.starts_with(p.name + ".")) platform = p.name;
      if (platform.empty())
        return tl::unexpected<Error>(
            channel.params
                .error("parent",
                       fmt::format("expected a platform, or T_world_sensor in place of it, got {}, a node of "
                                   "the world that the poses of a dataset do not move; leave this channel "
                                   "away with `channels`",
                                   parent))
                .error());
    }
    if (!first && platform != c.platform_)
      return tl::unexpected<Error>(
          channel.params
              .error("", fmt::format(
                             "expected channels that one carrier has, got {} on {} and {} on {}; choose with "
                             "`channels`",
                             channels.front().name, c.platform_.empty() ? "none" : c.platform_, channel.name,
                             platform.empty() ? "none" : platform))
              .error());
    c.platform_ = platform;
    first = false;
    c.mounts_.push_back(std::move(*mount));
  }
  const WorldMotion rest = simulation.motion_at_rest();
  if (!c.platform_.empty()) {
    const auto body = simulation.platform(c.platform_);
    if (!body) return tl::unexpected<Error>(body.error());
    c.body_ = *body;
    c.T_world_rig_ = isometry_of(rest.body[c.body_].T_world_body);
    for (const Mount& m : c.mounts_)
      c.T_carrier_sensor_.push_back(c.T_world_rig_.inverse() * simulation.T_world_sensor(m, rest));
    return c;
  }
  c.T_world_rig_ = level_frame(c.mounts_.front().T_parent_sensor, channels.front().kind);
  const double ground_m = simulation.world().ground().height_m(c.T_world_rig_.translation().x(),
                                                               c.T_world_rig_.translation().y());
  c.height_m_ = c.T_world_rig_.translation().z() - (std::isfinite(ground_m) ? ground_m : 0);
  c.T_world_carrier_ = std::make_shared<Eigen::Isometry3d>(c.T_world_rig_);
  for (Mount& m : c.mounts_) {
    m.T_parent_sensor = c.T_world_rig_.inverse() * m.T_parent_sensor;
    m.velocity_m_per_s = c.T_world_rig_.linear().transpose() * m.velocity_m_per_s;
    m.T_world_carrier = c.T_world_carrier_;
    c.T_carrier_sensor_.push_back(m.T_parent_sensor);
  }
  return c;
}

Eigen::Isometry3d Carrier::stand(const WantedPose& wanted, const Ground& ground) const {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = wanted.R;
  T.translation() = Eigen::Vector3d(wanted.x_m, wanted.y_m, wanted.z_m.value_or(0));
  if (wanted.z_m) return T;
  if (platform_.empty()) {
    T.translation().z() = ground.height_m(wanted.x_m, wanted.y_m) + wanted.height_m.value_or(height_m_);
    return T;
  }
  std::array<Eigen::Vector2d, kWheels_m.size()> wheels;
  for (std::size_t i = 0; i < wheels.size(); ++i) wheels[i] = {kWheels_m[i][0], kWheels_m[i][1]};
  const double yaw_rad = std::atan2(wanted.R(1, 0), wanted.R(0, 0));
  const Footprint::Stand stand = Footprint(wheels).stand(ground, wanted.x_m, wanted.y_m, yaw_rad);
  const Eigen::AngleAxisd yaw(yaw_rad, Eigen::Vector3d::UnitZ());
  T.linear() = yaw * Eigen::AngleAxisd(stand.pitch_rad, Eigen::Vector3d::UnitY()) *
               Eigen::AngleAxisd(stand.roll_rad, Eigen::Vector3d::UnitX()) * yaw.inverse() * wanted.R;
  T.translation().z() = stand.z_m + wanted.height_m.value_or(0);
  return T;
}

void Carrier::move(const Eigen::Isometry3d& T_world_carrier, WorldMotion& motion) const {
  if (platform_.empty())
    *T_world_carrier_ = T_world_carrier;
  else
    motion.body[body_].T_world_body = pose_of(T_world_carrier);
}

}  // namespace rigor::dataset

#include "bench/sensing/inertial.h"

#include <fmt/format.h>

#include <cmath>

#include "bench/sensing/mount.h"
#include "bench/sensing/sensor_model_kind.h"
#include "sensor-hal/config/value_or_throw.h"
#include "sensor-hal/models/gnss/gnss_yaml.h"
#include "sensor-hal/models/imu/imu_yaml.h"
#include "sensor-hal/models/odometry/odometry_yaml.h"
#include "sim/sensors/inertial/inertial_simulators.h"
#include "sim/world/pose.h"

namespace rigor {
namespace {

std::array<double, 3> array(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

/// A mount that moves by itself, as the motion of a body: its velocity turns with it about z.
BodyState body_of(const Mount& mount, BenchTime t_start, BenchTime t) {
  const Duration since_start = t - t_start;
  const Eigen::Vector3d turn(0, 0, mount.yaw_rate_radps);
  const Eigen::Isometry3d T = mount.at(since_start);
  const Eigen::Vector3d v =
      Eigen::AngleAxisd(turn.z() * since_start.seconds(), Eigen::Vector3d::UnitZ()) * mount.velocity_m_per_s;
  BodyState b;
  b.t_ref = t;
  b.T_world_body = pose_of(T);
  b.velocity_mps = array(v);
  b.acceleration_mps2 = array(turn.cross(v));
  b.turn_rate_radps = array(T.linear().transpose() * turn);
  return b;
}

/// Poses of what turns with a node of the world, or moves on a platform, are differentiated over this.
constexpr Duration kHalfStep = milliseconds(5);

/// Whether a mount's way is known from the world alone, which takes a lock.
bool asks_the_world(const Mount& mount) { return mount.parent || (mount.body >= 0 && mount.moves()); }

Carrier carrier_of(const Mount& mount, SensorWorld& world) {
  if (mount.body < 0 && !asks_the_world(mount))
    return [mount](const SampleProvider::Request& request, BenchTime t) {
      return carried_by(body_of(mount, request.t_start, t), t, Eigen::Isometry3d::Identity());
    };
  if (mount.body >= 0 && !asks_the_world(mount))
    return [body = static_cast<std::size_t>(mount.body), T = mount.T_parent_sensor](
               const SampleProvider::Request& request, BenchTime t) {
      return body < request.motion.body_count ? carried_by(request.motion.body[body], t, T)
                                              : SensorKinematics{};
    };
  return [mount, &world](const SampleProvider::Request& request, BenchTime t) {
    SensorWorld::Moment moment(world, request.motion);
    const render::PoseFunction pose = mount.T_world_sensor(moment, request.t_start);
    return differentiated(pose(t - kHalfStep), pose(t), pose(t + kHalfStep), kHalfStep.seconds());
  };
}

/// Of the channel, else of the world's Place; none where neither says.
std::optional<GeoOrigin> origin_of(const ConfigNode& params, const SensorWorld& world) {
  if (ConfigNode n = params.map_or_absent("origin"); n.present()) {
    GeoOrigin o;
    o.latitude_deg = n.number("latitude_deg", {.min = -90, .max = 90});
    o.longitude_deg = n.number("longitude_deg", {.min = -360, .max = 360});
    o.height_m = n.number_or("height_m", 0, {.min = -12000, .max = 1e6});
    n.finish();
    return o;
  }
  const world::Snapshot w = world.snapshot();
  const world::types::Place place(w.schema());
  const auto nodes = w.nodes(place.type);
  if (nodes.empty()) return std::nullopt;
  return GeoOrigin{*w.get(nodes[0], place.latitude_deg), *w.get(nodes[0], place.longitude_deg),
                   *w.get(nodes[0], place.height_m)};
}

WheelSource wheels_of(const ConfigNode& params, const InertialSetup& setup,
                      const models::OdometryModel& model, const SensorWorld& world) {
  const int ways = int{params.has("platform")} + int{params.has("wheels")} + int{params.has("motion")};
  if (ways != 1)
    throw params.error("", fmt::format("expected one of platform, wheels and motion, got {}",
                                       ways == 0 ? "none" : "several"));
  if (params.has("motion")) {
    const Mount mount = read_mount(params, world, SensorAxes::forward);
    // Forward is x of the mount, in whose frame the wheels go.
    const Eigen::Vector3d forward = mount.T_parent_sensor.linear().col(0);
    return wheels_of_motion(model, forward.dot(mount.velocity_m_per_s), mount.yaw_rate_radps);
  }
  const auto joint = [&](const ConfigNode& n, const char* key, const std::string& name) {
    const auto index = setup.joint(name);
    if (!index) throw n.error(key, index.error().message);
    return *index;
  };
  if (params.has("platform")) {
    const std::string name = params.text("platform");
    return wheels_of_joints(joint(params, "platform", name + ".left"),
                            joint(params, "platform", name + ".right"));
  }
  const ConfigNode n = params.map("wheels");
  const std::size_t left = joint(n, "left", n.text("left")), right = joint(n, "right", n.text("right"));
  n.finish();
  return wheels_of_joints(left, right);
}

}  // namespace

bool is_inertial(SampleKind kind) {
  return kind == SampleKind::imu || kind == SampleKind::nav_fix || kind == SampleKind::odometry;
}

Result<std::shared_ptr<SampleProvider>> make_inertial(SampleKind kind, const ConfigNode& params,
                                                      const InertialSetup& setup, SensorWorld& world) {
  auto made = catch_config([&]() -> std::shared_ptr<SampleProvider> {
    expect_sensor_model(params, kind);
    const std::filesystem::path file = params.base_dir() / params.text("sensor");
    InertialSpec spec{setup.name, setup.seed, setup.period, setup.ideal};
    if (kind == SampleKind::odometry) {
      const auto model = value_or_throw(load_odometry_model(file));
      return std::make_shared<OdometrySimulator>(spec, model, wheels_of(params, setup, model, world));
    }
    const Mount mount = read_mount(params, world, SensorAxes::forward);
    const Carrier carrier = carrier_of(mount, world);
    spec.immediate = !asks_the_world(mount);
    const std::optional<GeoOrigin> origin = origin_of(params, world);
    if (kind == SampleKind::imu) {
      const auto model = value_or_throw(load_imu_model(file));
      const Earth earth = params.has("gravity_mps2")
                              ? Earth(origin, params.number("gravity_mps2", {.min = 0, .max = 100}))
                              : Earth(origin);
      return std::make_shared<ImuSimulator>(spec, model, earth, carrier);
    }
    const auto model = value_or_throw(load_gnss_model(file));
    if (!origin)
      throw params.error("",
                         "expected `origin: { latitude_deg, longitude_deg, height_m }`: the world does "
                         "not say where on the Earth it lies");
    const double canopy = params.number_or("canopy", 0, {.min = 0, .max = 1});
    return std::make_shared<GnssSimulator>(spec, model, *origin, carrier,
                                           [canopy](const Eigen::Vector3d&) { return canopy; });
  });
  if (!made) return tl::unexpected<Error>(made.error());
  return *made;
}

}  // namespace rigor

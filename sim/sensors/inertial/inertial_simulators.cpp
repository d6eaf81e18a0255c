#include "sim/sensors/inertial/inertial_simulators.h"

#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>
#include <limits>

namespace rigor {
namespace {

using models::channel_id_from_name;
using models::channel_key;

models::PhiloxKey key_of(const InertialSpec& spec) {
  return channel_key(spec.seed, channel_id_from_name(spec.name));
}
std::array<double, 3> array(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

models::ImuModel without_errors(const models::ImuModel& m) {
  models::ImuModel ideal;
  ideal.name = m.name;
  ideal.earth_rate = m.earth_rate;
  ideal.tells_temperature = m.tells_temperature;
  ideal.ambient_c = m.ambient_c;
  ideal.warm_up_k = m.warm_up_k;
  ideal.warm_up_time_s = m.warm_up_time_s;
  return ideal;
}
models::GnssModel without_errors(const models::GnssModel& m) {
  models::GnssModel ideal;
  ideal.name = m.name;
  ideal.status = m.status;
  ideal.satellites = m.satellites;
  ideal.antenna_m = m.antenna_m;
  return ideal;
}
models::OdometryModel without_errors(models::OdometryModel m) {
  m.radius_error = {};
  m.track_error = m.radius_error_sigma = m.track_error_sigma = m.ticks_per_turn = 0;
  return m;
}

}  // namespace

ImuSimulator::ImuSimulator(const InertialSpec& spec, const models::ImuModel& model, const Earth& earth,
                           Carrier carrier)
    : name_(spec.name),
      immediate_(spec.immediate),
      errors_(spec.ideal ? without_errors(model) : model, key_of(spec), spec.period),
      earth_(earth),
      carrier_(std::move(carrier)) {}

SampleProvider::Geometry ImuSimulator::geometry() const { return {SampleKind::imu, 0, 0, 0, name_}; }

Status ImuSimulator::capture(const Request& request, Sample& sample) {
  const models::ImuModel& device = errors_.device();
  const SensorKinematics k = carrier_(request, request.t_capture - seconds_from(device.delay_s));
  const Eigen::Matrix3d R = k.T_world_sensor.linear();
  const Eigen::Vector3d force =
      R.transpose() * (k.acceleration_mps2 - earth_.gravity_mps2(k.T_world_sensor.translation()));
  Eigen::Vector3d rate = k.rate_radps;
  if (device.earth_rate) rate += R.transpose() * earth_.rate_radps();
  sample.info = errors_.measure(request.index, (request.t_capture - request.t_start).seconds(), array(force),
                                array(rate));
  sample.size_bytes = 0;
  return {};
}

GnssSimulator::GnssSimulator(const InertialSpec& spec, const models::GnssModel& model,
                             const GeoOrigin& origin, Carrier carrier,
                             std::function<double(const Eigen::Vector3d&)> canopy)
    : name_(spec.name),
      immediate_(spec.immediate),
      errors_(spec.ideal ? without_errors(model) : model, key_of(spec), spec.period),
      frame_(std::make_unique<const GeographicLib::LocalCartesian>(origin.latitude_deg, origin.longitude_deg,
                                                                   origin.height_m)),
      carrier_(std::move(carrier)),
      canopy_(std::move(canopy)) {}

GnssSimulator::~GnssSimulator() = default;

SampleProvider::Geometry GnssSimulator::geometry() const { return {SampleKind::nav_fix, 0, 0, 0, name_}; }

Status GnssSimulator::capture(const Request& request, Sample& sample) {
  const models::GnssModel& model = errors_.model();
  const SensorKinematics k = carrier_(request, request.t_capture - seconds_from(model.delay_s));
  const Eigen::Vector3d p =
      k.T_world_sensor * Eigen::Vector3d(model.antenna_m[0], model.antenna_m[1], model.antenna_m[2]);
  const models::GnssError e =
      errors_.at(request.index, (request.t_capture - request.t_start).seconds(), canopy_ ? canopy_(p) : 0);
  NavFix fix;
  fix.status = e.status;
  fix.satellites = e.satellites;
  if (e.status == FixStatus::none) {
    fix.latitude_deg = fix.longitude_deg = fix.height_m = std::numeric_limits<double>::quiet_NaN();
  } else {
    double latitude = 0, longitude = 0, height = 0;
    frame_->Reverse(p.x(), p.y(), p.z(), latitude, longitude, height);
    // Errors are along east, north and up where the antenna is, not where the world's origin is.
    const GeographicLib::LocalCartesian here(latitude, longitude, height);
    here.Reverse(e.enu_m[0], e.enu_m[1], e.enu_m[2], fix.latitude_deg, fix.longitude_deg, fix.height_m);
    for (std::size_t i = 0; i < 3; ++i)
      fix.covariance_enu_m2[4 * i] = e.claimed_sigma_enu_m[i] * e.claimed_sigma_enu_m[i];
  }
  sample.info = fix;
  sample.size_bytes = 0;
  return {};
}

WheelSource wheels_of_joints(std::size_t left, std::size_t right) {
  return [joints = std::array{left, right}](const SampleProvider::Request& request) {
    models::OdometryDevice::Wheels w;
    for (std::size_t i = 0; i < 2; ++i) {
      if (joints[i] >= request.motion.count) continue;
      const JointState& j = request.motion.joint[joints[i]];
      w.angle_rad[i] = j.at(request.t_capture);
      w.rate_radps[i] = j.rate_at(request.t_capture);
    }
    return w;
  };
}

WheelSource wheels_of_motion(const models::OdometryModel& model, double forward_mps, double turn_radps) {
  const double across = turn_radps * model.track_m / 2;
  const std::array<double, 2> rate_radps{(forward_mps - across) / model.wheel_radius_m,
                                         (forward_mps + across) / model.wheel_radius_m};
  return [rate_radps](const SampleProvider::Request& request) {
    const double t_s = (request.t_capture - request.t_start).seconds();
    return models::OdometryDevice::Wheels{{rate_radps[0] * t_s, rate_radps[1] * t_s}, rate_radps};
  };
}

OdometrySimulator::OdometrySimulator(const InertialSpec& spec, const models::OdometryModel& model,
                                     WheelSource wheels)
    : name_(spec.name),
      immediate_(spec.immediate),
      device_(spec.ideal ? without_errors(model) : model, key_of(spec), spec.period),
      wheels_(std::move(wheels)) {}

SampleProvider::Geometry OdometrySimulator::geometry() const {
  return {SampleKind::odometry, 0, 0, 0, name_};
}

Status OdometrySimulator::capture(const Request& request, Sample& sample) {
  sample.info = device_.measure(request.index, request.t_start, wheels_(request));
  sample.size_bytes = 0;
  return {};
}

}  // namespace rigor

// Simulated inertial units, satellite receivers and odometry as providers. Where the sensor is and how it
// moves comes from a Carrier (a body of the request's WorldMotion, or a mount that moves by itself); the
// models' errors are keyed by seed, name and capture index.
//
// Same request, same bytes, except for the pose of odometry, which adds up what was captured before
// (odometry_model.h). One thread at a time, no allocation; about a microsecond a sample.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "sensor-hal/models/gnss/gnss_model.h"
#include "sensor-hal/models/imu/imu_model.h"
#include "sensor-hal/models/odometry/odometry_model.h"
#include "sim/sensors/inertial/kinematics.h"

namespace GeographicLib {
class LocalCartesian;
}

namespace rigor {

struct InertialSpec {
  std::string name;  ///< keys the noise, with the seed
  std::uint64_t seed = 0;
  Duration period;        ///< between captures, > 0
  bool ideal = false;     ///< without the model's errors and delay
  bool immediate = true;  ///< the carrier neither allocates nor locks
};

class ImuSimulator final : public SampleProvider {
 public:
  ImuSimulator(const InertialSpec& spec, const models::ImuModel& model, const Earth& earth, Carrier carrier);
  [[nodiscard]] Geometry geometry() const override;
  [[nodiscard]] bool immediate() const override { return immediate_; }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override;

 private:
  std::string name_;
  bool immediate_;
  models::ImuErrors errors_;
  Earth earth_;
  Carrier carrier_;
};

class GnssSimulator final : public SampleProvider {
 public:
  /// `canopy`: share of the sky that trees cover above a place of the world, 0 to 1; may be empty: none.
  GnssSimulator(const InertialSpec& spec, const models::GnssModel& model, const GeoOrigin& origin,
                Carrier carrier, std::function<double(const Eigen::Vector3d& p_world)> canopy = {});
  ~GnssSimulator() override;
  [[nodiscard]] Geometry geometry() const override;
  [[nodiscard]] bool immediate() const override { return immediate_; }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override;

 private:
  std::string name_;
  bool immediate_;
  models::GnssErrors errors_;
  std::unique_ptr<const GeographicLib::LocalCartesian> frame_;
  Carrier carrier_;
  std::function<double(const Eigen::Vector3d&)> canopy_;
};

/// Angles and rates of the wheels at a request's t_capture.
using WheelSource = std::function<models::OdometryDevice::Wheels(const SampleProvider::Request&)>;
/// Joints of a WorldMotion, left and right; a joint that a motion does not have stands at zero.
[[nodiscard]] WheelSource wheels_of_joints(std::size_t left, std::size_t right);
/// Of a vehicle that goes and turns evenly, on ideal wheels of the model's size.
[[nodiscard]] WheelSource wheels_of_motion(const models::OdometryModel& model, double forward_mps,
                                           double turn_radps);

class OdometrySimulator final : public SampleProvider {
 public:
  OdometrySimulator(const InertialSpec& spec, const models::OdometryModel& model, WheelSource wheels);
  [[nodiscard]] Geometry geometry() const override;
  [[nodiscard]] bool immediate() const override { return immediate_; }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override;

 private:
  std::string name_;
  bool immediate_;
  models::OdometryDevice device_;
  WheelSource wheels_;
};

}  // namespace rigor

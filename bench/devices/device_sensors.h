// A device of a rig's emulators that measures how it moves and tells of it on a bus: an inertial unit, a
// satellite receiver, a controller that counts its wheels' ticks.
//
//   emulators:
//     sensors:
//       backend: can                      # or modbus
//       sensors:
//         odometry: { kind: odometry, sensor: ../sensors/odometry-skid-steer.yaml, platform: robot, rate_hz:
//         50 } imu:      { kind: imu, sensor: ../sensors/imu-mems.yaml, parent: robot, T_parent_sensor: {…},
//         rate_hz: 100 } gnss:     { kind: nav_fix, sensor: ../sensors/gnss-single.yaml, parent: robot,
//         origin: {…}, rate_hz: 1 }
//
// The keys are those of simulated channels (sensing/inertial.h). Its values have the names of typed_values.h:
// as signals by these names, and as input registers from 0 on in the order of the list, each an f64 in four
// registers (ABCD).
//
// Whoever reads gets what is measured at that instant; `rate_hz` is the rate at which the errors of the
// sensor go on, and its numbering begins with the first reading.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include "rt-core/period.h"
#include "rt-core/result.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Makes the sensor that the keys ask for: (kind, keys, name, period).
using InertialMaker = std::function<Result<std::shared_ptr<SampleProvider>>(
    SampleKind kind, const ConfigNode& n, const std::string& name, Duration period)>;

class DeviceSensors final : public SignalModel, public RegisterModel {
 public:
  /// `params`: the emulator's keys, with `sensors`. Draws are keyed by `name` and the sensor's. bad_input
  /// with place.
  [[nodiscard]] static Result<std::shared_ptr<DeviceSensors>> make(const ConfigNode& params,
                                                                   const std::string& name,
                                                                   std::shared_ptr<const MotionSource> motion,
                                                                   const InertialMaker& make_sensor);

  [[nodiscard]] const std::vector<Signal>& signals() const override { return signals_; }
  [[nodiscard]] double read(std::size_t signal, BenchTime t) override;
  [[nodiscard]] bool write(std::size_t, double, BenchTime) override { return false; }
  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override;
  [[nodiscard]] bool write(RegisterTable, std::uint16_t, std::span<const std::uint16_t>, BenchTime) override {
    return false;
  }

 private:
  struct Sensor {
    std::shared_ptr<SampleProvider> provider;
    Period period;
    std::size_t first = 0, count = 0;  ///< of its signals
    BenchTime t_start, t;              ///< of the first reading, of the last
    bool begun = false;
    std::vector<double> values;
  };
  [[nodiscard]] double value(std::size_t signal, BenchTime t);

  std::shared_ptr<const MotionSource> motion_;
  std::vector<Sensor> sensors_;
  std::vector<std::size_t> sensor_of_;  ///< by signal
  std::vector<Signal> signals_;
  std::mutex mutex_;  ///< a device may be on a bus twice
};

}  // namespace rigor

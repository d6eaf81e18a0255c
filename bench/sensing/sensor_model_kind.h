// Which kind of sensor a sensor model describes, and the complaint about a sensor model on a channel of
// another kind.
#pragma once

#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Of the sensor model that `sensor` names: LiDARs have a `scan`, time-of-flight cameras a `modulation`,
/// inertial units an `accelerometer`, satellite receivers a `status`, odometry a `wheel_radius_m`, cameras
/// none of these. Throws ConfigError.
[[nodiscard]] SampleKind kind_of_sensor_model(const ConfigNode& params);
/// Throws a ConfigError that names both kinds when the sensor model is of another one than a channel of this
/// kind takes.
void expect_sensor_model(const ConfigNode& params, SampleKind kind);

}  // namespace rigor

// Which kind of sensor a sheet describes, and the complaint about a sheet on a channel of another kind.
#pragma once

#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Of the sheet that `sensor` names: LiDARs have a `scan`, time-of-flight cameras a `modulation`, inertial
/// units an `accelerometer`, satellite receivers a `status`, odometry a `wheel_radius_m`, cameras none of
/// these. Throws ConfigError.
[[nodiscard]] SampleKind kind_of_sheet(const ConfigNode& params);
/// Throws a ConfigError that names both kinds when the sheet is of another one than a channel of this kind
/// takes.
void expect_sheet(const ConfigNode& params, SampleKind kind);

}  // namespace rigor

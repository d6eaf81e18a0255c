// The name under which rigs find Ouster's sensors.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend ouster_backend();

}  // namespace rigor

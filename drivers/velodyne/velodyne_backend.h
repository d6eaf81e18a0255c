// Velodyne VLP-16 and HDL-32E, for the registry: source, emulator, stand-in for virtual time, discovery,
// doctor.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend velodyne_backend();

}  // namespace rigor

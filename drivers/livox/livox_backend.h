// Livox Mid-360, for the registry: source, emulator, stand-in for virtual time, discovery, doctor.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend livox_backend();

}  // namespace rigor

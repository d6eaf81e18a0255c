// The backends that this build of Rigor has, in one registry.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {
[[nodiscard]] Registry make_registry();
}

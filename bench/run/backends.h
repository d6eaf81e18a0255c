// The backends and applications that come with Rigor, in one registry.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {
[[nodiscard]] Registry make_registry();
}

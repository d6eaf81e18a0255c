// Video devices (V4L2) by name: `backend: v4l2`.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend v4l2_backend();

}  // namespace rigor

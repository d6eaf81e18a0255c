// `backend: sick`: SICK LMS1xx, LMS5xx and TiM by CoLa-B over TCP.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend sick_backend();

}  // namespace rigor

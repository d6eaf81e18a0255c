// The backend `gnss`: satellite receivers by NMEA 0183 and UBX.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend gnss_backend();

}  // namespace rigor

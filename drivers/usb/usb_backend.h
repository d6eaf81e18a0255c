// `backend: usb`.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {
/// Hokuyo scanners (`protocol: scip`) and frames from a bulk endpoint (`protocol: bulk`): sources over
/// libusb, terminals and sockets, emulators, and what stands for them in virtual time.
[[nodiscard]] Backend usb_backend();
}  // namespace rigor

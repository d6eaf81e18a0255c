// Channels and emulators that become what their key `protocol` names.
#pragma once

#include "drivers/usb/bulk_emulator.h"
#include "drivers/usb/scip_virtual_source.h"

namespace rigor::usb {

[[nodiscard]] std::unique_ptr<Source> make_usb_source(LinkFactory links);
[[nodiscard]] std::unique_ptr<Source> make_usb_virtual_source(DeviceParts parts, ConfigNode emulator_params);
[[nodiscard]] std::unique_ptr<Emulator> make_usb_emulator();

}  // namespace rigor::usb

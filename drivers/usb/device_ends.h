// The serial port of a USB gadget as the end of an emulated device, beside those of drivers/serial.
#pragma once

#include "drivers/serial/device_end.h"
#include "drivers/usb/usb_gadget.h"

namespace rigor::usb {

using serial::DeviceEnd;
using serial::make_pty_end;
using serial::make_tcp_end;
using serial::put_bytes;

[[nodiscard]] std::unique_ptr<DeviceEnd> make_gadget_end(GadgetSettings settings);

}  // namespace rigor::usb

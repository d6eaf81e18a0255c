// Where the bytes of an emulated device leave: a pseudo-terminal, a socket, a gadget's serial port.
#pragma once

#include <sys/types.h>

#include "drivers/usb/scip_emulator.h"
#include "drivers/usb/usb_gadget.h"

namespace rigor::usb {

/// `link`: a symbolic link of that name is made (one that is there is replaced, anything else is refused).
[[nodiscard]] std::unique_ptr<DeviceEnd> make_pty_end(std::string link);
/// Serves one client; others wait in the queue of the socket, as at the scanner.
[[nodiscard]] std::unique_ptr<DeviceEnd> make_tcp_end(std::string address, std::uint16_t port);
[[nodiscard]] std::unique_ptr<DeviceEnd> make_gadget_end(GadgetSettings settings);

/// As write(2), without the signal of a socket whose other end has closed.
[[nodiscard]] ssize_t put_bytes(int fd, const char* bytes, std::size_t count) noexcept;

}  // namespace rigor::usb

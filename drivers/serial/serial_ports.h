// The serial ports of this machine, and what keeps this user from opening them.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sensor-hal/channel/registry.h"

namespace rigor::serial {

struct SerialPort {
  std::string path;         ///< "/dev/ttyUSB0"
  std::string stable_path;  ///< a link under /dev/serial/by-id, which survives replugging; may be empty
  std::string driver;       ///< "ftdi_sio"
  bool permitted = false;   ///< this user may read and write it
  std::string holder;       ///< a program that has it open, as far as this user may see; empty: none
};

/// Ports of USB adapters, and those of the board that have hardware behind them, by name. `sys` and `dev`
/// stand for /sys/class/tty and /dev. Setup.
[[nodiscard]] std::vector<SerialPort> list_serial_ports(const std::filesystem::path& sys = "/sys/class/tty",
                                                        const std::filesystem::path& dev = "/dev");

/// What `rigor doctor` says of these ports.
[[nodiscard]] std::vector<DoctorFinding> serial_findings(const std::vector<SerialPort>& ports);

}  // namespace rigor::serial

namespace rigor {
/// Serial ports for `rigor devices` and `rigor doctor`: a transport of other backends, without channels of
/// its own.
[[nodiscard]] Backend serial_backend();
}  // namespace rigor

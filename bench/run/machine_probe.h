// `rigor doctor`: what all drivers together need of a machine: socket and USB buffers, membership in groups,
// kernel modules, udev rules. Only reads; says what is missing with the command that mends it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sensor-hal/channel/registry.h"

namespace rigor {

/// A machine as seen by one user. Tests give a root of their own.
struct Machine {
  std::filesystem::path root = "/";  ///< /proc, /sys, /lib/modules and the udev rules are looked for below it
  std::filesystem::path
      install_dir;             ///< holds udev/60-rigor.rules and sysctl/60-rigor-sysctl.conf; may be empty
  std::string kernel_release;  ///< `uname -r`
  bool root_user = false;
  std::vector<std::string> groups;  ///< that the process is in
};

/// This process's. `install_dir` is where `cmake --install` puts the files, seen from the executable, or
/// tools/install of the sources that it was built in.
[[nodiscard]] Machine this_machine();

/// Room that bursts of packets and of USB transfers need; what 60-rigor.rules and 60-rigor-sysctl.conf grant
/// is more.
inline constexpr long kWantedReceiveBytes = 8L << 20, kWantedSendBytes = 2L << 20, kWantedUsbfsMb = 128;

[[nodiscard]] std::vector<DoctorFinding> examine_machine(const Machine& machine);

}  // namespace rigor

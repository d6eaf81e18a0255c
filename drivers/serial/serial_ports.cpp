#include "drivers/serial/serial_ports.h"

#include <unistd.h>

#include <algorithm>
#include <fstream>

namespace rigor {
namespace serial {
namespace {

namespace fs = std::filesystem;

/// The program that has this file open, as far as this user may see; empty: none. A port is not opened to
/// find out: that raises its control lines, which resets some boards.
std::string holder_of(const fs::path& file) {
  std::error_code none;
  const fs::path real = fs::canonical(file, none);
  for (const auto& process : fs::directory_iterator("/proc", none)) {
    const std::string id = process.path().filename().string();
    if (id.find_first_not_of("0123456789") != std::string::npos) continue;
    std::error_code denied;
    for (const auto& open : fs::directory_iterator(process.path() / "fd", denied)) {
      if (fs::read_symlink(open.path(), denied) != real || denied) continue;
      std::string name;
      std::getline(std::ifstream(process.path() / "comm"), name);
      return name + " (process " + id + ")";
    }
  }
  return {};
}

}  // namespace

std::vector<SerialPort> list_serial_ports(const fs::path& sys, const fs::path& dev) {
  std::vector<SerialPort> found;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(sys, none)) {
    const auto name = entry.path().filename().string();
    const auto device = entry.path() / "device";
    if (!fs::exists(device / "driver", none)) continue;
    // The kernel keeps entries of the PC's ports that nothing is behind; those have type 0.
    std::string type;
    std::ifstream(entry.path() / "type") >> type;
    if (type == "0") continue;
    SerialPort p;
    p.path = (dev / name).string();
    p.driver = fs::canonical(device / "driver", none).filename().string();
    p.permitted = ::access(p.path.c_str(), R_OK | W_OK) == 0;
    p.holder = holder_of(p.path);
    for (const auto& link : fs::directory_iterator(dev / "serial" / "by-id", none)) {
      const auto target = fs::canonical(link.path(), none);
      if (!none && target == fs::canonical(p.path, none)) p.stable_path = link.path().string();
    }
    found.push_back(std::move(p));
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.path < b.path; });
  return found;
}

std::vector<DoctorFinding> serial_findings(const std::vector<SerialPort>& ports) {
  using Level = DoctorFinding::Level;
  std::vector<DoctorFinding> out;
  std::size_t usable = 0;
  for (const SerialPort& p : ports) {
    if (!p.permitted) {
      out.push_back({Level::missing, p.path + " is not for this user",
                     "sudo usermod -aG dialout $USER, and log in anew"});
    } else if (!p.holder.empty()) {
      out.push_back({Level::note, p.path + " is in use by " + p.holder,
                     "stop that program; gpsd: sudo systemctl stop gpsd.socket gpsd"});
    } else {
      ++usable;
    }
    if (p.stable_path.empty()) continue;
    out.push_back({Level::good, p.path + " has a name that survives replugging: " + p.stable_path, ""});
  }
  if (ports.empty())
    out.push_back({Level::good, "no serial port is plugged in; pseudo-terminals work", ""});
  else if (usable > 0)
    out.push_back({Level::good, std::to_string(usable) + " serial ports can be opened", ""});
  return out;
}

}  // namespace serial

Backend serial_backend() {
  Backend b;
  b.name = "serial";
  b.summary = "serial ports, which modbus, usb and gnss use";
  b.find_devices = [] {
    std::vector<FoundDevice> found;
    for (const auto& p : serial::list_serial_ports())
      found.push_back({"serial", std::filesystem::path(p.path).filename().string(),
                       "serial port (" + p.driver + ")" + (p.permitted ? "" : ", not for this user") +
                           (p.holder.empty() ? "" : ", in use by " + p.holder),
                       p.stable_path.empty() ? p.path : p.stable_path});
    return found;
  };
  b.doctor = [] { return serial::serial_findings(serial::list_serial_ports()); };
  return b;
}

}  // namespace rigor

#include "drivers/usb/usb_backend.h"

#include <unistd.h>

#include <cstdio>
#include <filesystem>

#include "drivers/usb/libusb_link.h"
#include "drivers/usb/usb_protocols.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
constexpr std::uint16_t kHokuyo = 0x15d1;

std::unique_ptr<usb::ByteLink> make_link(const usb::LinkSettings& s) {
  return s.transport == usb::Transport::usb ? usb::make_libusb_link(s.usb) : usb::make_plain_link(s);
}

/// The terminal that cdc_acm made of a device, or empty.
std::string terminal_of(const std::string& usb_path) {
  std::error_code error;
  for (const auto& e : fs::directory_iterator("/sys/class/tty", error)) {
    const std::string name = e.path().filename();
    if (name.rfind("ttyACM", 0) != 0) continue;
    const std::string device = fs::canonical(e.path() / "device", error).string();
    if (!error && device.find("/" + usb_path + ":") != std::string::npos) return "/dev/" + name;
  }
  return {};
}

std::vector<FoundDevice> find_devices() {
  std::vector<FoundDevice> found;
  for (const auto& d : usb::list_usb_devices()) {
    const bool scanner = d.vendor == kHokuyo && d.cdc_acm;
    if (!scanner && d.bulk_interface < 0) continue;
    FoundDevice f;
    f.backend = "usb";
    char ids[16];
    std::snprintf(ids, sizeof ids, "%04x:%04x", d.vendor, d.product);
    f.id = d.serial.empty() ? ids : std::string(ids) + " " + d.serial;
    f.description = d.text.empty() ? (scanner ? "Hokuyo scanner" : "USB device") : d.text;
    if (scanner) {
      f.description += ", protocol: scip";
      if (const auto tty = terminal_of(d.path); !tty.empty()) f.description += ", also " + tty;
    } else {
      char where[64];
      std::snprintf(where, sizeof where, ", protocol: bulk, interface %d, endpoint 0x%02x", d.bulk_interface,
                    d.bulk_endpoint);
      f.description += where;
    }
    if (!d.access.empty()) f.description += " (" + d.access + ")";
    f.address = "usb_path " + d.path;
    found.push_back(std::move(f));
  }
  return found;
}

std::vector<DoctorFinding> doctor() {
  using Level = DoctorFinding::Level;
  std::vector<DoctorFinding> out;
  out.push_back({Level::good, "libusb " + usb::usb_library_version(), ""});
  std::error_code error;
  if (!fs::exists("/sys/bus/usb/devices", error)) {
    out.push_back(
        {Level::note, "this kernel has no USB; scanners with a network plug work (transport: tcp)",
         "sudo modprobe usbcore; in a virtual machine or a container: pass the USB bus through to it"});
  } else if (!fs::exists("/dev/bus/usb", error)) {
    out.push_back({Level::missing, "USB devices have no files in /dev/bus/usb",
                   "start udev; in a container: run it with --device /dev/bus/usb"});
  } else {
    for (const auto& d : usb::list_usb_devices())
      if (!d.access.empty() && (d.vendor == kHokuyo || d.bulk_interface >= 0))
        out.push_back({Level::missing, "USB device at " + d.path + ": it may not be opened", d.access});
  }
  if (const std::string why = usb::gadget_obstacle(); why.empty())
    out.push_back({Level::good, "emulated devices may be USB gadgets (as: gadget)", ""});
  else
    out.push_back({Level::note,
                   "emulated devices cannot be USB gadgets here: " + why.substr(0, why.find(": ")),
                   why.find(": ") == std::string::npos
                       ? "use `as: pty` or `as: tcp`"
                       : why.substr(why.find(": ") + 2) + "; or use `as: pty` or `as: tcp`"});
  return out;
}

}  // namespace

Backend usb_backend() {
  Backend b;
  b.name = "usb";
  b.summary =
      "USB by libusb: Hokuyo URG and UTM scanners (SCIP 2.0; terminals and TCP too), frames from a bulk "
      "endpoint";
  b.make_source = [] { return usb::make_usb_source(make_link); };
  b.make_emulator = [] { return usb::make_usb_emulator(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return usb::make_usb_virtual_source(std::move(parts), std::move(params));
  };
  b.find_devices = find_devices;
  b.doctor = doctor;
  return b;
}

}  // namespace rigor

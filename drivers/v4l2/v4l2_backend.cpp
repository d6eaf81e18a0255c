#include "drivers/v4l2/v4l2_backend.h"

#include <fmt/format.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <filesystem>
#include <fstream>

#include "drivers/v4l2/v4l2_emulator.h"
#include "drivers/v4l2/v4l2_source.h"
#include "drivers/v4l2/v4l2_virtual_source.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;

std::vector<FoundDevice> find_devices() {
  std::vector<FoundDevice> all;
  for (const v4l2::DeviceTable& t : v4l2::list_nodes(true)) {
    std::string formats;
    std::size_t listed = 0;
    for (const v4l2::OfferedFormat& f : t.formats) {
      if (listed++ == 8) {
        formats += fmt::format(" and {} more", t.formats.size() - 8);
        break;
      }
      formats += (formats.empty() ? "" : " ") + v4l2::fourcc_text(f.code);
    }
    std::string what = t.captures && t.outputs ? "captures, takes frames"
                       : t.captures            ? "captures"
                       : t.outputs             ? "takes frames"
                                               : "neither captures nor takes frames";
    if (t.multiplanar) what = "multi-planar API only, which is not supported";
    all.push_back({"v4l2", t.path,
                   fmt::format("{} ({}, {}): {}{}{}", t.card, t.driver, t.bus, what,
                               formats.empty() ? "" : ": ", formats),
                   t.path});
  }
  return all;
}

bool is_node(const std::string& name) {
  return name.starts_with("video") && name.size() > 5 &&
         std::all_of(name.begin() + 5, name.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
}

/// A module that is loaded, or could be: the kernel's list of what is installed names it.
bool module_there(const std::string& name) {
  std::error_code ignored;
  if (fs::exists("/sys/module/" + name, ignored)) return true;
  utsname u{};
  if (uname(&u) != 0) return false;
  for (const char* list : {"modules.dep", "modules.builtin"}) {
    std::ifstream in(fs::path("/lib/modules") / u.release / list);
    for (std::string line; std::getline(in, line);)
      if (line.find("/" + name + ".ko") != std::string::npos) return true;
  }
  return false;
}

std::vector<DoctorFinding> examine() {
  using Level = DoctorFinding::Level;
  std::vector<DoctorFinding> all;
  std::error_code ignored;
  std::size_t nodes = 0;
  std::string closed;
  for (const auto& e : fs::directory_iterator("/dev", ignored)) {
    if (!is_node(e.path().filename())) continue;
    ++nodes;
    if (access(e.path().c_str(), R_OK | W_OK) != 0)
      closed += (closed.empty() ? "" : ", ") + e.path().string();
  }
  if (nodes == 0)
    all.push_back({Level::note, "no /dev/video*: no camera is attached, or this kernel has no driver for it",
                   module_there("uvcvideo") ? "attach the camera; for USB cameras: sudo modprobe uvcvideo"
                                            : "a kernel with V4L2 (Debian's linux-image-amd64 has it); "
                                              "./dev test --kernel runs the tests on one"});
  else
    all.push_back({Level::good, fmt::format("{} video node{}", nodes, nodes == 1 ? "" : "s"), ""});
  if (!closed.empty())
    all.push_back(
        {Level::missing, "no right to open " + closed, "sudo usermod -aG video $USER, and log in again"});
  if (module_there("v4l2loopback"))
    all.push_back(
        fs::exists("/sys/module/v4l2loopback", ignored)
            ? DoctorFinding{Level::good, "v4l2loopback is loaded: emulated cameras can leave as /dev/videoN",
                            ""}
            : DoctorFinding{
                  Level::note,
                  "v4l2loopback is installed and not loaded: emulated cameras cannot leave as /dev/videoN",
                  "sudo modprobe v4l2loopback devices=2 exclusive_caps=0,1"});
  else
    all.push_back({Level::note, "no v4l2loopback: emulated cameras cannot leave as /dev/videoN",
                   "sudo apt-get install v4l2loopback-dkms && sudo modprobe v4l2loopback devices=2 "
                   "exclusive_caps=0,1"});
  if (!fs::exists("/sys/kernel/config/usb_gadget", ignored))
    all.push_back({Level::note, "no USB gadgets: emulated cameras cannot leave as USB cameras",
                   "sudo modprobe -a libcomposite usb_f_uvc dummy_hcd; sudo mount -t configfs none "
                   "/sys/kernel/config"});
  return all;
}

}  // namespace

Backend v4l2_backend() {
  Backend b;
  b.name = "v4l2";
  b.summary = "video devices (V4L2): USB cameras, loop-back devices";
  b.make_source = [] { return std::make_unique<v4l2::V4l2Source>(); };
  b.make_emulator = [] { return std::make_unique<v4l2::V4l2Emulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<v4l2::VirtualSource>(std::move(parts), std::move(params));
  };
  b.find_devices = find_devices;
  b.doctor = examine;
  return b;
}

}  // namespace rigor

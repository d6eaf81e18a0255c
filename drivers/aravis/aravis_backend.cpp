#include "drivers/aravis/aravis_backend.h"

#include <fmt/format.h>
#include <ifaddrs.h>
#include <linux/capability.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/camera_emulator.h"
#include "drivers/aravis/camera_session.h"
#include "drivers/aravis/gige_virtual_source.h"
#include "rt-core/file_descriptor.h"

namespace rigor {
namespace {

constexpr std::int64_t kWantedSocketBuffer = 4 << 20;

std::vector<FoundDevice> find_cameras() {
  std::vector<FoundDevice> all;
  for (SeenCamera& c : see_cameras("", milliseconds(400)))
    all.push_back({"aravis", std::move(c.id), std::move(c.description), std::move(c.address)});
  return all;
}

DoctorFinding check_socket_buffer() {
  std::int64_t most = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> most;
  DoctorFinding f;
  if (most >= kWantedSocketBuffer) {
    f.what = fmt::format("socket buffers up to {} KiB: enough for bursts of large frames", most / 1024);
    return f;
  }
  f.level = DoctorFinding::Level::missing;
  f.what = fmt::format(
      "socket buffers are limited to {} KiB: GigE Vision frames above some 0.2 MB lose packets", most / 1024);
  f.cure = fmt::format(
      "sudo sysctl -w net.core.rmem_max={0}    (to keep it: echo net.core.rmem_max={0} | sudo tee "
      "/etc/sysctl.d/60-rigor.conf)",
      kWantedSocketBuffer);
  return f;
}

DoctorFinding check_packet_sockets() {
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  std::array<__user_cap_data_struct, 2> data{};
  DoctorFinding f;
  if (syscall(SYS_capget, &header, data.data()) == 0 && (data[0].effective & (1u << CAP_NET_RAW)) != 0) {
    f.what = "packet sockets are allowed: GigE Vision streams take less CPU";
    return f;
  }
  f.level = DoctorFinding::Level::note;
  f.what = "packet sockets are not allowed: GigE Vision streams go through ordinary sockets, at more CPU";
  f.cure = "sudo setcap cap_net_raw+ep $(readlink -f $(which rigor))";
  return f;
}

/// Wired interfaces that are up and take only standard frames: more packets, more CPU.
void check_mtu(std::vector<DoctorFinding>& all) {
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return;
  const FileDescriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  std::set<std::string> seen;
  for (const ifaddrs* i = list; i != nullptr && fd; i = i->ifa_next) {
    if (i->ifa_addr == nullptr || i->ifa_addr->sa_family != AF_INET || (i->ifa_flags & IFF_UP) == 0 ||
        (i->ifa_flags & IFF_LOOPBACK) != 0 || !seen.insert(i->ifa_name).second)
      continue;
    ifreq request{};
    std::strncpy(request.ifr_name, i->ifa_name, IFNAMSIZ - 1);
    if (ioctl(fd.get(), SIOCGIFMTU, &request) != 0 || request.ifr_mtu >= 8000) continue;
    all.push_back(
        {DoctorFinding::Level::note,
         fmt::format("{} takes packets of {} bytes; a GigE Vision camera on it needs {} times the packets of "
                     "jumbo frames",
                     i->ifa_name, request.ifr_mtu, (9000 + request.ifr_mtu / 2) / request.ifr_mtu),
         fmt::format("where a camera hangs on it and switch and card can: sudo ip link set {} mtu 9000",
                     i->ifa_name)});
  }
  freeifaddrs(list);
}

/// The kernel's end of USB/IP, which plugs in a camera that is emulated `as: usb3vision`.
DoctorFinding check_usbip() {
  std::error_code error;
  if (std::filesystem::exists("/sys/devices/platform/vhci_hcd.0", error))
    return {DoctorFinding::Level::good, "vhci_hcd is loaded: emulated USB3 Vision cameras can be attached",
            ""};
  return {
      DoctorFinding::Level::note,
      "vhci_hcd is not loaded: this machine cannot attach an emulated USB3 Vision camera (as: usb3vision)",
      "sudo modprobe vhci-hcd    (then: sudo usbip attach -r 127.0.0.1 -b 1-1)"};
}

std::vector<DoctorFinding> examine() {
  std::vector<DoctorFinding> all{check_socket_buffer(), check_packet_sockets(), check_usbip()};
  check_mtu(all);
  return all;
}

}  // namespace

Backend aravis_backend() {
  Backend b;
  b.name = "aravis";
  b.summary = "GenICam cameras (GigE Vision, USB3 Vision) through Aravis";
  b.make_source = [] { return std::make_unique<AravisSource>(); };
  b.make_emulator = [] { return make_camera_emulator(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<GigeVirtualSource>(std::move(parts), std::move(params));
  };
  b.find_devices = find_cameras;
  b.doctor = examine;
  return b;
}

}  // namespace rigor

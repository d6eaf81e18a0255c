#include "bench/run/machine_probe.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <grp.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <optional>

namespace rigor {
namespace fs = std::filesystem;
namespace {

using Level = DoctorFinding::Level;

std::optional<long> number_in(const fs::path& file) {
  std::ifstream in(file);
  long n = 0;
  if (in >> n) return n;
  return std::nullopt;
}

/// The command that takes our snippet into the system, or the one that sets the value until the next boot.
std::string cure_by_sysctl(const Machine& m, const std::string& key, long value) {
  const fs::path snippet = m.install_dir / "sysctl" / "60-rigor-sysctl.conf";
  std::error_code error;
  if (!m.install_dir.empty() && fs::exists(snippet, error))
    return fmt::format("sudo cp {} /etc/sysctl.d/ && sudo sysctl --system", snippet.string());
  return fmt::format(
      "sudo sysctl -w {0}={1}    (to keep it: echo {0}={1} | sudo tee /etc/sysctl.d/60-rigor.conf)", key,
      value);
}

void check_socket_buffers(const Machine& m, std::vector<DoctorFinding>& all) {
  struct Limit {
    const char *file, *key, *good, *bad;
    long wanted;
    Level level;
  };
  static constexpr Limit kLimits[] = {
      {"rmem_max", "net.core.rmem_max",
       "receive buffers up to {} KiB: enough for bursts of frames and revolutions",
       "receive buffers are limited to {} KiB: bursts of GigE Vision or LiDAR packets lose some while a "
       "reader waits "
       "for the CPU",
       kWantedReceiveBytes, Level::missing},
      {"wmem_max", "net.core.wmem_max", "send buffers up to {} KiB: enough for emulated devices",
       "send buffers are limited to {} KiB: emulated cameras send large frames in pieces", kWantedSendBytes,
       Level::note}};
  for (const Limit& limit : kLimits) {
    const auto most = number_in(m.root / "proc/sys/net/core" / limit.file);
    if (!most) {
      all.push_back({Level::note, fmt::format("{} cannot be read here", limit.key), ""});
    } else if (*most >= limit.wanted) {
      all.push_back({Level::good, fmt::format(fmt::runtime(limit.good), *most / 1024), ""});
    } else {
      all.push_back({limit.level, fmt::format(fmt::runtime(limit.bad), *most / 1024),
                     cure_by_sysctl(m, limit.key, limit.wanted)});
    }
  }
}

void check_usb_memory(const Machine& m, std::vector<DoctorFinding>& all) {
  const auto mb = number_in(m.root / "sys/module/usbcore/parameters/usbfs_memory_mb");
  if (!mb) {
    all.push_back(
        {Level::note, "this kernel has no USB: scanners and cameras on it cannot be read",
         "sudo modprobe usbcore, or a kernel with CONFIG_USB; virtual time and emulators over the network "
         "need none"});
  } else if (*mb != 0 && *mb < kWantedUsbfsMb) {  // 0: no limit
    all.push_back(
        {Level::note,
         fmt::format("all USB transfers together may hold {} MiB: a USB3 Vision camera needs more", *mb),
         fmt::format("echo {} | sudo tee /sys/module/usbcore/parameters/usbfs_memory_mb    (the udev rules "
                     "keep it)",
                     kWantedUsbfsMb)});
  } else {
    all.push_back({Level::good,
                   *mb == 0 ? "memory of USB transfers is not limited"
                            : fmt::format("USB transfers may hold {} MiB", *mb),
                   ""});
  }
}

void check_groups(const Machine& m, std::vector<DoctorFinding>& all) {
  if (m.root_user) {
    all.push_back({Level::good, "you are root: every device can be opened", ""});
    return;
  }
  static constexpr const char* kGroups[][2] = {
      {"dialout", "serial lines (Modbus RTU, scanners as /dev/ttyACM*)"},
      {"video", "cameras and video outputs (/dev/video*)"},
      {"plugdev", "USB devices by libusb (needs the udev rules)"}};
  for (const auto& [group, what] : kGroups) {
    if (std::find(m.groups.begin(), m.groups.end(), group) != m.groups.end())
      all.push_back({Level::good, fmt::format("you are in group {}: {}", group, what), ""});
    else
      all.push_back({Level::missing, fmt::format("you are not in group {}: {} cannot be opened", group, what),
                     fmt::format("sudo usermod -aG {} $USER    (counts after the next login)", group)});
  }
}

enum class ModuleState : std::uint8_t { there, loadable, absent };

/// Module names with - and _ are the same; MODULE is written with _.
ModuleState state_of(const Machine& m, const std::string& module) {
  std::error_code error;
  if (fs::exists(m.root / "sys/module" / module, error)) return ModuleState::there;
  const fs::path folder = m.root / "lib/modules" / m.kernel_release;
  const auto listed = [&](const char* file) {
    std::ifstream in(folder / file);
    for (std::string line; std::getline(in, line);) {
      line = line.substr(0, line.find(':'));  // modules.dep: FILE: what it needs
      line = line.substr(line.rfind('/') + 1);
      line = line.substr(0, line.find(".ko"));
      std::replace(line.begin(), line.end(), '-', '_');
      if (line == module) return true;
    }
    return false;
  };
  if (listed("modules.builtin")) return ModuleState::there;
  return listed("modules.dep") ? ModuleState::loadable : ModuleState::absent;
}

void check_modules(const Machine& m, std::vector<DoctorFinding>& all) {
  struct Module {
    const char *name, *what, *absent_cure;
  };
  static constexpr const char* kOtherKernel = "a kernel that has it, such as Debian's linux-image-amd64";
  static constexpr Module kModules[] = {{"can", "CAN interfaces", kOtherKernel},
                                        {"vcan", "CAN buses without hardware", kOtherKernel},
                                        {"videodev", "cameras (V4L2)", kOtherKernel},
                                        {"uvcvideo", "USB cameras", kOtherKernel},
                                        {"v4l2loopback", "simulated cameras as /dev/videoN",
                                         "sudo apt install v4l2loopback-dkms linux-headers-$(uname -r)"},
                                        {"cdc_acm", "USB scanners as serial lines", kOtherKernel}};
  for (const Module& module : kModules) {
    switch (state_of(m, module.name)) {
      case ModuleState::there:
        all.push_back(
            {Level::good, fmt::format("kernel module {} is there: {}", module.name, module.what), ""});
        break;
      case ModuleState::loadable:
        all.push_back({Level::note,
                       fmt::format("kernel module {} is not loaded: {}", module.name, module.what),
                       fmt::format("sudo modprobe {0}    (at every boot: echo {0} | sudo tee "
                                   "/etc/modules-load.d/rigor-{0}.conf)",
                                   module.name)});
        break;
      case ModuleState::absent:
        all.push_back(
            {Level::note,
             fmt::format("kernel {} has no module {}: no {}", m.kernel_release, module.name, module.what),
             module.absent_cure});
        break;
    }
  }
}

void check_udev_rules(const Machine& m, std::vector<DoctorFinding>& all) {
  std::error_code error;
  for (const char* folder :
       {"etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d"})
    if (fs::exists(m.root / folder / "60-rigor.rules", error)) {
      all.push_back({Level::good, fmt::format("udev rules are installed: /{}/60-rigor.rules", folder), ""});
      return;
    }
  const fs::path ours = m.install_dir / "udev" / "60-rigor.rules";
  const bool have = !m.install_dir.empty() && fs::exists(ours, error);
  all.push_back(
      {m.root_user ? Level::note : Level::missing,
       "udev rules are not installed: USB scanners and USB3 Vision cameras belong to root",
       fmt::format("sudo cp {} /etc/udev/rules.d/ && sudo udevadm control --reload && sudo udevadm trigger",
                   have ? ours.string() : "PREFIX/share/rigor/udev/60-rigor.rules")});
}

}  // namespace

Machine this_machine() {
  Machine m;
  utsname u{};
  if (uname(&u) == 0) m.kernel_release = u.release;
  m.root_user = geteuid() == 0;
  std::vector<gid_t> ids(static_cast<std::size_t>(std::max(0, getgroups(0, nullptr))));
  ids.resize(static_cast<std::size_t>(std::max(0, getgroups(static_cast<int>(ids.size()), ids.data()))));
  ids.push_back(getegid());
  for (const gid_t id : ids)
    if (const group* g = getgrgid(id); g != nullptr) m.groups.emplace_back(g->gr_name);

  std::error_code error;
  const fs::path executable = fs::read_symlink("/proc/self/exe", error);
  if (error) return m;
  const fs::path folder = executable.parent_path();
  for (const fs::path& candidate :
       {folder.parent_path() / "share/rigor", folder.parent_path().parent_path() / "tools/install"})
    if (m.install_dir.empty() && fs::exists(candidate / "udev/60-rigor.rules", error))
      m.install_dir = candidate;
  return m;
}

std::vector<DoctorFinding> examine_machine(const Machine& machine) {
  std::vector<DoctorFinding> all;
  check_groups(machine, all);
  check_udev_rules(machine, all);
  check_socket_buffers(machine, all);
  check_usb_memory(machine, all);
  check_modules(machine, all);
  return all;
}

}  // namespace rigor

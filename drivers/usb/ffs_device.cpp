#include "drivers/usb/ffs_device.h"

#include <fcntl.h>
#include <linux/usb/ch9.h>
#include <linux/usb/functionfs.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/mount.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "rt-core/byte_order.h"

namespace rigor::usb {
namespace {

/// Interface and endpoint at one speed.
void put_function(std::string& s, std::uint16_t packet_bytes) {
  for (const unsigned v :
       {9u, unsigned{USB_DT_INTERFACE}, 0u, 0u, 1u, unsigned{USB_CLASS_VENDOR_SPEC}, 0u, 0u, 1u})
    s += static_cast<char>(v);
  for (const unsigned v : {7u, unsigned{USB_DT_ENDPOINT}, 0x81u, unsigned{USB_ENDPOINT_XFER_BULK}})
    s += static_cast<char>(v);
  append_le(s, packet_bytes);
  s += '\0';
}

std::string descriptors() {
  std::string body;
  append_le<std::uint32_t>(body, 2);  // descriptors at full speed
  append_le<std::uint32_t>(body, 2);  // and at high speed
  put_function(body, 64);
  put_function(body, 512);
  std::string s;
  append_le<std::uint32_t>(s, FUNCTIONFS_DESCRIPTORS_MAGIC_V2);
  append_le(s, static_cast<std::uint32_t>(12 + body.size()));
  append_le<std::uint32_t>(s, FUNCTIONFS_HAS_FS_DESC | FUNCTIONFS_HAS_HS_DESC);
  return s + body;
}

std::string strings() {
  constexpr std::string_view kName = "frames";
  std::string s;
  append_le<std::uint32_t>(s, FUNCTIONFS_STRINGS_MAGIC);
  append_le(s, static_cast<std::uint32_t>(16 + 2 + kName.size() + 1));
  append_le<std::uint32_t>(s, 1);  // strings
  append_le<std::uint32_t>(s, 1);  // languages
  append_le<std::uint16_t>(s, 0x0409);
  s += kName;
  s += '\0';
  return s;
}

}  // namespace

Status FfsDevice::open(GadgetSettings settings) {
  close();
  const std::string name = settings.name;
  settings.function = "ffs." + name;
  settings.device_class = 0;
  if (auto s = gadget_.create(settings); !s) return s;
  const auto failed = [&](const std::string& what) {
    const std::string why = std::strerror(errno);
    close();
    return fail(ErrorCode::unavailable, name, what + ": " + why);
  };
  mount_ = "/tmp/rigor-ffs-" + name;
  std::error_code error;
  std::filesystem::create_directory(mount_, error);
  if (::mount(name.c_str(), mount_.c_str(), "functionfs", 0, nullptr) != 0)
    return failed("cannot mount functionfs (sudo modprobe usb_f_fs)");
  mounted_ = true;
  control_.reset(::open((mount_ + "/ep0").c_str(), O_RDWR | O_CLOEXEC));
  if (!control_) return failed("cannot open the device's control endpoint");
  const std::string d = descriptors(), s = strings();
  if (::write(control_.get(), d.data(), d.size()) != static_cast<ssize_t>(d.size()) ||
      ::write(control_.get(), s.data(), s.size()) != static_cast<ssize_t>(s.size()))
    return failed("the kernel does not take the device's descriptors");
  in_.reset(::open((mount_ + "/ep1").c_str(), O_RDWR | O_CLOEXEC | O_NONBLOCK));
  stop_.reset(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!in_ || !stop_) return failed("cannot open the device's endpoint");
  thread_ = std::thread([this] { watch(); });
  if (auto plugged = gadget_.bind(); !plugged) {
    close();
    return plugged;
  }
  return {};
}

void FfsDevice::close() noexcept {
  gadget_.unbind();
  if (thread_.joinable()) {
    const std::uint64_t one = 1;
    (void)!::write(stop_.get(), &one, sizeof one);
    thread_.join();
  }
  in_.reset();
  control_.reset();
  stop_.reset();
  enabled_ = false;
  if (mounted_) ::umount2(mount_.c_str(), MNT_DETACH);
  mounted_ = false;
  if (!mount_.empty()) ::rmdir(mount_.c_str());
  mount_.clear();
  gadget_.remove();
}

void FfsDevice::watch() {
  while (true) {
    pollfd p[2] = {{control_.get(), POLLIN, 0}, {stop_.get(), POLLIN, 0}};
    if (::poll(p, 2, -1) < 0 && errno != EINTR) return;
    if (p[1].revents != 0) return;
    if (p[0].revents == 0) continue;
    std::array<usb_functionfs_event, 4> events{};
    const ssize_t n = ::read(control_.get(), events.data(), sizeof events);
    if (n < 0 && errno != EINTR && errno != EAGAIN && errno != EIDRM) return;
    for (ssize_t i = 0; i < n / static_cast<ssize_t>(sizeof events[0]); ++i) {
      const usb_functionfs_event& e = events[static_cast<std::size_t>(i)];
      switch (e.type) {
        case FUNCTIONFS_ENABLE:
          enabled_.store(true, std::memory_order_release);
          break;
        case FUNCTIONFS_DISABLE:
        case FUNCTIONFS_UNBIND:
          enabled_.store(false, std::memory_order_release);
          break;
        case FUNCTIONFS_SETUP:
          // No requests of our own: a transfer in the wrong direction refuses it.
          if ((e.u.setup.bRequestType & USB_DIR_IN) != 0)
            (void)!::read(control_.get(), nullptr, 0);
          else
            (void)!::write(control_.get(), nullptr, 0);
          break;
        default:
          break;
      }
    }
  }
}

bool FfsDevice::write(std::string_view bytes) {
  while (!bytes.empty()) {
    // Pieces of a size that the kernel can copy at once.
    const ssize_t n = ::write(in_.get(), bytes.data(), std::min<std::size_t>(bytes.size(), 64 * 1024));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

bool FfsDevice::stall() {
  // I/O against the direction of an endpoint halts it, and says so by EBADMSG.
  char byte = 0;
  return ::read(in_.get(), &byte, 1) < 0 && errno == EBADMSG;
}

}  // namespace rigor::usb

#include "drivers/usb/device_ends.h"

#include <fcntl.h>
#include <termios.h>
#include <unistd.h>

#include <cstdio>

#include "rt-core/file_descriptor.h"

namespace rigor::usb {
namespace {

class GadgetEnd final : public DeviceEnd {
 public:
  explicit GadgetEnd(GadgetSettings settings) : settings_(std::move(settings)) {}
  ~GadgetEnd() override {
    fd_.reset();
    gadget_.remove();
  }
  [[nodiscard]] Status open() override {
    if (auto s = gadget_.create(settings_); !s) return s;
    if (auto s = gadget_.bind(); !s) return s;
    auto port = gadget_.acm_port();
    if (!port) return tl::unexpected<Error>(port.error());
    device_ = "/dev/ttyGS" + std::to_string(*port);
    return {};
  }
  [[nodiscard]] int fd() override { return fd_.get(); }
  void lost() override { fd_.reset(); }
  void await(int cut, Duration) override {
    fd_.reset(::open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
    if (!fd_) return serial::pause_until_cut(cut, milliseconds(20));
    termios t{};
    ::tcgetattr(fd_.get(), &t);
    ::cfmakeraw(&t);
    t.c_cflag |= CLOCAL;
    ::tcsetattr(fd_.get(), TCSANOW, &t);
  }
  [[nodiscard]] std::string endpoint() const override {
    char ids[16];
    std::snprintf(ids, sizeof ids, "%04x:%04x", settings_.vendor, settings_.product);
    return std::string("USB ") + ids + " on " + gadget_.udc() + " (" + device_ + ")";
  }

 private:
  GadgetSettings settings_;
  UsbGadget gadget_;
  std::string device_;
  FileDescriptor fd_;
};

}  // namespace

std::unique_ptr<DeviceEnd> make_gadget_end(GadgetSettings settings) {
  return std::make_unique<GadgetEnd>(std::move(settings));
}

}  // namespace rigor::usb

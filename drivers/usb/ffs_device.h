// A USB device written in user space, by FunctionFS (Documentation/usb/functionfs.rst): one interface of a
// vendor's own class with one bulk IN endpoint, 0x81.
#pragma once

#include <atomic>
#include <string>
#include <string_view>
#include <thread>

#include "drivers/usb/usb_gadget.h"
#include "rt-core/file_descriptor.h"

namespace rigor::usb {

class FfsDevice {
 public:
  FfsDevice() = default;
  ~FfsDevice() { close(); }
  FfsDevice(const FfsDevice&) = delete;
  FfsDevice& operator=(const FfsDevice&) = delete;

  /// Makes the gadget, mounts its file system, and plugs it in. `settings.function` is set here.
  [[nodiscard]] Status open(GadgetSettings settings);
  void close() noexcept;
  /// The host has chosen the device's configuration.
  [[nodiscard]] bool enabled() const noexcept { return enabled_.load(std::memory_order_acquire); }
  /// Blocks until the host has taken all of it; false: it did not (no host, unplugged, `unplug` meanwhile).
  [[nodiscard]] bool write(std::string_view bytes);
  /// Halts the endpoint: the host's next transfer stalls, until it clears that.
  [[nodiscard]] bool stall();
  /// Any thread.
  void unplug() noexcept { gadget_.unbind(); }
  [[nodiscard]] Status plug() { return gadget_.bind(); }
  [[nodiscard]] const std::string& udc() const noexcept { return gadget_.udc(); }

 private:
  void watch();
  UsbGadget gadget_;
  std::string mount_;
  bool mounted_ = false;
  FileDescriptor control_, in_, stop_;
  std::atomic<bool> enabled_{false};
  std::thread thread_;
};

}  // namespace rigor::usb

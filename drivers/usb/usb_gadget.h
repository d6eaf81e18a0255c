// This machine as a USB device, by the kernel's configfs (Documentation/usb/gadget_configfs.rst). Needs root,
// the modules libcomposite and the function's own, and a device controller: a real one, or dummy_hcd, which
// plugs the device into the same machine.
#pragma once

#include <filesystem>
#include <string>

#include "rt-core/result.h"

namespace rigor::usb {

struct GadgetSettings {
  std::string name = "rigor";  ///< its folder in configfs
  std::uint16_t vendor = 0x15d1, product = 0x0000;
  std::string manufacturer = "Hokuyo Data Flex for USB", description = "URG-Series USB Driver", serial;
  std::string function = "acm.0";  ///< or "ffs.NAME"
  std::string udc;                 ///< empty: the first that no gadget has
  std::uint8_t device_class = 2;   ///< CDC; 0: each interface says
};

/// Plugged in by `bind`, taken away with the object.
class UsbGadget {
 public:
  UsbGadget() = default;
  ~UsbGadget() { remove(); }
  UsbGadget(const UsbGadget&) = delete;
  UsbGadget& operator=(const UsbGadget&) = delete;

  /// Makes the gadget; one of that name that was left behind is taken away first.
  [[nodiscard]] Status create(const GadgetSettings& settings);
  [[nodiscard]] Status bind();
  void unbind() noexcept;
  void remove() noexcept;
  [[nodiscard]] bool bound() const noexcept { return bound_; }
  [[nodiscard]] const std::string& udc() const noexcept { return udc_; }
  /// Of an ACM function: N of /dev/ttyGSN.
  [[nodiscard]] Result<int> acm_port() const;

 private:
  GadgetSettings settings_;
  std::filesystem::path folder_;
  std::string udc_;
  bool bound_ = false;
};

/// What this machine lacks to be a USB device; empty when nothing.
[[nodiscard]] std::string gadget_obstacle();

}  // namespace rigor::usb

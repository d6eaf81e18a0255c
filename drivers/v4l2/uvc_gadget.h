// A USB video gadget by configfs: makes this machine's USB device controller (or dummy_hcd's) look like a UVC
// camera of one sensor. Layout: https://docs.kernel.org/usb/gadget_configfs.html and the kernel's
// Documentation/ABI/testing/configfs-usb-gadget-uvc. Needs root, libcomposite and usb_f_uvc.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "drivers/v4l2/uvc_control.h"
#include "rt-core/result.h"

namespace rigor::v4l2 {

struct UvcGadgetOptions {
  std::string name = "rigor-uvc";                   ///< of the folder in configfs
  std::string controller;                           ///< in /sys/class/udc; empty: the first that is free
  std::uint16_t vendor = 0x1d6b, product = 0x0102;  ///< Linux Foundation's, of its webcam gadget
  std::string manufacturer = "Rigor", product_name = "Rigor camera", serial = "1";
  uvc::StreamOffer offer;
  std::filesystem::path configfs = "/sys/kernel/config/usb_gadget";
};

/// UVC's name of a format (GUID, as bytes), by FourCC; empty where UVC has none, or for MJPG.
[[nodiscard]] std::vector<std::uint8_t> uvc_guid(std::uint32_t code);
/// Whether a format can be streamed by UVC at all.
[[nodiscard]] bool uvc_can(std::uint32_t code);

/// The gadget lives as long as this; it is taken apart when it goes.
class UvcGadget {
 public:
  UvcGadget() = default;
  UvcGadget(UvcGadget&&) noexcept = default;
  UvcGadget& operator=(UvcGadget&& o) noexcept;
  ~UvcGadget();
  /// What an earlier process left under the same name is taken apart first.
  [[nodiscard]] static Result<UvcGadget> create(const UvcGadgetOptions& options);
  /// Gives the gadget to its controller; from now on it has a video node. The host sees it once that node's
  /// events are listened to.
  [[nodiscard]] Status bind();
  void unbind() noexcept;
  [[nodiscard]] const std::string& controller() const noexcept { return controller_; }
  /// "/dev/video4", once bound.
  [[nodiscard]] Result<std::string> node() const;

 private:
  std::filesystem::path root_;
  std::string controller_;
  bool bound_ = false;
};

/// Controllers that no gadget has taken.
[[nodiscard]] std::vector<std::string> free_controllers();
/// Takes apart a gadget's folder. Nothing where there is none.
void remove_gadget(const std::filesystem::path& root) noexcept;

}  // namespace rigor::v4l2

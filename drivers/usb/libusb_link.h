// A byte stream over USB by libusb-1.0: bulk transfers, several in flight, and whatever may happen to them.
//
// A scanner (CDC-ACM, by class): the communication and the data interface are claimed, the kernel's cdc_acm
// is sent away while the channel runs and comes back after it, the line is set to 115200 8N1 with DTR and
// RTS. A bulk source: the interface and endpoint that its address names.
//
// The thread that receives is the one that handles libusb's events. A stall is cleared (the transfers in
// flight are taken back first) and counted; what was being sent then is lost. An unplugged device shows as
// `gone`. While it is away, `wait` returns as soon as the system says that a device like it came (hot-plug
// by udev), or when its time is over: a machine without udev finds it by trying.
#pragma once

#include "drivers/usb/usb_settings.h"

namespace rigor::usb {

[[nodiscard]] std::unique_ptr<ByteLink> make_libusb_link(const UsbAddress& address);

struct UsbDeviceSeen {
  std::uint16_t vendor = 0, product = 0;
  std::string path;  ///< bus and ports: "1-2.3"
  std::string serial, text;
  std::string access;  ///< empty, or why it cannot be opened
  bool cdc_acm = false;
  int bulk_interface = -1;  ///< of a vendor's own class, with a bulk IN endpoint
  std::uint8_t bulk_endpoint = 0;
};
/// Everything on the bus but hubs. Setup; empty where there is no bus.
[[nodiscard]] std::vector<UsbDeviceSeen> list_usb_devices();
[[nodiscard]] std::string usb_library_version();

}  // namespace rigor::usb

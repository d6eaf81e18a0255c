// A USB camera made of a socket: the device's end of USB/IP, plugged into the kernel's virtual host
// controller (vhci_hcd), so that uvcvideo streams from it by isochronous transfers as from a camera on a
// cable. Needs root and vhci_hcd. Protocol: https://docs.kernel.org/usb/usbip_protocol.html; descriptors:
// UVC 1.1, chapter 3; payload headers: 2.4.3.3.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "drivers/network/usbip_codec.h"
#include "drivers/v4l2/uvc_control.h"
#include "rt-core/file_descriptor.h"

namespace rigor::v4l2::test {

/// Plugs in the other end of a USB/IP connection, whose device end is `fd`; empty, or why not.
[[nodiscard]] std::string attach_to_host(int fd);

/// Its pictures are FormulaCamera's, with their number in the first four bytes (little-endian).
class UsbipCamera {
 public:
  /// One frame size for all formats; pictures come at the offer's first interval while the host streams.
  UsbipCamera(uvc::StreamOffer offer, std::string product);
  ~UsbipCamera() { unplug(); }
  UsbipCamera(const UsbipCamera&) = delete;
  UsbipCamera& operator=(const UsbipCamera&) = delete;

  /// Empty, or why not.
  [[nodiscard]] std::string plug();
  /// As a cable that is pulled out: transfers in flight end as they are.
  void unplug();
  [[nodiscard]] bool streams() const { return streams_.load(); }
  /// Pictures whose last packet the host has taken, damaged ones among them.
  [[nodiscard]] std::uint32_t sent() const { return sent_.load(); }
  /// Every n-th picture loses its last packet on the bus; 0: none.
  void damage_every(std::uint32_t n) { damage_every_ = n; }

  /// What picture `number` of `bytes` bytes looks like.
  [[nodiscard]] static std::vector<std::byte> picture(std::uint32_t number, std::size_t bytes);

 private:
  struct Transfer {
    usbip::Header header;
    std::vector<usbip::IsochronousPacket> packets;
  };
  void run();
  [[nodiscard]] bool serve_one();
  [[nodiscard]] bool control(const usbip::Header& header, std::span<const std::uint8_t> data);
  [[nodiscard]] std::vector<std::uint8_t> standard(const uvc::SetupPacket& s, bool& stall);
  [[nodiscard]] bool reply(const usbip::Header& to, std::int32_t status, std::span<const std::uint8_t> data,
                           std::uint32_t out_bytes = 0);
  [[nodiscard]] bool fill(Transfer& t);
  void next_picture();

  std::string product_;
  std::vector<std::uint8_t> configuration_;
  uvc::ControlPipe pipe_;
  std::thread thread_;
  FileDescriptor fd_;
  std::atomic<bool> streams_{false};
  std::atomic<std::uint32_t> sent_{0}, damage_every_{0};
  std::deque<Transfer> waiting_;
  std::vector<std::byte> picture_;  ///< the one that is being sent
  std::size_t done_ = 0;            ///< bytes of it
  bool sending_ = false;
  std::int64_t due_ns_ = 0;  ///< of the next picture, CLOCK_MONOTONIC
};

}  // namespace rigor::v4l2::test

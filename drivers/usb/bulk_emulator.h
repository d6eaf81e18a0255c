// A device of a described frame format, as `backend: usb`, `protocol: bulk` reads it.
//
//   frame: { … }              bulk_frame.h
//   rate_hz: 30
//   as: gadget                a USB device by FunctionFS (ffs_device.h): vendor, product, serial, udc
//   as: tcp                   its bytes on a socket: address (127.0.0.1), port (10941; 0 takes a free one)
//
// A frame that the host does not take before the next is due is not sent; its number is missing then, as a
// device's that has one buffer.
#pragma once

#include <functional>

#include "drivers/usb/bulk_source.h"
#include "drivers/usb/ffs_device.h"
#include "drivers/usb/scip_emulator.h"

namespace rigor::usb {

class BulkEmulator final : public Emulator {
 public:
  ~BulkEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  [[nodiscard]] std::string where() const {
    return end_ ? end_->endpoint() : device_ ? device_->udc() : std::string();
  }
  struct Counters {
    std::atomic<std::uint64_t> frames_sent{0}, frames_cut{0}, frames_skipped{0};
  };
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }
  /// Of a gadget; for tests that pull its plug or make it stall.
  [[nodiscard]] FfsDevice* device() noexcept { return device_.get(); }
  /// Any thread: the endpoint is halted before the next frame. Gadgets only.
  void stall_once() noexcept { stall_ = true; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void run();
  void set_connected(bool is) noexcept { health_.connected.store(is, std::memory_order_release); }
  bool send(std::string_view frame);

  DeviceParts parts_;
  BulkFormat format_;
  Period period_;
  Duration delay_;
  bool gadget_ = true;
  GadgetSettings gadget_settings_;
  std::string address_;
  std::uint16_t port_ = 0;
  std::unique_ptr<WorldFrames> world_;
  std::unique_ptr<DeviceEnd> end_;
  std::unique_ptr<FfsDevice> device_;
  std::atomic<bool> stall_{false};
  Deadline deadline_;
  std::thread thread_;
  Counters counters_;
};

}  // namespace rigor::usb

// The camera of u3v_camera.h on a bus: its descriptors (USB3 Vision 1.0.1, chapter 3), and its endpoints.
//
//   0x01, 0x81   control: commands and acknowledges
//   0x82         events
//   0x83         stream: for each frame its leader, the transfers of its payload, and its trailer
//
// The stream's endpoint holds a few frames that the host has not taken; a frame that finds no room is
// dropped, and its number is missing. One caller at a time.
#pragma once

#include <deque>

#include "drivers/aravis/u3v_camera.h"
#include "drivers/network/usbip_device.h"

namespace rigor::u3v {

inline constexpr std::uint8_t kControlOut = 0x01, kControlIn = 0x81, kEventIn = 0x82, kStreamIn = 0x83;
/// Of pid.codes, for tests; the camera is found by its class, as every USB3 Vision camera is.
inline constexpr std::uint16_t kVendorId = 0x1209, kProductId = 0x000A;

struct UsbDeviceCounters {
  std::uint64_t frames_sent = 0;     ///< the host has taken the trailer
  std::uint64_t frames_dropped = 0;  ///< no room: the host did not take the ones before
  std::uint64_t frames_cut = 0;  ///< stream switched off, endpoint reset or unplugged before the trailer left
  std::uint64_t bytes_sent = 0;
  std::uint64_t attached = 0;
};

class UsbDevice final : public usbip::Device {
 public:
  /// `bus_id`: "1-1".
  UsbDevice(Camera camera, const std::string& bus_id);

  [[nodiscard]] Camera& camera() { return camera_; }
  [[nodiscard]] const Camera& camera() const { return camera_; }
  /// Before each call from outside: what instant it is.
  void set_now(DeviceTime now) { now_ = now; }
  /// Acknowledges and events that are due go to their endpoints.
  void advance(DeviceTime now);
  /// When advance() has something to do next; never() where nothing waits.
  [[nodiscard]] DeviceTime next_due() const;
  /// The frame goes to the stream's endpoint. False: dropped.
  bool send_frame(const Frame& frame);
  void set_plugged(bool is) { usbip::Device::set_plugged(is); }
  [[nodiscard]] const UsbDeviceCounters& counters() const { return counters_; }

 private:
  void on_attach() override;
  void on_detach() override;
  [[nodiscard]] bool on_write(std::uint8_t endpoint, usbip::Bytes data) override;
  void on_sent(std::uint8_t endpoint, std::uint64_t tag) override;
  void on_reset(std::uint8_t endpoint) override;
  void cut_frames();

  Camera camera_;
  DeviceTime now_;
  std::deque<TimedAck> acks_;
  std::size_t frames_waiting_ = 0;
  UsbDeviceCounters counters_;
};

}  // namespace rigor::u3v

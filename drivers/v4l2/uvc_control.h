// What a UVC camera answers on its control pipe: probe and commit of a stream, and refusals of all that it
// does not have. Bytes in, bytes out; no device. By "Universal Serial Bus Device Class Definition for Video
// Devices" 1.1: requests 4.2, probe and commit controls 4.3.1.1 with table 4-47; the error code
// control 4.2.1.2.
//
//   host                                     camera
//   GET_CUR/MIN/MAX/DEF probe            →   what would be streamed
//   SET_CUR probe (format, frame, rate)  →   data stage; the nearest that there is becomes "current"
//   SET_CUR commit                       →   data stage; this is streamed from now on
//   anything else                        →   stall, and the error code says why
//
// The kernel's gadget driver hands these over as UVC_EVENT_SETUP and UVC_EVENT_DATA and takes answers by
// UVCIOC_SEND_RESPONSE (linux/usb/g_uvc.h); a negative length stalls the pipe.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "drivers/network/usbip_codec.h"

namespace rigor::v4l2::uvc {

/// One format as its descriptors number it: formats and frames count from 1; a camera here has one frame
/// size.
struct StreamFormat {
  std::uint32_t code = 0;  ///< FourCC
  std::uint16_t width_px = 0, height_px = 0;
  std::uint32_t frame_bytes = 0;  ///< at most
};
/// Units of 100 ns, as UVC counts intervals.
struct StreamOffer {
  std::vector<StreamFormat> formats;
  std::vector<std::uint32_t> intervals;  ///< the first is the default
  std::uint32_t payload_bytes = 3072;    ///< of one USB transfer, at most
};

/// The probe and commit control's fields.
struct StreamControl {
  std::uint16_t hint = 0;
  std::uint8_t format_index = 1, frame_index = 1;
  std::uint32_t interval = 0, max_frame_bytes = 0, max_payload_bytes = 0;
  friend bool operator==(const StreamControl&, const StreamControl&) = default;
};
inline constexpr std::size_t kControlBytes10 = 26, kControlBytes11 = 34;
/// UVC 1.1's 34 bytes, little-endian.
[[nodiscard]] std::array<std::uint8_t, kControlBytes11> encode(const StreamControl& control) noexcept;
/// 26 bytes (UVC 1.0), 34 (1.1) or more (1.5); empty where there are fewer.
[[nodiscard]] std::optional<StreamControl> decode(std::span<const std::uint8_t> bytes) noexcept;

using usbip::SetupPacket;

struct Answer {
  enum class Kind : std::uint8_t {
    data,    ///< `bytes` go to the host
    expect,  ///< the host's data stage follows: `length` bytes, then data()
    stall    ///< refuse
  } kind = Kind::stall;
  std::array<std::uint8_t, 60> bytes{};
  std::uint32_t length = 0;
};

/// One thread; no allocation after construction.
class ControlPipe {
 public:
  explicit ControlPipe(StreamOffer offer);
  /// Interface numbers within the gadget: 0 controls, 1 streams, unless other functions come first.
  void set_interfaces(std::uint8_t control, std::uint8_t streaming) noexcept;

  [[nodiscard]] Answer setup(const SetupPacket& packet) noexcept;
  /// The data stage that a setup asked to expect. False: it is refused, and nothing changed.
  bool data(std::span<const std::uint8_t> bytes) noexcept;

  /// What the host has committed to; until then the default.
  [[nodiscard]] const StreamControl& committed() const noexcept { return committed_; }
  [[nodiscard]] const StreamOffer& offer() const noexcept { return offer_; }
  /// The nearest that is offered.
  [[nodiscard]] StreamControl nearest(const StreamControl& wanted) const noexcept;

 private:
  [[nodiscard]] StreamControl extreme(bool largest) const noexcept;
  [[nodiscard]] Answer streaming(const SetupPacket& packet) noexcept;
  [[nodiscard]] Answer refuse(std::uint8_t code) noexcept;

  StreamOffer offer_;
  StreamControl probed_, committed_;
  std::uint8_t control_interface_ = 0, streaming_interface_ = 1;
  std::uint8_t expected_ = 0;  ///< selector whose data stage follows; 0: none
  std::uint8_t error_code_ = 0;
};

}  // namespace rigor::v4l2::uvc

// A device that captures, as the source sees it: the ioctl layer (v4l2_device.h) on a wall clock, the model
// of an emulated camera (emulated_capture.h) in virtual time. Negotiation, controls, stamps and conversion
// are above it and the same for both.
//
//   table → set_format → set_control … → start → (wait) next, release … → stop
#pragma once

#include <span>

#include "drivers/v4l2/device_table.h"
#include "drivers/v4l2/negotiation.h"
#include "rt-core/result.h"

namespace rigor::v4l2 {

/// What a device was really set to; may differ from what was asked.
struct ActualFormat {
  std::uint32_t code = 0, width_px = 0, height_px = 0;
  std::uint32_t stride_bytes = 0;  ///< of a row of the first plane; 0 for compressed formats
  std::uint32_t size_bytes = 0;    ///< of a frame, at most
  Interval interval{};             ///< numerator 0: not known
};

/// Which clock a frame's timestamp is of (V4L2_BUF_FLAG_TIMESTAMP_MASK), and what happened then
/// (V4L2_BUF_FLAG_TSTAMP_SRC_MASK).
enum class TimestampClock : std::uint8_t { unknown, monotonic, copied };
enum class TimestampEvent : std::uint8_t { end_of_frame, start_of_exposure };

/// A frame in the device's memory, until it is released.
struct RawFrame {
  std::span<const std::byte> bytes;
  std::uint32_t index = 0;     ///< of the buffer
  std::uint32_t sequence = 0;  ///< the device's count; some devices do not count
  std::int64_t timestamp_ns = 0;
  TimestampClock clock = TimestampClock::monotonic;
  TimestampEvent event = TimestampEvent::end_of_frame;
  bool error = false;  ///< V4L2_BUF_FLAG_ERROR: the driver says that data are missing or wrong
  BenchTime t_taken;   ///< when it was taken from the device
};

enum class FrameStatus : std::uint8_t {
  frame,  ///< `out` is filled
  none,   ///< nothing there yet
  gone,   ///< the device is not there any more (ENODEV)
  broken  ///< it refuses to go on (EIO, EPIPE …): stop and start, or open anew
};

/// One thread at a time.
class CaptureDevice {
 public:
  virtual ~CaptureDevice() = default;
  /// Asked anew each time. Setup context.
  [[nodiscard]] virtual Result<DeviceTable> table() = 0;
  [[nodiscard]] virtual Result<ActualFormat> set_format(const FormatChoice& choice) = 0;
  [[nodiscard]] virtual Status set_control(std::uint32_t id, std::int64_t value) = 0;
  [[nodiscard]] virtual Result<std::int64_t> get_control(std::uint32_t id) = 0;
  /// Takes `buffers` frames' memory and begins to capture. The device may take more or fewer.
  [[nodiscard]] virtual Status start(std::uint32_t buffers) = 0;
  /// The oldest frame that is complete; never waits.
  [[nodiscard]] virtual FrameStatus next(RawFrame& out) = 0;
  /// Gives its memory back to the device. False: the device is gone or broken.
  virtual bool release(const RawFrame& frame) = 0;
  virtual void stop() = 0;
};

}  // namespace rigor::v4l2

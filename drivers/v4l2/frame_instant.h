// From a frame's timestamp to the instant of its measurement, and from the device's count to the channel's.
//
//   first row    |== exposure ==|
//   centre row          |== exposure ==|                  t_capture: the middle of this one
//   last row                   |== exposure ==|
//                ^ start of exposure          ^ end of frame, when the last row is read
//                               |<- readout ->|
//
// A rolling shutter exposes its rows one after the other within the readout; a global one exposes all at once
// and reads out afterwards. So the middle of the centre row's exposure is, from the start of exposure,
// exposure/2 (global) or (exposure + readout)/2 later; from the end of frame, exposure/2 + readout (global)
// or (exposure + readout)/2 earlier.
#pragma once

#include "drivers/v4l2/capture_device.h"

namespace rigor::v4l2 {

struct Shutter {
  Duration exposure{}, readout{};
  bool exposure_known = true;  ///< false: `exposure` is 0, and may be up to the period
  bool global = false;
  Duration period{};  ///< 0: not known
};
/// From the event of the timestamp to the instant of measurement; negative for the end of frame.
[[nodiscard]] Duration event_to_capture(TimestampEvent event, const Shutter& shutter) noexcept;

struct FrameInstant {
  BenchTime t;
  Duration sigma;
  bool sure =
      true;  ///< false: the timestamp is of no clock that is known here; `t` is when the frame was taken
};
/// Monotonic timestamps are bench time in wall runs; one that lies after the frame's arrival is not believed
/// (vivid stamps the end of frames that it hands over at their start). Timestamps of unknown clocks and
/// copied ones (a writer's, as v4l2loopback hands them on) are taken for MONOTONIC or REALTIME, whichever
/// they are within ten seconds of; `realtime_ahead` is REALTIME less MONOTONIC now. Any thread, no
/// allocation.
[[nodiscard]] FrameInstant frame_instant(const RawFrame& frame, const Shutter& shutter,
                                         Duration realtime_ahead) noexcept;

/// The channel's count of captures. It follows the device's, which has 32 bits; where the device begins anew
/// or does not count, the time that went by says how many are missing. One thread; no allocation.
class CaptureCount {
 public:
  /// `period` 0: gaps that only the time could tell are taken for none.
  explicit CaptureCount(Duration period = {}) : period_(period) {}
  struct Step {
    std::uint64_t sequence = 0;
    std::uint64_t lost = 0;  ///< captures between this one and the last
    /// Overtaken by a later capture, with which it was counted as lost: not to be handed on. (uvcvideo copies
    /// the transfers of frames on several processors at once, and hands over what is complete first.)
    bool late = false;
  };
  [[nodiscard]] Step step(std::uint32_t device_sequence, BenchTime t) noexcept;
  /// The device will begin anew (it was reopened).
  void restart() noexcept { device_counts_ = false; }
  /// Captures that are over and never came, if nothing came until `t`; they are then counted.
  [[nodiscard]] std::uint64_t give_up_until(BenchTime t) noexcept;

 private:
  Duration period_;
  bool started_ = false, device_counts_ = false;
  std::uint32_t last_device_ = 0;
  std::uint64_t sequence_ = 0;
  BenchTime t_last_;
};

}  // namespace rigor::v4l2

// What the source of a real video device and its stand-in in virtual time share: keys, negotiation, and the
// way of a frame from the device's memory into a sample.
#pragma once

#include "drivers/v4l2/frame_conversion.h"
#include "drivers/v4l2/v4l2_settings.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::v4l2 {

/// How a device was set, and what that means for its frames.
struct Plan {
  DeviceTable table;
  ActualFormat format;
  Shutter shutter;
  std::vector<std::string> notes;  ///< for warnings()
};

/// Sets format, rate and controls. Errors are at the rig's key and list what the device offers. Setup
/// context, or the I/O thread when the device is back.
[[nodiscard]] Result<Plan> set_up(CaptureDevice& device, const Settings& settings,
                                  const ChannelConfig& config);

class VideoSource : public StreamSource {
 public:
  [[nodiscard]] std::vector<std::string> warnings() const override { return plan_.notes; }
  /// How the device was set. Setup thread, armed or running.
  [[nodiscard]] const Plan& plan() const noexcept { return plan_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  /// Setup thread: takes the memory for samples of this plan, and describes them.
  void open_samples(Plan plan, bool virtual_time);
  /// I/O thread. What is lost before, and what cannot be handed on, is counted; a frame of before the run is
  /// neither. `arrival`: 0 stands for now.
  void deliver(const RawFrame& frame, BenchTime arrival = {});
  /// I/O thread: the device is to be opened anew, and will count anew.
  void restart_count() noexcept { count_.restart(); }
  /// I/O thread: nothing came until `t`.
  void give_up_until(BenchTime t) noexcept;

  Settings settings_;
  Plan plan_;

 private:
  CaptureCount count_;  ///< since the device was opened
  RunSequence in_run_;
  std::unique_ptr<FrameConverter> converter_;
  bool virtual_time_ = false;
};

}  // namespace rigor::v4l2

// A video device in virtual time: the emulated camera in process, behind the same negotiation, controls,
// stamps and conversion as a real one.
#pragma once

#include "drivers/v4l2/emulated_capture.h"
#include "drivers/v4l2/video_source.h"

namespace rigor::v4l2 {

class VirtualSource final : public VideoSource {
 public:
  VirtualSource(DeviceParts parts, ConfigNode emulator_params);
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  DeviceParts parts_;
  ConfigNode emulator_params_;
  EmulatedVideoSettings camera_;
  std::unique_ptr<EmulatedCapture> device_;
};

}  // namespace rigor::v4l2

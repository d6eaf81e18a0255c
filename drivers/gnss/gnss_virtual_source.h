// A receiver in virtual time: the device's model and the decoder in one process, byte for byte what a line
// would carry, without a line, a thread or a clock. Its instants begin with the run.
#pragma once

#include <memory>
#include <optional>

#include "drivers/gnss/config_dialog.h"
#include "drivers/gnss/measured_fix.h"
#include "drivers/gnss/solution_sample.h"

namespace rigor::gnss {

class GnssVirtualSource final : public ReceiverSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  GnssVirtualSource(DeviceParts parts, ConfigNode emulator_params)
      : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}
  ~GnssVirtualSource() override;
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  Status converse();

  DeviceParts parts_;
  ConfigNode emulator_params_;
  ChannelSettings settings_;
  EmulatorSettings emulator_;
  std::optional<MeasuredFix> measured_;
  std::optional<ReceiverDevice> device_;
  std::unique_ptr<ReceiverStream> stream_;
  Period period_;
  BenchTime t0_;
  std::int64_t next_ = 0;
  std::uint64_t bad_seen_ = 0;
  bool running_ = false;
};

}  // namespace rigor::gnss

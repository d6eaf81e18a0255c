// What stands for a SICK scanner in virtual time: the device's model and the client's dialogue in one
// process, telegram for telegram, without a socket, a thread or a clock.
#pragma once

#include <memory>

#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::sick {

class SickVirtualSource final : public StreamSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  SickVirtualSource(DeviceParts parts, ConfigNode emulator_params);
  ~SickVirtualSource() override;
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::sick

// A GigE Vision channel in virtual time: the emulated camera's model and codec in process, datagram for
// datagram, in place of the camera. It takes the keys that the real channel has (aravis_settings.h), sets the
// camera through its registers, and gives what comes back through the stream protocol; without socket, thread
// or clock.
//
// Instants. Free run: the middle of the k-th exposure is t0 + k·period, so that a simulated side measures at
// the same instants. Software trigger and action commands: the exposure begins there, as on a camera that the
// bench triggers. A picture is taken when bench time has reached the middle of its exposure, so that what
// moves is where it is then. t_arrival is t_release: how fast a computer is plays no part.
#pragma once

#include <memory>

#include "drivers/aravis/emulated_camera.h"
#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor {

class GigeVirtualSource final : public StreamSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  GigeVirtualSource(DeviceParts parts, ConfigNode emulator_params);
  ~GigeVirtualSource() override;

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

}  // namespace rigor

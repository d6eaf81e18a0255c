// An emulator: a simulated device that leaves the bench as a real one, over its real protocol.
#pragma once

#include <memory>

#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

/// The parts of a world that an emulated device shows or moves; each may be null where the device has no use
/// for it.
struct DeviceParts {
  std::shared_ptr<ImageProvider> image;
  std::shared_ptr<SampleProvider> samples;
  std::shared_ptr<const MotionSource> motion;
  std::shared_ptr<RegisterModel> registers;
  std::shared_ptr<SignalModel> signals;
};

/// Serves a device on its own threads between start and stop; wall clock only.
/// `health().connected`: a client is there now.
class Emulator : public Channel {
 public:
  virtual void attach(DeviceParts parts) = 0;  ///< before arm
  /// For people and clients: "GigE Vision camera Rigor-left at 127.0.0.1".
  [[nodiscard]] virtual std::string endpoint() const = 0;

 protected:
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
};

}  // namespace rigor

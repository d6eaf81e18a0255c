// The devices' own truth: the world as emulated devices see and move it. A turntable that a Modbus master
// turns, a camera that looks at it. The bench knows of it only what the protocols say.
#pragma once

#include <map>
#include <memory>
#include <string>

#include "bench/sensing/simulation.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::plant {
class Plant;
}

namespace rigor {

class DeviceWorld {
 public:
  /// Opens the rig's world and makes the device models of all its emulators. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<DeviceWorld>> open(const RigConfig& rig);
  ~DeviceWorld();

  /// The parts that the device named so shows or moves; the same model for all who ask. bad_input for unknown
  /// names.
  [[nodiscard]] Result<DeviceParts> parts(std::string_view emulator_name);
  /// What carries devices in their world. In virtual time whoever runs the devices starts them; an emulator
  /// on the wall clock does it when the first device starts.
  [[nodiscard]] std::vector<std::shared_ptr<Platform>> platforms() const;
  /// Plants that its devices show. In virtual time whoever runs the devices arms, starts and stops them.
  [[nodiscard]] std::vector<std::shared_ptr<plant::Plant>> plants() const;
  /// Configures, arms and starts one device as an emulator.
  [[nodiscard]] Result<std::unique_ptr<Emulator>> start_emulator(const EmulatorEntry& entry,
                                                                 const Registry& registry, BenchTime t0);

 private:
  struct Impl;
  explicit DeviceWorld(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

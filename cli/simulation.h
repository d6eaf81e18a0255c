// The world file and the renderer of one process, opened once and shared by its simulated sensors.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/config/rig.h"

namespace rigor {

class Simulation {
 public:
  /// Reads the world; the GPU is opened by the first sensor that needs it. bad_input or not_found with place.
  [[nodiscard]] static Result<std::unique_ptr<Simulation>> open(const SimulationConfig& config);
  ~Simulation();

  /// A camera over this world. Reads the keys `sensor` and `T_world_sensor` of `params`; the noise draws are
  /// keyed by seed and `name`. `ideal`: without the sensor's errors.
  [[nodiscard]] Result<std::shared_ptr<ImageProvider>> camera(ConfigNode params, std::uint64_t seed,
                                                              const std::string& name, bool ideal = false);
  /// Index of a joint in WorldMotion. bad_input with the joints that exist.
  [[nodiscard]] Result<std::size_t> joint(const std::string& name) const;
  [[nodiscard]] std::size_t joint_count() const;
  /// Which device renders, for reports; empty before the first sensor.
  [[nodiscard]] std::string engine() const;

  /// `rigor doctor`: Vulkan devices and what they are.
  [[nodiscard]] static std::vector<DoctorFinding> doctor();

 private:
  struct Impl;
  explicit Simulation(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

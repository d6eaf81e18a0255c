// The world of one process, opened once and shared by its simulated sensors, and what makes sensors of a
// rig's keys.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bench/sensing/clearance.h"
#include "bench/sensing/engine_choice.h"
#include "bench/sensing/sensors.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// How a sensor is made beside what its keys say.
struct SensorOptions {
  bool ideal = false;                    ///< without the sensor's errors
  std::vector<std::string> only;         ///< of its effects these alone; empty: all that it has
  std::optional<EngineChoice> choice;    ///< in place of `renderer` and `quality`
  std::shared_ptr<SensorTimes> times{};  ///< null: nobody asks
  std::optional<Mount> mount{};          ///< in place of what the keys say of its pose
  std::optional<std::uint64_t> draw{};   ///< in place of `calibration_draw`
};

class Simulation {
 public:
  /// Reads the world; engines are made by the first sensor that needs them. bad_input or not_found with
  /// place.
  [[nodiscard]] static Result<std::unique_ptr<Simulation>> open(const SimulationConfig& config);
  ~Simulation();

  /// A camera over this world. Reads the keys `sensor`, `ideal`, `T_world_sensor`, `parent`, `motion`,
  /// `renderer`, `quality` and `tolerance` of `params`; the noise draws are keyed by seed and `name`. Without
  /// `renderer`, `scene` draws what it can, and `rays` the rest. bad_input with the reason where `scene` was
  /// asked for and cannot.
  [[nodiscard]] Result<std::shared_ptr<ImageProvider>> camera(ConfigNode params, std::uint64_t seed,
                                                              const std::string& name,
                                                              const SensorOptions& options = {});
  /// A LiDAR (kind point_cloud) or a time-of-flight camera (range_image); keys as above.
  [[nodiscard]] Result<std::shared_ptr<TruthfulSampler>> sampler(SampleKind kind, ConfigNode params,
                                                                 std::uint64_t seed, const std::string& name,
                                                                 const SensorOptions& options = {});
  /// An inertial unit, a satellite receiver, odometry (bench/sensing/inertial.h says which keys); `period`:
  /// between captures.
  [[nodiscard]] Result<std::shared_ptr<SampleProvider>> inertial(SampleKind kind, ConfigNode params,
                                                                 std::uint64_t seed, const std::string& name,
                                                                 Duration period,
                                                                 const SensorOptions& options = {});
  /// A camera by an engine, whose light and truth can be had; as `camera`.
  [[nodiscard]] Result<std::shared_ptr<SensedCamera>> sensed_camera(ConfigNode params, std::uint64_t seed,
                                                                    const std::string& name,
                                                                    const SensorOptions& options = {});

  /// Index of a joint in WorldMotion: a hinged node's name, or PLATFORM.JOINT. bad_input with the joints that
  /// exist.
  [[nodiscard]] Result<std::size_t> joint(const std::string& name) const;
  [[nodiscard]] std::size_t joint_count() const;
  /// Of the rig's `simulation.platforms`, in their order, which is that of bodies in WorldMotion. The models
  /// are this world's own.
  [[nodiscard]] const std::vector<WorldPlatform>& platforms() const;
  /// Index of a platform. bad_input with the platforms that there are.
  [[nodiscard]] Result<std::size_t> platform(const std::string& name) const;
  /// Joints at zero, platforms at their start.
  [[nodiscard]] WorldMotion motion_at_rest() const;
  /// Which engines measure, for reports; empty before the first sensor.
  [[nodiscard]] std::string engine() const;
  [[nodiscard]] const SensorWorld& world() const;
  /// SensorWorld::edit; what the renderer `scene` draws follows. Any thread.
  [[nodiscard]] Status edit(world::NodeId node, const std::string& attribute, world::Value value);
  /// SensorWorld::assign. The renderer `scene` does not follow.
  [[nodiscard]] Status assign(const std::vector<std::string>& assignments);
  /// Where a mount is at the start, with the world as a motion has it.
  [[nodiscard]] Eigen::Isometry3d T_world_sensor(const Mount& mount, const WorldMotion& motion);
  /// What says how near things stand to a point. Setup thread; this outlives it.
  [[nodiscard]] Result<std::unique_ptr<ClearanceProbe>> clearance_probe();

  /// `rigor doctor`: Vulkan devices and what they are.
  [[nodiscard]] static std::vector<DoctorFinding> doctor();

 private:
  struct Impl;
  explicit Simulation(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

// Simulated sensors behind the HAL's providers: a simulator, its engine, and the way through the world.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bench/sensing/engine_choice.h"
#include "bench/sensing/mount.h"
#include "rt-core/stage_time.h"
#include "sim/render/device.h"
#include "sim/render/rays/embree_engine.h"
#include "sim/sensors/camera/simulated_camera.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "sim/sensors/measurement.h"
#include "sim/sensors/tof/tof_simulator.h"

namespace rigor {

/// What the sensors of a process share. Made when the first sensor needs it. Setup thread.
class SensingResources {
 public:
  explicit SensingResources(std::string device_name) : device_name_(std::move(device_name)) {}
  [[nodiscard]] Result<std::shared_ptr<render::Device>> device();
  [[nodiscard]] Result<std::shared_ptr<render::EmbreeCache>> cache();
  /// Of all cameras that trace rays.
  [[nodiscard]] Result<std::shared_ptr<SharedLight>> light();
  /// "raster on llvmpipe…", "rays", both; empty before the first sensor.
  [[nodiscard]] std::string text() const;

 private:
  std::string device_name_;
  std::shared_ptr<render::Device> device_;
  std::shared_ptr<render::EmbreeCache> cache_;
  std::shared_ptr<SharedLight> light_;
};

/// Where the time of a simulated sensor goes.
struct SensorTimes {
  StageTime whole;    ///< a capture
  StageTime world;    ///< of it: waiting for the world, and bringing it to the instant
  StageTime collect;  ///< of it: asking the world for its content, and waiting for that
  StageTime prepare;  ///< of it: taking over what is new in the content
  StageTime light;    ///< of it: the engine: drawing, casting rays; where `prepare` is not known, that too
};

/// All that makes one sensor, whatever its kind.
struct SensorSetup {
  std::string name;  ///< keys the noise, with the seed
  std::uint64_t seed = 0;
  bool ideal = false;  ///< without its errors
  Mount mount;
  EngineChoice choice;
  std::shared_ptr<SensorTimes> times{};  ///< null: nobody asks
};

/// A LiDAR or a time-of-flight camera. Truth of the captures that follow goes to `truth`; null: none.
class TruthfulSampler : public SampleProvider {
 public:
  void set_truth(GroundTruth* truth) { truth_ = truth; }
  /// Of a range image: each pixel's ray in the sensor's frame, unit length, NaN where the lens has none.
  [[nodiscard]] virtual std::vector<std::array<float, 3>> directions() const { return {}; }
  /// Of a range image: its lens; empty for point clouds.
  [[nodiscard]] virtual std::optional<CameraModel> lens() const { return std::nullopt; }

 protected:
  GroundTruth* truth_ = nullptr;
};

/// Errors: bad_input (the model), unavailable (the engine).
[[nodiscard]] Result<std::shared_ptr<TruthfulSampler>> make_lidar(const SensorSetup& setup,
                                                                  const models::LidarModel& model,
                                                                  SensorWorld& world,
                                                                  SensingResources& resources);
[[nodiscard]] Result<std::shared_ptr<TruthfulSampler>> make_tof(const SensorSetup& setup,
                                                                const models::TofModel& model,
                                                                SensorWorld& world,
                                                                SensingResources& resources);

class SensedCamera : public ImageProvider {
 public:
  virtual void set_truth(GroundTruth* truth) = 0;
  /// The light on the sensor of the last capture.
  [[nodiscard]] virtual const OpticsPicture& light() const = 0;
  [[nodiscard]] virtual const CameraModel& model() const = 0;
};
/// What the optics of a camera make of a choice. `model` as its sensor model has it.
[[nodiscard]] OpticsOptions optics_of(const EngineChoice& choice, const CameraModel& model);
[[nodiscard]] Result<std::shared_ptr<SensedCamera>> make_camera(const SensorSetup& setup,
                                                                const CameraModel& model, PixelFormat format,
                                                                Duration exposure, double supersampling,
                                                                SensorWorld& world,
                                                                SensingResources& resources);

}  // namespace rigor

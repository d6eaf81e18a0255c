// A simulated channel of a dataset: the device of the moment, and what it sees.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "bench/dataset/dataset.h"
#include "bench/sensing/simulation.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::dataset {

/// In place of what the channel says; empty: that.
struct Exposure {
  std::optional<double> exposure_us, gain_db;
};

class Device {
 public:
  struct Setup {
    const RigConfig& rig;
    const ChannelEntry& entry;
    ConfigNode params;
    Simulation& simulation;
    Mount mount;
    std::uint64_t seed = 0;
    std::string renderer;
    bool truth = false;
  };
  /// The device of the sensor model itself. What the setup refers to outlives it. bad_input with place.
  [[nodiscard]] static Result<std::unique_ptr<Device>> create(const Setup& setup);
  /// bad_input: the sensor model says nothing about how sure its numbers are.
  [[nodiscard]] Status can_be_drawn() const;
  /// From now on device number `draw` of those that the sensor model describes, with noise of its own; 0: the
  /// model.
  [[nodiscard]] Status become(std::uint64_t draw);
  /// Fills all of a view but its pose, depths and labels.
  [[nodiscard]] Status capture(std::uint64_t index, const WorldMotion& motion, const Exposure& exposure,
                               DatasetView& view);
  /// Of images and range images: depth of each element, m.
  [[nodiscard]] std::vector<float> depth_of(const GroundTruth& truth) const;

 private:
  explicit Device(const Setup& setup) : setup_(setup) {}
  [[nodiscard]] Status make(std::uint64_t draw);

  Setup setup_;
  std::uint64_t draw_ = 0;
  std::shared_ptr<SensedCamera> camera_;
  std::shared_ptr<TruthfulSampler> sampler_;
  std::optional<CameraModel> lens_;
  std::vector<float> axial_;  ///< of each pixel's ray: its part along the optical axis
  Sample sample_;
};

}  // namespace rigor::dataset

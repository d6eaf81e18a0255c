// Labelled data from a rig: samples of its simulated sensors with the truth, one at a time.
//
//   auto options = load_dataset_options("data.yaml");
//   auto dataset = Dataset::create(*options);
//   while (auto sample = (*dataset)->next())           // Result<std::optional<DatasetSample>>
//     for (const DatasetView& view : (*sample)->views) train(view.pixels, view.labels);
//
// Sample k is a function of the options, the files that the rig names, and k: it is the same whatever was
// made before it, by whichever process and on any number of threads. Poses that lie off the terrain, below
// it, or within `clearance_m` of anything are rejected: of a distribution the next draw is taken, of a list
// the sample is left out.
//
// What a pose places is the *carrier*: the platform that all channels ride on; or, of channels with a
// T_world_sensor, a level frame at the first one's place that looks its way (so that what the rig tilts down
// stays tilted down), with the others fixed to it. The capture has index k, at the start of the bench's time.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bench/dataset/dataset_options.h"
#include "bench/dataset/instances.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/sample.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct RigConfig;

/// What one channel saw. Elements are pixels row by row, or points in their order.
struct DatasetView {
  std::string channel;
  SampleKind kind = SampleKind::none;  ///< image, range_image, point_cloud
  std::uint64_t device = 0;            ///< calibration_draw
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();
  std::optional<CameraModel> lens;      ///< of images and range images
  std::uint32_t width = 0, height = 0;  ///< points: count, 1

  ImageInfo image;                        ///< images
  std::vector<std::byte> pixels;          ///< images
  std::vector<float> range_m, amplitude;  ///< range images, as measured; NaN: no return
  std::vector<LidarPoint> points;         ///< point clouds

  // Truth, where it was asked for; else empty.
  GroundTruth truth;           ///< nodes, ranges, normals, flow
  std::vector<float> depth_m;  ///< along the optical axis; infinity: nothing there. Images and range images
  DatasetLabels labels;        ///< boxes of images and range images alone; classes of points, too
};

struct DatasetRejection {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  std::string reason;  ///< "off the terrain", "below the ground", "near Tree": one of few, to be counted
  std::string detail;  ///< "Tree 17 at 0.21 m"
};

struct DatasetSample {
  std::uint64_t index = 0;
  std::string split;  ///< train, val, test
  Eigen::Isometry3d T_world_carrier = Eigen::Isometry3d::Identity();
  std::vector<std::pair<std::string, std::string>> conditions;  ///< of `vary`; empty value: not in force
  std::vector<DatasetRejection> rejected;                       ///< poses that were tried before
  std::vector<DatasetView> views;  ///< by channel; empty: all poses were rejected
};

/// Where the time went.
struct DatasetTimes {
  double pose_s = 0;     ///< looking for poses
  double world_s = 0;    ///< bringing the world to a sample's conditions, making devices
  double capture_s = 0;  ///< measuring, truth included
  double label_s = 0;
};

class Dataset {
 public:
  /// Opens the rig and its world, and checks everything but what only a sample can show. Setup thread.
  /// bad_input, not_found with place; unavailable.
  [[nodiscard]] static Result<std::unique_ptr<Dataset>> create(const DatasetOptions& options);
  ~Dataset();

  [[nodiscard]] const DatasetOptions& options() const;
  [[nodiscard]] std::uint64_t size() const;  ///< samples, those that will be left out included
  [[nodiscard]] const std::vector<DatasetCategory>& categories() const;
  struct Channel {
    std::string name;
    SampleKind kind = SampleKind::none;
    bool drawn = false;  ///< each sample by another device
  };
  [[nodiscard]] const std::vector<Channel>& channels() const;
  /// All that makes the samples what they are: options, version, digests of the rig and of the files that it
  /// names.
  [[nodiscard]] nlohmann::json manifest() const;
  /// Files that are read, for checks of outputs.
  [[nodiscard]] const RigConfig& rig() const;

  /// Blocks for as long as pictures take; one thread at a time, always the same. Errors: bad_input (a value
  /// that the world refuses), unavailable (an engine).
  [[nodiscard]] Result<DatasetSample> sample(std::uint64_t index);
  /// The next one that is not left out; empty behind the last.
  [[nodiscard]] Result<std::optional<DatasetSample>> next();
  void seek(std::uint64_t index);  ///< of the sample that `next` begins with

  [[nodiscard]] const DatasetTimes& times() const;

  /// Draws of a pose before a sample is left out.
  static constexpr std::uint32_t kAttempts = 100;

 private:
  struct Impl;
  explicit Dataset(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

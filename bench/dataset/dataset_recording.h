// A dataset as one MCAP file of ROS 2 messages, for Foxglove and whatever reads recordings. Sample k has the
// log time of k seconds:
//
//   /right/image             sensor_msgs/Image, with the companions of recordings
//   (sensor-hal/record/sample_codec.h) /right/camera_info       sensor_msgs/CameraInfo, of images and range
//   images /right/truth/depth       sensor_msgs/Image 32FC1; also instance 16UC1, class 8UC1, true_range
//   32FC1, normal 32FC3,
//                            flow 32FC2; of point clouds /top/truth, sensor_msgs/PointCloud2 with class, node
//                            and true range
//   /tf                      T_world_sensor of each channel
//   /samples                 JSON: pose, conditions, split, lens, boxes; written last: the sample is whole
//
// The metadata `rigor.dataset` holds the manifest and the categories. The file grows under a name beside its
// own,
// `.NAME.part`, and gets its name when all that was asked for is there.
#pragma once

#include <memory>

#include "bench/dataset/dataset_output.h"

namespace rigor {

class DatasetRecording final : public DatasetOutput {
 public:
  /// As DatasetOutput::open.
  [[nodiscard]] static Result<std::unique_ptr<DatasetRecording>> open(const std::filesystem::path& file,
                                                                      const Dataset& dataset,
                                                                      const DatasetOutputOptions& options);
  /// Without finish() what is whole stays beside the file, and the next call goes on with it.
  ~DatasetRecording() override;

  [[nodiscard]] bool has(std::uint64_t index) const override;
  [[nodiscard]] Status write(const DatasetSample& sample) override;
  [[nodiscard]] Result<DatasetSummary> finish() override;

 private:
  struct Impl;
  explicit DatasetRecording(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

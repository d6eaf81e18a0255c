// Where the samples of a dataset go: a folder (dataset_folder.h) or an MCAP file (dataset_recording.h). Both
// grow sample by sample, and can be continued.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bench/dataset/dataset.h"

namespace rigor {

struct DatasetOutputOptions {
  /// Truth beside boxes, of images and range images: depth, instance, class, true_range, normal, flow.
  std::vector<std::string> layers{"depth", "instance", "class"};
  bool exr = false;                ///< layers of numbers as OpenEXR in place of NPY
  std::uint32_t min_area_px = 16;  ///< annotations with fewer visible pixels are left away
};
[[nodiscard]] const std::vector<std::string>& dataset_layers();

struct DatasetSummary {
  std::uint64_t samples = 0;                                    ///< with views
  std::uint64_t left_out = 0;                                   ///< whose poses were all rejected
  std::uint64_t annotations = 0;                                ///< boxes
  std::vector<std::pair<std::string, std::uint64_t>> rejected;  ///< poses, by reason
};

class DatasetOutput {
 public:
  /// By the name's ending: `.mcap` is a file, everything else a folder. Makes it, or takes one that was made
  /// with the same manifest, and holds it until it is destroyed. What an earlier process left unfinished is
  /// removed. Errors: bad_input (made with other options, with what differs; something else is there; another
  /// process holds it), not_writable, disk_full. The dataset outlives this.
  [[nodiscard]] static Result<std::unique_ptr<DatasetOutput>> open(const std::filesystem::path& path,
                                                                   const Dataset& dataset,
                                                                   const DatasetOutputOptions& options);
  virtual ~DatasetOutput() = default;

  /// Whether a sample is whole, one that was left out included. Any thread but while it writes.
  [[nodiscard]] virtual bool has(std::uint64_t index) const = 0;
  /// One thread, which may be another than the dataset's. disk_full, not_writable, io.
  [[nodiscard]] virtual Status write(const DatasetSample& sample) = 0;
  /// After the last write of this call.
  [[nodiscard]] virtual Result<DatasetSummary> finish() = 0;
};

/// `options` with their layers in one order, of a dataset without truth none. bad_input: a layer that does
/// not exist.
[[nodiscard]] Result<DatasetOutputOptions> checked_output_options(DatasetOutputOptions options,
                                                                  const Dataset& dataset);

}  // namespace rigor

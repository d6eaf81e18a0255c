// A dataset as a folder, which grows sample by sample and can be continued:
//
//   dataset.json                 what the samples are made of: options, version, digests of inputs
//   left/image/000007.png        a folder for each channel and layer
//   samples/000007.json          pose, conditions, files, lens, boxes; written behind the layers: it is whole
//   annotations/left_train.json  COCO, at the end; also val, test
//   splits/train.txt             numbers of samples, at the end
//   README.md                    what is what, at the end
//
// Every file is written under another name and renamed when it is whole. No file holds a date or a duration:
// the same options give the same bytes, however often the work was broken off.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "bench/dataset/dataset.h"

namespace rigor {

struct DatasetFolderOptions {
  /// Truth beside boxes, of images and range images: depth, instance, class, true_range, normal, flow.
  std::vector<std::string> layers{"depth", "instance", "class"};
  bool exr = false;                ///< layers of numbers as OpenEXR in place of NPY
  std::uint32_t min_area_px = 16;  ///< annotations with fewer visible pixels are left away
};
[[nodiscard]] const std::vector<std::string>& dataset_layers();

class DatasetFolder {
 public:
  /// Makes the folder, or takes one that was made with the same manifest, and holds it until it is destroyed.
  /// What an earlier process left unfinished is removed. Errors: bad_input (made with other options, with
  /// what differs; other things are in it; another process holds it), not_writable, disk_full. The dataset
  /// outlives this.
  [[nodiscard]] static Result<std::unique_ptr<DatasetFolder>> open(const std::filesystem::path& dir,
                                                                   const Dataset& dataset,
                                                                   const DatasetFolderOptions& options);
  ~DatasetFolder();
  DatasetFolder(const DatasetFolder&) = delete;
  DatasetFolder& operator=(const DatasetFolder&) = delete;

  /// Whether a sample is whole, one that was left out included. Any thread but while it writes.
  [[nodiscard]] bool has(std::uint64_t index) const;
  /// One thread, which may be another than the dataset's. disk_full, not_writable, io.
  [[nodiscard]] Status write(const DatasetSample& sample);

  struct Summary {
    std::uint64_t samples = 0;                                    ///< with views
    std::uint64_t left_out = 0;                                   ///< whose poses were all rejected
    std::uint64_t annotations = 0;                                ///< boxes
    std::vector<std::pair<std::string, std::uint64_t>> rejected;  ///< poses, by reason
  };
  /// Annotations, splits and README of all samples that are whole.
  [[nodiscard]] Result<Summary> finish();

 private:
  struct Impl;
  explicit DatasetFolder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

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

#include "bench/dataset/dataset_output.h"

namespace rigor {

class DatasetFolder final : public DatasetOutput {
 public:
  /// As DatasetOutput::open.
  [[nodiscard]] static Result<std::unique_ptr<DatasetFolder>> open(const std::filesystem::path& dir,
                                                                   const Dataset& dataset,
                                                                   const DatasetOutputOptions& options);
  ~DatasetFolder() override;
  DatasetFolder(const DatasetFolder&) = delete;
  DatasetFolder& operator=(const DatasetFolder&) = delete;

  [[nodiscard]] bool has(std::uint64_t index) const override;
  [[nodiscard]] Status write(const DatasetSample& sample) override;

  /// Annotations, splits and README of all samples that are whole.
  [[nodiscard]] Result<DatasetSummary> finish() override;

 private:
  struct Impl;
  explicit DatasetFolder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor

// Makes the samples that the output of a dataset lacks.
#pragma once

#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include "bench/dataset/dataset_output.h"
#include "rt-core/stop.h"

namespace rigor {

struct FillOptions {
  /// Samples from first to last, both included; empty: all.
  std::vector<std::pair<std::uint64_t, std::uint64_t>> only;
  int threads = 0;  ///< that measure; with two or more, another one writes. 0: as many as the machine has
  StopToken stop;   ///< asked between samples: what is whole then is finished
};
struct Filled {
  DatasetSummary summary;             ///< of all that the output has
  std::uint64_t made = 0, there = 0;  ///< now, and before
  double whole_s = 0, write_s = 0;    ///< wall time; the writer's share may overlap with measuring
  DatasetTimes times;
};
/// Shows its progress. What was whole before an error stays; the same call continues. Errors: those of
/// Dataset::sample and DatasetOutput.
[[nodiscard]] Result<Filled> fill_dataset(Dataset& dataset, DatasetOutput& output,
                                          const FillOptions& options);

}  // namespace rigor

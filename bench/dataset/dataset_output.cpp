#include "bench/dataset/dataset_output.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "bench/dataset/dataset_folder.h"
#include "bench/dataset/dataset_recording.h"

namespace rigor {

const std::vector<std::string>& dataset_layers() {
  static const std::vector<std::string> kLayers{"depth", "instance", "class", "true_range", "normal", "flow"};
  return kLayers;
}

Result<DatasetOutputOptions> checked_output_options(DatasetOutputOptions options, const Dataset& dataset) {
  for (const std::string& layer : options.layers)
    if (std::find(dataset_layers().begin(), dataset_layers().end(), layer) == dataset_layers().end())
      return fail(ErrorCode::bad_input, "layers",
                  fmt::format("expected some of {}, got \"{}\"", fmt::join(dataset_layers(), ", "), layer));
  std::vector<std::string> layers;
  for (const std::string& layer : dataset_layers())
    if (dataset.options().truth &&
        std::find(options.layers.begin(), options.layers.end(), layer) != options.layers.end())
      layers.push_back(layer);
  options.layers = std::move(layers);
  return options;
}

Result<std::unique_ptr<DatasetOutput>> DatasetOutput::open(const std::filesystem::path& path,
                                                           const Dataset& dataset,
                                                           const DatasetOutputOptions& options) {
  const auto given = [](auto opened) -> Result<std::unique_ptr<DatasetOutput>> {
    if (!opened) return tl::unexpected<Error>(opened.error());
    return std::unique_ptr<DatasetOutput>(std::move(*opened));
  };
  if (path.extension() == ".mcap") return given(DatasetRecording::open(path, dataset, options));
  return given(DatasetFolder::open(path, dataset, options));
}

}  // namespace rigor

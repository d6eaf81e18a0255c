// Options of a dataset as people write them, on the command line or in Python, on top of a dataset's file or
// a rig.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bench/dataset/dataset_options.h"

namespace rigor {

/// Each as it was written; empty: not given. Ranges are "1..2", lists have commas.
struct DatasetTexts {
  std::filesystem::path source;  ///< a rig, by name or file, or a dataset's file
  std::filesystem::path poses, along;
  std::vector<std::string> overrides;  ///< of the rig: path.to.key=value
  std::vector<std::string> vary;       ///< KEY=VALUES
  std::string channels, samples, within, height, yaw, pitch, roll, lateral, seed, clearance, split, renderer;
  bool draw_devices = false;
  std::optional<bool> truth;
  std::string dashes = "--";  ///< before the names of options in messages
};

/// bad_input with the option's name; of a dataset's file, not_found or bad_input with its place.
[[nodiscard]] Result<DatasetOptions> read_dataset_options(const DatasetTexts& texts);

/// The words between commas; none of an empty text.
[[nodiscard]] std::vector<std::string> words_of_list(const std::string& text);
/// bad_input at `where`.
[[nodiscard]] Result<std::uint64_t> whole_number(const std::string& text, const std::string& where,
                                                 std::uint64_t least, std::uint64_t most);

}  // namespace rigor

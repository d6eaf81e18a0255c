// An FMU in a folder of its own, for as long as somebody needs it.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rt-core/result.h"
#include "sim/fmu/model_description.h"

namespace rigor::fmu {

/// What `rigor inspect` and a rig ask of an FMU before it is unpacked.
struct FmuFile {
  ModelDescription description;
  std::vector<std::string>
      platforms;  ///< that it has binaries for, as it names them: "linux64", "x86_64-linux"
};
/// not_found, bad_input with file and line. Setup context.
[[nodiscard]] Result<FmuFile> read_fmu(const std::filesystem::path& file);

class UnpackedFmu {
 public:
  /// Unpacks the description, the binaries for this machine and the resources under TMPDIR. bad_input: no
  /// co-simulation FMU for this machine.
  [[nodiscard]] static Result<std::unique_ptr<UnpackedFmu>> open(const std::filesystem::path& file);
  /// Removes the folder.
  ~UnpackedFmu();
  UnpackedFmu(const UnpackedFmu&) = delete;
  UnpackedFmu& operator=(const UnpackedFmu&) = delete;

  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  [[nodiscard]] const ModelDescription& description() const { return description_; }

 private:
  UnpackedFmu() = default;
  std::filesystem::path folder_;
  ModelDescription description_;
};

/// The description in such a folder.
[[nodiscard]] Result<ModelDescription> read_description(const std::filesystem::path& folder);
/// The shared object of an unpacked FMU for this machine. not_found.
[[nodiscard]] Result<std::filesystem::path> binary_of(const std::filesystem::path& folder,
                                                      const ModelDescription& description);

/// Values that variables get before the initialisation: names and values as text, of arrays with spaces
/// between.
using StartValues = std::vector<std::pair<std::string, std::string>>;
/// Whether they can be set (parameters, inputs, variables with a start value), and what of structural
/// parameters they change in the description. bad_input at `where` with the name and the nearest one.
[[nodiscard]] Status apply_start_values(ModelDescription& description, const StartValues& values,
                                        const std::string& where);

}  // namespace rigor::fmu

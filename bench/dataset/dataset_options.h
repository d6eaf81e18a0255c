// What a dataset is made of: by a file, and by options on top of it.
//
//   rig: ../demo.yaml
//   set: [channels.right.rate_hz=10]        # values of the rig
//   channels: [right]                       # simulated ones that look; all of them
//   samples: 100                            # of a list of poses: one for each
//   seed: 7
//   poses: { within: [-3, -4, 3, -2], height_m: 0.5..2, yaw_deg: 60..120, pitch_deg: 0..10 }
//   poses: { file: poses.csv }              # or a list; or
//   poses: { along: path.csv, lateral_m: -0.5..0.5 }
//   clearance_m: 0.5                        # poses nearer to anything are rejected
//   vary: { simulation.weather: [clear, fog], joint.turntable: 0..360 }
//   draw_devices: true
//   truth: true
//   renderer: rays
//   split: { train: 80, val: 10, test: 10 }
//
// All samples are functions of this alone, and of the files that the rig names.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "bench/dataset/poses.h"
#include "bench/dataset/variation.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

struct DatasetOptions {
  std::filesystem::path rig;
  std::vector<ConfigOverride> overrides;  ///< of the rig
  std::vector<std::string> channels;      ///< empty: all that are simulated and look
  std::uint64_t samples = 0;              ///< 0: as many as listed poses
  std::uint64_t seed = 1;
  dataset::PoseChoice poses;
  double clearance_m = 0.5;  ///< 0 to ClearanceProbe::kReach_m; 0: poses are not looked at
  std::vector<dataset::Variation> vary;
  bool draw_devices =
      false;  ///< each sample by another device of those that the models' covariances describe
  bool truth = true;
  std::string renderer;                     ///< "rays", "raster"; empty: what the rig says, else rays
  std::array<double, 3> split{80, 10, 10};  ///< weights of train, val, test

  static constexpr std::uint64_t kMostSamples = 10'000'000;

  /// What makes samples what they are, but for the rig's files. Files by their names alone.
  [[nodiscard]] nlohmann::json json() const;
};

/// Whether a file describes a dataset: it has the key `rig`. False where it cannot be read.
[[nodiscard]] bool is_dataset_file(const std::filesystem::path& file);
/// not_found; bad_input with file:line:column. Relative paths are meant against the file's folder.
[[nodiscard]] Result<DatasetOptions> load_dataset_options(const std::filesystem::path& file);

namespace dataset {
/// "80,10,10": three weights that are not all 0. bad_input.
[[nodiscard]] Result<std::array<double, 3>> parse_split(const Written& written);
/// "x0,y0,x1,y1". bad_input.
[[nodiscard]] Result<std::array<double, 4>> parse_rectangle(const Written& written);
/// Limits of what poses may be.
inline constexpr double kMostHeight_m = 1e4, kMostAngle_deg = 3600, kMostLateral_m = 1000;
}  // namespace dataset

}  // namespace rigor

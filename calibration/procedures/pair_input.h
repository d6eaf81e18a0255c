// A recorded pair as the input of `rigor calibrate pair`: both sides' samples of the same instants, and what
// the rig says of the simulated side.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "calibration/pair/pair_model.h"
#include "rt-core/result.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

struct RecordedPair {
  std::filesystem::path recording;
  std::string channel;
  SampleKind kind = SampleKind::none;
  std::filesystem::path sensor_model_file;  ///< of the simulated side; empty: its channel has none
  std::string rig_file;                     ///< that was read, or of which the recording holds a copy
  std::vector<std::string> register_names, register_units;
  /// Where the simulated side sits in the rig: the key (`T_world_sensor`, `T_parent_sensor`), empty where
  /// there is none.
  std::string mount_key;
  Eigen::Isometry3d T_parent_sensor = Eigen::Isometry3d::Identity();
  ChannelEntry entry;  ///< of the rig
  BenchTime t0;        ///< of the run; that of its first pair where the recording does not say
  bool t0_known = false;
  /// Captures that count, since t0.
  double from_s = -std::numeric_limits<double>::infinity();
  double until_s = std::numeric_limits<double>::infinity();
  bool above_ground = false;  ///< z of the position counts from the terrain
  std::vector<std::string> warnings;
};

/// `rig`: empty, then the copy in the recording is read. Errors: not_found; bad_input: no recording of a run,
/// no pair in it, no such channel (those that there are are listed), no pair of that name, a kind that has no
/// model.
[[nodiscard]] Result<RecordedPair> find_recorded_pair(const std::filesystem::path& recording,
                                                      const std::filesystem::path& rig,
                                                      const std::string& channel);

/// Gives every two samples of one instant, in order of the recording; what has no partner within 64 samples
/// is passed over and counted in `alone`. Errors: protocol.
[[nodiscard]] Status read_pairs(const RecordedPair& pair, const calibration::TakePair& take,
                                std::uint64_t& alone);

}  // namespace rigor

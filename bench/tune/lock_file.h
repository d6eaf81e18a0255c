// RIG.lock.yaml, beside the rig: what `rigor tune` chose for this machine and this world, and for what it was
// chosen.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "bench/sensing/engine_choice.h"
#include "bench/sensing/tolerance.h"
#include "sensor-hal/rig/rig.h"
#include "sim/world/graph/snapshot.h"

namespace rigor {

struct LockedChannel {
  EngineChoice choice;
  double p50_ms = 0, max_ms = 0;                        ///< as Trial has them
  double range_rmse_m = 0, outliers = 0, radiance = 0;  ///< as Tolerance has them
  std::string digest;  ///< of the world, the channel's keys and its sensor's file
};

struct LockFile {
  std::string cpu, gpu;
  std::map<std::string, LockedChannel> channels;
};

[[nodiscard]] std::filesystem::path lock_path(const std::filesystem::path& rig);
/// Empty where there is no such file. bad_input with place.
[[nodiscard]] Result<std::optional<LockFile>> load_lock(const std::filesystem::path& file);
/// Errors of write_output. Whole or not at all.
[[nodiscard]] Status save_lock(const std::filesystem::path& file, const LockFile& lock);

/// Of everything in a world that lasts, whatever file it came from. Pictures and models that it names are not
/// looked into.
[[nodiscard]] std::string world_digest(const world::Snapshot& world);
/// Of one simulated channel in it. not_found: the sensor's file.
[[nodiscard]] Result<std::string> channel_digest(const std::string& world_digest, const ConfigNode& params);
/// "Intel(R) Xeon(R) …".
[[nodiscard]] std::string cpu_name();

}  // namespace rigor

// Which engine each simulated channel of a rig measures by: what the rig names, what its lock file holds, or
// what is measured on the spot.
//
//   engine named                         that one
//   no engine, no tolerance              the default of the kind
//   no engine, a tolerance, a lock       the lock's, refused where it was made for something else
//   the same without a lock              wall time: measured now; virtual time: an error
#pragma once

#include <map>
#include <optional>
#include <string>

#include "bench/sensing/engine_choice.h"
#include "bench/sensing/simulation.h"
#include "bench/tune/lock_file.h"

namespace rigor {

/// By channel; those that are not in it go by their keys alone.
using EngineChoices = std::map<std::string, EngineChoice>;
[[nodiscard]] Result<EngineChoices> choose_engines(const RigConfig& rig, Simulation& simulation);

/// Of `rigor sense`, which needs no lock: `renderer` (may be empty) goes before the rig's. Empty: by its
/// keys.
[[nodiscard]] Result<std::optional<EngineChoice>> sense_choice(const RigConfig& rig,
                                                               const ChannelEntry& entry,
                                                               Simulation& simulation,
                                                               const std::string& engine);

}  // namespace rigor

// What a run tells of itself in more than one place: in its result (run_result.h), to whoever looks on
// (live/status.h), over its control socket (fault_control.h).
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "rt-core/port.h"

namespace rigor {

class FaultySource;
class Sink;
struct RigConfig;

[[nodiscard]] const char* name_of(PortStatus status) noexcept;
/// "rig", "file", "clock", "seed", and "version" of the program.
[[nodiscard]] nlohmann::json identity_json(const RigConfig& rig);
/// "accepted", "applied", "late", "failed", "dropped", "made_safe".
[[nodiscard]] nlohmann::json commands_json(const Sink& sink);
/// Where the samples of a source with faults went: "taken", and what the others sum up to it.
[[nodiscard]] nlohmann::json faulty_json(const FaultySource& source);

}  // namespace rigor

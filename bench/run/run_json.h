// What a run tells of itself in more than one place: in its report (result/report_json.h), to whoever looks
// on (live/status.h), over its control socket (fault_control.h).
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "bench/run/report_parts.h"
#include "rt-core/port.h"

namespace rigor {

class FaultySource;
class Sink;
struct RigConfig;
struct RunSink;

[[nodiscard]] const char* name_of(PortStatus status) noexcept;
/// "rig", "file", "clock", "seed", and "version" of the program.
[[nodiscard]] nlohmann::json identity_json(const RunIdentity& run);

/// As far as the rig says.
[[nodiscard]] RunIdentity identity_of(const RigConfig& rig);
// Taken from what runs; any thread.
[[nodiscard]] FaultyReport faulty_report(const FaultySource& source, const std::string& name);
[[nodiscard]] SinkReport sink_report(const RunSink& sink);

/// "accepted", "applied", "late", "failed", "dropped", "made_safe".
[[nodiscard]] nlohmann::json commands_json(const SinkSnapshot& counters);
/// "taken", and what the others sum up to it.
[[nodiscard]] nlohmann::json faulty_json(const FaultyReport& source);

}  // namespace rigor

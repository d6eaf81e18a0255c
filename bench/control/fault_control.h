// What can be asked of a running bench: its channels, faults, the sides of its pairs. Serves the control
// socket (control_socket.h).
//
//   {"command": "run"}                                                       rig, clock, seed, process id
//   {"command": "channels"}                                                  channels, sinks, what faults
//   they can have
//   {"command": "fault", "channel": C, "fault": {"kind": K, …, "for_s": S}}  from the next cycle on; its
//   index
//   {"command": "clear", "channel": C}                                       its live faults end; all without
//   C
//   {"command": "faults"}                                                    every fault, and what it did so
//   far
//   {"command": "switch", "channel": C, "active": "real" | "simulated"}     the side of a pair
#pragma once

#include "bench/control/control_socket.h"
#include "bench/run/bench_run.h"
#include "bench/run/report_parts.h"
#include "sensor-hal/channel/fault_bench.h"

namespace rigor {

/// `parts` outlive the commands; they are asked only while the run goes on.
void add_run_commands(ControlCommands& commands, RunParts& parts);

/// Faults of a channel or sink and what they did. `t0`: of the run; with it, the stretches of time in which
/// each was on (after the loop has ended).
[[nodiscard]] ChannelFaultReport fault_report(const FaultBench::Entry& entry, const BenchTime* t0);
/// As `--json` and the report have them.
[[nodiscard]] nlohmann::json faults_json(const ChannelFaultReport& faults);

/// Takes the live faults of a recording into a run that has not been armed: each comes and goes at the same
/// instants after the start, with the index that it had. Setup context. not_found, protocol; bad_input: among
/// others a recording of another rig, with channels or sinks that this one does not have, and one without
/// faults.
[[nodiscard]] Status schedule_recorded_faults(const std::filesystem::path& recording, const RigConfig& rig,
                                              FaultBench& faults);

}  // namespace rigor

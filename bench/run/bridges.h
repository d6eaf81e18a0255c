// The bridges of a run, `bridges: { ros2: { … } }`: each has a recorder of its own, whose messages leave for
// other programs, and gives the loop the commands that come in.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bench/run/bench_run.h"
#include "bench/run/report_parts.h"
#include "rt-core/epoch.h"
#include "sensor-hal/channel/bridge.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {

struct RunBridge {
  std::string name;
  ConfigNode node;
  std::unique_ptr<Bridge> bridge;
  std::unique_ptr<Recorder> recorder;  ///< from open_bridges to close_bridges
};

/// Makes and configures the rig's bridges. Assembly, after channels and sinks. bad_input with its place; may
/// throw ConfigError.
[[nodiscard]] Status add_bridges(RunParts& parts, const Registry& registry);
/// Joins their networks, and makes their topics known. Setup context, after the channels are armed.
[[nodiscard]] Status open_bridges(RunParts& parts, const EpochPair& epoch);
/// Returns when the peers are there that the bridges wait for. Setup context.
[[nodiscard]] Status wait_for_peers(RunParts& parts, StopToken stop);
/// From now on pairs tell the bridges, too; who observed channel i before is `first[i]`, which may be null.
/// The observers live as long as what is returned. Setup context.
[[nodiscard]] std::vector<std::unique_ptr<PairObserver>> observe_for_bridges(
    RunParts& parts, const std::vector<PairObserver*>& first);
/// Sends the rest and leaves the networks. Setup context, after the loop has ended; again: nothing.
void close_bridges(RunParts& parts, std::vector<Error>& errors);
/// Any thread but the loop's, from open_bridges on.
[[nodiscard]] std::vector<RunBridgeReport> bridge_reports(const RunParts& parts);

}  // namespace rigor

// The sides of pairs as parameters of the protocol (`/left/active`), so that Foxglove's own panel switches
// them.
#pragma once

#include "bench/live/hub.h"
#include "bench/run/bench_run.h"

namespace rigor::live {

/// `parts` outlive the hub's last client.
void serve_parameters(Hub& hub, RunParts& parts);

}  // namespace rigor::live

// `--live` of a command: the port, before anything else is touched.
#pragma once

#include <memory>

#include "bench/live/server.h"
#include "cli/commands.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// Null where it is not asked for. Says on stderr where the page is. bad_input. Its threads stay off the CPU
/// of the rig's loop. Setup context.
[[nodiscard]] Result<std::unique_ptr<live::Server>> open_live(const LiveOptions& options,
                                                              const RigConfig& rig);

}  // namespace rigor

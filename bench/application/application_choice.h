// Which application a rig names: one of the registry, a shared object, or a program of its own.
#pragma once

#include <memory>

#include "sensor-hal/channel/registry.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// Null where the rig has none. `rig` outlives it. Before channels are armed (process_application.h).
/// bad_input with the names that there are. Setup context.
[[nodiscard]] Result<std::unique_ptr<Application>> make_application(const RigConfig& rig,
                                                                    const Registry& registry);

}  // namespace rigor

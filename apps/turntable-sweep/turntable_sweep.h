// The demo's application: swings a turntable to and fro and watches what the cameras make of it.
#pragma once

#include <memory>

#include "sensor-hal/channel/application.h"

namespace rigor {
/// Keys: table (sink), amplitude_deg, period_s, rate_hz of commands. The command is a target rate in degrees
/// per second.
[[nodiscard]] std::unique_ptr<Application> make_turntable_sweep();
}  // namespace rigor

// Signals of DBC files, for faults of raw CAN channels: `{ kind: bias, dbc: table.dbc, value: position, … }`.
#pragma once

#include "sensor-hal/channel/fault_spec.h"

namespace rigor {

/// The signal that a fault names: `SIGNAL` where only one message has it, or `MESSAGE.SIGNAL`. What a fault
/// makes of its value is clipped to the range that the file states. Throws ConfigError. Setup context.
[[nodiscard]] std::shared_ptr<const FrameSignal> find_dbc_signal(const ConfigNode& fault,
                                                                 const std::string& name);

}  // namespace rigor

// Simulated registers: numbers by the laws of `signals` (bench/sensing/device_signals.h), at each capture's
// instant.
//
//   speed:
//     kind: registers
//     backend: simulated
//     signals:
//       rate:    { joint: turntable, quantity: rate, unit: deg }
//       voltage: { constant: 24, unit: V }
#pragma once

#include <memory>

#include "bench/sensing/device_signals.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

/// Throws ConfigError: no signals, too many of them, or one that is commanded.
[[nodiscard]] std::shared_ptr<SampleProvider> make_signal_values(const ConfigNode& params,
                                                                 const JointFinder& joint);

}  // namespace rigor

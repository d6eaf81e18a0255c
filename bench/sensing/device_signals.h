// What a node on a bus tells and can be told: the `signals` of an emulator in a rig.
//
//   emulators:
//     node:
//       backend: can
//       model: turntable                 # position, rate, angle, status, fault; enable, mode,
//       target_position, target_rate signals:
//         voltage: { constant: 24 }
//         load:    { sine: { amplitude: 2, period_s: 5, offset: 10, phase_deg: 90 } }
//         tilt:    { joint: turntable, quantity: position, unit: deg }        # position or rate; deg or rad
//         speed:   { recording: drive.mcap, channel: wheel, value: rate, repeat: true }
//         limit:   { commanded: 5 }      # what it was told last, 5 at first
//
// A recording's values hold until the next one; its first sample falls on the device's first reading. NaN
// before that, and after its end where it does not repeat. Setup context, but for the model's read and write.
#pragma once

#include <functional>
#include <memory>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Where a joint of the world is found; throws ConfigError at `key` of the node for unknown ones.
using JointFinder = std::function<std::size_t(const ConfigNode& n, std::string_view key)>;

/// The signals of `base` (may be null), and those of the map `signals` of `params` behind them. Null when
/// there are none. Throws ConfigError.
[[nodiscard]] std::shared_ptr<SignalModel> read_device_signals(const ConfigNode& params,
                                                               std::shared_ptr<SignalModel> base,
                                                               std::shared_ptr<const MotionSource> motion,
                                                               const JointFinder& joint);

}  // namespace rigor

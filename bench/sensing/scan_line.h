// The rays of a channel's 2D scanner, as the rig tells them.
#pragma once

#include <optional>

#include "rt-core/result.h"
#include "sensor-hal/record/laser_scan.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// Of the channel itself or of the real side of a pair, and of the simulated side.
struct ScanLines {
  std::optional<record::ScanLine> own, simulated;
};

/// From the channel's `laser_scan`, or else from the sensor model (`sensor`) of what measures: of the
/// channel, of its simulated side, of the emulator that stands for its device, narrowed by the channel's
/// `start_deg`, `stop_deg` and `cluster`. Empty where the model is no turning scanner of one beam in its xy
/// plane, and where nothing tells the rays. bad_input: `laser_scan` with place. Setup context; reads files.
[[nodiscard]] Result<ScanLines> scan_lines(const RigConfig& rig, const ChannelEntry& entry);

}  // namespace rigor

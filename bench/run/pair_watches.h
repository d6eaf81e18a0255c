// Which watch looks at a pair of a rig: what its windows tell follows from the kind of channel and from the
// sensor model of the simulated side (docs/pair-watch.md).
#pragma once

#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/pair_watch/pair_watch.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// `entry.watch` is there, from the rig or not; both sides are configured. Setup; reads the sensor model.
/// bad_input at the place in the rig: a kind that cannot be watched, too many numbers, or others than the
/// simulated side's.
[[nodiscard]] Result<pair_watch::PairWatch> make_pair_watch(const ChannelEntry& entry,
                                                            const ChannelDescription& real,
                                                            const ChannelDescription& simulated);

}  // namespace rigor

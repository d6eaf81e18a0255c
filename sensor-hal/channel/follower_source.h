// A source that measures when it is asked to: the simulated side of a pair, which measures at the instants of
// the real one.
#pragma once

#include "sensor-hal/channel/channel.h"

namespace rigor {

class FollowerSource : public Source {
 public:
  /// Loop thread, running: measure at `t_capture`; the sample gets `index` as its sequence. Both only grow.
  /// Wait-free. False: skipped and counted (no slot, or the worker is behind).
  virtual bool request_at(std::uint64_t index, BenchTime t_capture) noexcept = 0;
};

}  // namespace rigor

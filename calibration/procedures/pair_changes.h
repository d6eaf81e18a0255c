// Whether the device of a recorded pair changed while it was recorded: a model fitted across a change is that
// of neither device.
#pragma once

#include <optional>
#include <string>

#include "calibration/pair/pair_model.h"
#include "calibration/procedures/pair_input.h"
#include "rt-core/stop.h"

namespace rigor {

struct RecordedChange {
  double at_s = 0;      ///< begin of the first window that has the change, since the run's t0
  double window_s = 0;  ///< how well that is known
  std::string parameter, unit;
  double change = 0, sigma = 0;
  /// "range bias has changed by +0.0201 ± 0.0004 m at 5.4 s"
  [[nodiscard]] std::string text() const;
};
struct ChangeSearch {
  std::optional<RecordedChange> change;
  bool enough = false;  ///< there were pairs enough to look for one
};

/// Looks with the pair watch (docs/pair-watch.md), forwards and backwards, so that a change early in the
/// recording is found too. False alarms: in one of a hundred recordings. Errors: of reading.
[[nodiscard]] Result<ChangeSearch> find_change(const RecordedPair& pair,
                                               const calibration::ForEachPair& pairs, const StopToken& stop);

}  // namespace rigor

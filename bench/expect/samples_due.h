// How many samples of a channel were due by an instant of a run.
#pragma once

#include <cstdint>
#include <optional>

#include "rt-core/period.h"

namespace rigor {

/// Samples whose release lies in the first `elapsed` of a run; none where period is 0.
[[nodiscard]] inline std::optional<std::uint64_t> samples_due(Duration elapsed, const Period& period,
                                                              Duration latency) {
  if (period.ns() <= 0) return std::nullopt;
  if (elapsed < latency) return 0;
  return static_cast<std::uint64_t>((elapsed - latency) / period) + 1;
}

/// The first and the last sample of a device that runs freely may fall to either side of the run's ends, and
/// its clock is not the bench's: so many less than due are no loss where the sequence has no gap.
[[nodiscard]] inline std::uint64_t samples_at_edges(std::uint64_t due) {
  const auto share = static_cast<std::uint64_t>(0.01 * static_cast<double>(due));
  return share > 2 ? share : 2;
}

}  // namespace rigor

// How the loop of a run went, and what it kept of each channel.
#pragma once

#include <string>

#include "rt-core/executive.h"
#include "rt-core/port.h"

namespace rigor {

/// A hole in a channel's sequence, as the loop saw it.
struct Gap {
  BenchTime t;
  std::uint64_t after_sequence = 0, missing = 0;
};

/// A stretch of cycles in which a port had one status, until the next one begins.
struct StatusSpan {
  BenchTime t;
  PortStatus status = PortStatus::never;
};

/// The difference real − simulated of a pair at one instant, in the unit of the pair.
struct DifferenceAt {
  double t_s = 0;  ///< since the start of the run
  double bias = 0, sigma = 0;
};

struct RunOutcome {
  RunSummary loop;
  std::string input_sha256;  ///< of all that the application saw; empty: not wanted, or entries were dropped
  bool digest_wanted = false;  ///< it was to be computed
  BenchTime t0;
  double wall_s = 0, cpu_s = 0;  ///< from the first cycle to the last; of all threads of this process
};

}  // namespace rigor

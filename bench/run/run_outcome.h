// How the loop of a run went.
#pragma once

#include <string>

#include "rt-core/executive.h"

namespace rigor {

struct RunOutcome {
  RunSummary loop;
  std::string seen_sha256;  ///< of all that the application saw; empty: not wanted, or entries were dropped
  bool digest_wanted = false;  ///< it was to be computed
  BenchTime t0;
  double wall_s = 0, cpu_s = 0;  ///< from the first cycle to the last; of all threads of this process
};

}  // namespace rigor

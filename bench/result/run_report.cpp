#include "bench/result/run_report.h"

#include <algorithm>

namespace rigor {

double RunReport::duration_s() const {
  return outcome.loop.period.seconds() *
         static_cast<double>(outcome.loop.cycles_run + outcome.loop.cycles_skipped);
}

bool RunReport::ended_well() const {
  switch (outcome.loop.reason) {
    case StopReason::overrun:
    case StopReason::failed:
    case StopReason::recording:
    case StopReason::application:
      return false;
    default:
      return true;
  }
}

bool RunReport::passed() const {
  return ended_well() && errors.empty() && replay_difference.empty() && failed_on.empty() &&
         facts.emulators.empty() && std::ranges::none_of(expected, &Expected::fails);
}

}  // namespace rigor

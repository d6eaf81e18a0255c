#include "calibration/latency/trigger_match.h"

#include <algorithm>
#include <limits>

namespace rigor::calibration {

TriggerMatch match_triggers(std::span<const std::int64_t> triggers_ns,
                            std::span<const std::int64_t> arrivals_ns) {
  TriggerMatch match;
  if (triggers_ns.empty()) return match;
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  for (std::size_t i = 1; i < triggers_ns.size(); ++i)
    least = std::min(least, triggers_ns[i] - triggers_ns[i - 1]);
  match.minimum_interval_ns = triggers_ns.size() > 1 ? least : 0;

  std::size_t sample = static_cast<std::size_t>(
      std::lower_bound(arrivals_ns.begin(), arrivals_ns.end(), triggers_ns.front()) - arrivals_ns.begin());
  for (std::size_t trigger = 0; trigger < triggers_ns.size(); ++trigger) {
    const bool last = trigger + 1 == triggers_ns.size();
    const auto before_next = [&] {
      return sample < arrivals_ns.size() && (last || arrivals_ns[sample] < triggers_ns[trigger + 1]);
    };
    if (before_next()) {
      match.pairs.push_back({trigger, sample++});
    } else if (!last) {
      ++match.without_sample;
    }
    for (; before_next(); ++sample) ++match.without_trigger;
  }
  return match;
}

}  // namespace rigor::calibration

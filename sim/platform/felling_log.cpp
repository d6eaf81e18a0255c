#include "sim/platform/felling_log.h"

#include <algorithm>
#include <cmath>

namespace rigor {

bool FellingLog::cut(const Saw& saw, double yaw_rad, BenchTime t) noexcept {
  const auto cut_before = fellings();
  const Stem* best = nullptr;
  double minimum_m = saw.reach_m;
  for (const Stem& s : stems_) {
    const double away_m = std::hypot(s.x_m - saw.x_m, s.y_m - saw.y_m);
    if (!(away_m < minimum_m) || s.z_m < saw.lowest_foot_m || s.z_m > saw.highest_foot_m) continue;
    if (std::any_of(cut_before.begin(), cut_before.end(), [&](const Felling& f) { return f.node == s.node; }))
      continue;
    best = &s;
    minimum_m = away_m;
  }
  if (!best) return false;
  fellings_[cut_before.size()] = {t, best->node, yaw_rad};
  count_.store(cut_before.size() + 1, std::memory_order_release);
  return true;
}

}  // namespace rigor

#include "bench/live/pairs.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_source.h"

namespace rigor::live {
namespace {

using nlohmann::json;

json known(double v) { return std::isfinite(v) ? json(v) : json(); }

/// The highest sum of the watch as a share of its threshold; null where nothing is watched.
json level_of(const PairMonitor* monitor) {
  if (!monitor) return {};
  const auto baseline = monitor->baseline();
  const PairMonitor::Status s = monitor->status();
  double highest = -1;
  for (std::size_t i = 0; i < baseline.size(); ++i)
    if (baseline[i].watched) highest = std::max(highest, std::abs(static_cast<double>(s.watch.level[i])));
  return highest < 0 ? json() : known(highest);
}

}  // namespace

LivePairs::LivePairs(const RunParts& parts) {
  for (const auto& c : parts.channels)
    if (c->pair) pairs_.push_back({c.get(), 0});
}

std::optional<json> LivePairs::changed(const LiveTap& tap) {
  json list = json::array();
  for (Pair& p : pairs_) {
    const PairSnapshot s = p.channel->pair->statistics();
    if (s.compared == p.compared) continue;
    p.compared = s.compared;
    if (s.compared == 0) continue;
    list.push_back({{"channel", p.channel->entry->name},
                    {"bias", known(s.last.bias)},
                    {"sigma", known(s.last.sigma)},
                    {"level", level_of(p.channel->pair->monitor())}});
  }
  if (list.empty()) return std::nullopt;
  return json{{"t_s", (tap.now() - tap.t0()).seconds()}, {"pairs", std::move(list)}};
}

}  // namespace rigor::live

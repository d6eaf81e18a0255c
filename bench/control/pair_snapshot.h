// The pairs of a run as JSON: differences, who is handed on, and what the watch says (docs/pair-watch.md).
//
// `bias` and `sigma` are null where nothing was compared.
//
//   {"active": "real", "count": 79, "bias": 0.02, "sigma": 2.1, "unit": "DN", …,
//    "watch": {"state": "alarm", "text": "focal length has changed by +0.01004 ± 0.0003, since 2500 s; …",
//              "learned": 200, "baseline_windows": 200, "windows": 251, "alarms": 1,
//              "alarm": {"parameter": "focal length", "change": 0.01004, "sigma": 0.0003, "since_s": 2500,
//              …}, "parameters": [{"name": "gain", "unit": "1", "value": …, "sigma": …, "level": 0.1,
//                              "highest": 0.3, "mean": …, "threshold": …}, …]}}
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/control/control_socket.h"
#include "bench/run/bench_run.h"
#include "bench/run/report_parts.h"
#include "sensor-hal/channel/pair_monitor.h"

namespace rigor {

/// Of every pair of the run, by the channel's name. Any thread but the loop's, from arm on. Differences and
/// sides as the loop sees them now.
[[nodiscard]] nlohmann::json pair_snapshot(const RunParts& parts);

/// learning, watching or alarm.
[[nodiscard]] const char* name_of(pair_watch::WatchState state) noexcept;

/// The watch of a pair.
struct PairWatchReport {
  PairMonitor::Status status;
  std::vector<pair_watch::Parameter> parameters;
  std::vector<pair_watch::ParameterState> baseline;  ///< in the order of `parameters`
  std::optional<std::vector<PairWindow>> windows;    ///< for plots, where they were wanted
};
/// Of one pair. Any thread but the loop's; `with_windows`: with the windows of its watch so far (at most
/// PairMonitor::kKept). Without the series of differences.
[[nodiscard]] PairReport pair_report(const RunChannel& channel, bool with_windows);
[[nodiscard]] nlohmann::json pair_json(const PairReport& pair);

/// Of such JSON: "79 compared, bias 0.020, sigma 2.100 DN", or that nothing was compared and why.
[[nodiscard]] std::string pair_line(const nlohmann::json& pair);

/// The command `pair`: {"command": "pair"} gives pair_snapshot; with "channel" that one with its series, and
/// with "do": "acknowledge" or "learn_again" that is done before.
void add_pair_command(ControlCommands& commands, RunParts& parts);

}  // namespace rigor

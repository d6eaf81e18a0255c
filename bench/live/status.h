// How a run goes, as the JSON of /rigor/live (docs/live.md).
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "bench/control/control_socket.h"
#include "bench/live/hub.h"
#include "bench/result/run_facts.h"
#include "bench/run/bench_run.h"
#include "bench/run/tap.h"
#include "rt-core/epoch.h"

namespace rigor::live {

/// Setup context constructs, the server's thread calls.
class LiveStatus {
 public:
  /// All outlive it. Descriptions of channels are copied: they may change when a rig is armed again.
  LiveStatus(const RunParts& parts, const LoopCounters& counters, ControlCommands& commands,
             const LiveTap& tap, const EpochPair& epoch, bool replay);
  [[nodiscard]] nlohmann::json operator()(const HubCounters& server);
  /// JSON schema of the message.
  [[nodiscard]] static std::string schema();

 private:
  struct Rate {
    std::uint64_t fresh = 0;
    std::int64_t t_ns = 0;
    double hz = 0;
    bool known = false;
  };
  [[nodiscard]] nlohmann::json channel(std::size_t i, const ChannelFacts& facts);
  [[nodiscard]] RunFacts facts() const;
  [[nodiscard]] nlohmann::json faults();
  [[nodiscard]] std::vector<Expected> expected(const RunFacts& facts);

  const RunParts& parts_;
  const LoopCounters& counters_;
  ControlCommands& commands_;
  const LiveTap& tap_;
  EpochPair epoch_;
  bool replay_;
  std::vector<ChannelDescription> descriptions_;
  std::vector<Rate> rates_;
  unsigned published_ = 0;  ///< times
};

}  // namespace rigor::live

// What is plotted of the pairs of a run, as the JSON of /rigor/pairs (docs/live.md).
#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <vector>

#include "bench/run/bench_run.h"
#include "bench/run/tap.h"

namespace rigor::live {

/// Setup context constructs, the server's thread calls.
class LivePairs {
 public:
  explicit LivePairs(const RunParts& parts);
  [[nodiscard]] bool none() const { return pairs_.empty(); }
  /// Of the pairs that compared something since the last call; empty: none did.
  [[nodiscard]] std::optional<nlohmann::json> changed(const LiveTap& tap);

 private:
  struct Pair {
    const RunChannel* channel = nullptr;
    std::uint64_t compared = 0;
  };
  std::vector<Pair> pairs_;
};

}  // namespace rigor::live

// What a run's verdict rests on, read from the run: after its end, and while it goes on.
#pragma once

#include <optional>
#include <vector>

#include "bench/result/verdict.h"
#include "bench/run/bench_run.h"

namespace rigor {

/// What the loop counted of a channel. While it goes on, somebody else has to publish that (live/tap.h).
struct ChannelCounts {
  std::uint64_t delivered = 0, late = 0, lost = 0, disconnected_cycles = 0;
  bool lost_now = false;
  std::optional<BenchTime> t_last;  ///< capture of the last visible sample
  Duration arrival;                 ///< 99th percentile; 0: not known
};
struct LoopCounts {
  BenchTime t0, now;  ///< `now`: of the newest cycle
  std::uint64_t cycles = 0, skipped = 0, misses = 0;
};

/// Counts of a channel whose loop has ended.
[[nodiscard]] ChannelCounts counts_of(const RunChannel& channel);
/// `counts`: in the order of the channels. Setup thread after the run; while it goes on any thread but the
/// loop's.
[[nodiscard]] RunFacts run_facts(const RunParts& parts, const LoopCounts& loop,
                                 const std::vector<ChannelCounts>& counts);

/// Of these what expectations are judged by; the loop's own is not among it.
[[nodiscard]] RunEnd run_end(const RunFacts& facts);

}  // namespace rigor

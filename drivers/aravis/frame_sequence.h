// From a camera's block ids to the channel's own count of captures, which grows for as long as the channel
// lives.
//
// Block ids have 16 bits and go 65535 → 1 (0 is no id), or 64 bits on newer cameras; they begin anew with
// each acquisition. Between two frames of one acquisition the id says how many were lost. Where the ids begin
// anew, after a reconnection, the time that went by says it.
//
//   65534, 65535, 2 | reconnected, 1.2 s later at 25 Hz: 1, 2
//   sequence   n, n+1, n+3 (one lost)                 n+33 (29 lost), n+34
#pragma once

#include <cstdint>

#include "rt-core/time.h"

namespace rigor {

/// One thread; no allocation.
class FrameSequence {
 public:
  struct Step {
    std::uint64_t sequence = 0;
    std::uint32_t lost_before = 0;  ///< captures between this one and the last that step() was told of
    bool from_time = false;         ///< the gap was told from the time, not from the ids
  };
  /// `period` 0: aperiodic; a gap that only the time could tell is then taken for none.
  explicit FrameSequence(Duration period = {}) : period_(period) {}

  /// The next frame, with its id and its capture instant (an estimate will do).
  [[nodiscard]] Step step(std::uint64_t block_id, BenchTime t_capture) noexcept;
  /// Captures from the last frame to one with this id; 0 where the ids cannot tell.
  [[nodiscard]] std::uint64_t gap(std::uint64_t block_id) const noexcept;
  /// The camera begins to count anew: the next gap is told from the time.
  void restart() noexcept { ids_hold_ = false; }

  [[nodiscard]] bool started() const noexcept { return started_; }
  [[nodiscard]] BenchTime last_capture() const noexcept { return t_last_; }

 private:
  Duration period_;
  bool started_ = false, ids_hold_ = false;
  std::uint64_t last_id_ = 0, sequence_ = 0;
  BenchTime t_last_;
};

}  // namespace rigor

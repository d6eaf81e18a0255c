// The stamp that every sample carries: when it was measured, when the loop may see it, when it came.
#pragma once

#include <cstdint>

#include "rt-core/time.h"

namespace rigor {

/// What is known to be wrong with a sample; 0 is a good one. Bits, so that several can hold at once.
enum Validity : std::uint32_t {
  kValid = 0,
  kIncomplete = 1u << 0,   ///< parts of the data never came; what is missing is zero
  kSaturated = 1u << 1,    ///< the device says that it clipped
  kClockUnsure = 1u << 2,  ///< the device clock was not mapped yet: t_capture is the arrival less the latency
  kCorrupt = 1u << 3,      ///< a checksum or a plausibility check failed
  kSubstituted = 1u << 4,  ///< made by a fault or a fallback, not by the channel's own source
};

/// Times of one sample on the bench clock. `t_release = t_capture + latency` is the logical instant at which
/// it becomes visible to the loop, however early it was there (logical execution time).
struct Stamp {
  std::uint64_t sequence = 0;  ///< capture index of the channel: a gap is a loss
  BenchTime
      t_capture;  ///< instant of the measurement; for images the middle of the exposure of the centre row
  BenchTime t_release{};            ///< first instant at which the loop may see it
  BenchTime t_arrival{};            ///< when it really was there; equals t_release in virtual time
  Duration sigma_capture{};         ///< standard uncertainty of t_capture
  std::uint32_t lost_before = 0;    ///< samples known to be lost since the one before
  std::uint32_t validity = kValid;  ///< bits of Validity

  friend bool operator==(const Stamp&, const Stamp&) noexcept = default;
};

}  // namespace rigor

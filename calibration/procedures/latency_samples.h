// A channel's latencies from recorded stamps: which samples count, from which instant, and why some channels
// cannot be measured so.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "calibration/latency/latency_fit.h"
#include "calibration/procedures/recorded_stamps.h"

namespace rigor {

/// What one channel's samples say, over all recordings.
struct LatencySamples {
  std::vector<calibration::LatencyPart> parts;     ///< a recording each
  std::vector<std::int64_t> sigma_ns, present_ns;  ///< of the samples that count; latency_ms of the rig
  std::vector<std::int64_t> after_trigger_ns;      ///< capture as stamped less that by the trigger
  std::size_t late = 0;    ///< of the samples that count: arrived after the release they had
  std::size_t unsure = 0;  ///< of a device clock that was not known; with a trigger they count
  std::size_t substituted = 0, near_end = 0;  ///< that do not count
  std::size_t negative = 0,
              at_release = 0;  ///< of those that count: arrive before their capture; exactly at it
  std::size_t untriggered = 0, without_sample = 0;
  std::int64_t minimum_interval_ns = 0;  ///< between two triggers
  std::uint64_t faults = 0;
  double span_s = 0;  ///< of the captures, all recordings together
  bool simulated = false;

  [[nodiscard]] std::size_t count() const;
};

/// Instants of a trigger on the bench clock: of a channel each of its samples, of SINK:VALUE each time that
/// the value leaves 0. bad_input: no such channel or sink; its own clock is not known.
[[nodiscard]] Result<std::vector<std::int64_t>> trigger_instants(const StampedRecording& recording,
                                                                 const std::string& name,
                                                                 const StopToken& stop);

/// Adds a recording's samples, by their stamps.
void add_stamped(const RecordedStamps& channel, const std::string& recording, LatencySamples& to);
/// Adds a recording's samples, by the triggers that caused them.
void add_triggered(const RecordedStamps& channel, const std::string& recording,
                   const std::vector<std::int64_t>& triggers_ns, std::int64_t to_capture_ns,
                   LatencySamples& to);

/// Why nothing can be told of this channel's latency; empty: it can.
[[nodiscard]] std::string why_unknown(const LatencySamples& samples, const std::string& channel,
                                      const std::string& recording, const std::string& trigger);

}  // namespace rigor

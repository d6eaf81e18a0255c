// What happened in a recorded run, from `/rigor/events`: faults, alarms of watched pairs, sinks that were
// made safe.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "sensor-hal/channel/fault_spec.h"

namespace rigor {

struct RecordedRun;

/// A fault began or ended.
struct RecordedFault {
  BenchTime t;
  std::string of;  ///< the channel or sink; of a pair's side `left.real`
  std::uint32_t index = 0;
  FaultKind kind{};
  bool live = false;  ///< injected while the run went on
  bool begins = false;
  std::string yaml;  ///< "{kind: drop, probability: 0.2}"
};
struct RecordedAlarm {
  BenchTime t;
  std::string pair;
};
/// A sink's thread wrote its safe values, for nobody commanded it.
struct RecordedMadeSafe {
  BenchTime t;
  std::size_t sink = 0;  ///< its place in the rig
};
/// Each in the order of the recording.
struct RecordedEvents {
  std::vector<RecordedFault> faults;
  std::vector<RecordedAlarm> alarms;
  std::vector<RecordedMadeSafe> made_safe;
};

/// Setup context. protocol: among others an event that this version does not understand.
[[nodiscard]] Result<RecordedEvents> read_recorded_events(const std::filesystem::path& file,
                                                          const RecordedRun& run);

}  // namespace rigor

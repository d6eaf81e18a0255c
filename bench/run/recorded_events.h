// What happened in a recorded run: faults, from `/rigor/faults`; alarms of watched pairs and sinks that were
// made safe, from `/rigor/events`.
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
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
  std::string json;  ///< with all its keys; fault_node() reads it
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
  /// Its faults are told as text alone, as earlier versions did: `faults` is empty.
  bool faults_as_text = false;
};

/// A fault that was injected while the run went on, from its begin to its end.
struct RecordedLiveFault {
  std::string of;  ///< as RecordedFault::of
  std::uint32_t index = 0;
  std::string json;                                                           ///< as RecordedFault::json
  Duration from, until = Duration(std::numeric_limits<std::int64_t>::max());  ///< after the start of the run
};

/// Setup context. protocol: a message that cannot be read, and a fault that this version does not know.
[[nodiscard]] Result<RecordedEvents> read_recorded_events(const std::filesystem::path& file,
                                                          const RecordedRun& run);
/// Ordered by channel or sink and index. Setup context. bad_input: they are told as text alone, and a fault
/// that ends without having begun, whose begin the recording lost.
[[nodiscard]] Result<std::vector<RecordedLiveFault>> recorded_live_faults(const std::filesystem::path& file,
                                                                          const RecordedRun& run,
                                                                          const RecordedEvents& events);
/// For whoever needs the faults. bad_input: they are told as text alone.
[[nodiscard]] Status faults_are_known(const std::filesystem::path& file, const RecordedEvents& events);

}  // namespace rigor

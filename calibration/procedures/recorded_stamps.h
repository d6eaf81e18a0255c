// The stamps of a recording's samples, without the samples: what `rigor calibrate latency` reads.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor {

/// Of one sample, on the bench clock; what a Stamp has of it.
struct RecordedStamp {
  std::int64_t capture_ns, arrival_ns, release_ns, sigma_ns;
  std::uint32_t validity;
};

struct RecordedStamps {
  std::string channel;                ///< `left`; of a pair `left/real`, `left/simulated`
  std::vector<RecordedStamp> stamps;  ///< by capture
  bool simulated = false;             ///< measured by a simulator, as the rig in the recording says
  std::uint64_t faults = 0;           ///< that began on the channel during the recording
  /// Of the rig: `left`, whose keys hold for both sides of a pair.
  [[nodiscard]] std::string rig_channel() const { return channel.substr(0, channel.find('/')); }
};

struct StampedRecording {
  std::filesystem::path file;
  std::string rig_file;  ///< empty: the recording does not say
  std::vector<RecordedStamps> channels;
  std::map<std::string, std::vector<std::string>> sinks;  ///< with the names of their values
  std::vector<std::string> warnings;                      ///< of a recording that is damaged or cut short
  [[nodiscard]] const RecordedStamps* find(const std::string& channel) const;
  [[nodiscard]] std::vector<std::string> names() const;
};

/// One thread; allocates 40 bytes a sample. bad_input: not a recording whose samples have stamps; a run in
/// virtual time, whose arrivals are the releases. A read that is stopped gives what it has.
[[nodiscard]] Result<StampedRecording> read_stamps(const std::filesystem::path& file, const StopToken& stop);

/// Values that a run gave to one of a sink's registers or signals.
struct RecordedCommand {
  std::int64_t issue_ns, effect_ns;  ///< given by the loop; handed to the device. Bench clock
  double value;
};
/// In the order of their effects. bad_input: no such sink or no such value (those that there are are listed),
/// no command.
[[nodiscard]] Result<std::vector<RecordedCommand>> read_commands(const std::filesystem::path& file,
                                                                 const std::string& sink,
                                                                 const std::string& value,
                                                                 const StopToken& stop);

}  // namespace rigor

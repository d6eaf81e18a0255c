// What a recording of a Livox Mid-360 holds, for `rigor inspect F.pcap`.
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "drivers/livox/point_stream.h"
#include "rt-core/result.h"

namespace rigor::livox {

/// Whether a recording has packets of this device among its first.
[[nodiscard]] bool is_livox_recording(const std::filesystem::path& file);

struct PcapReport {
  std::string file;
  std::uint64_t captured = 0;  ///< frames of the network
  std::uint64_t point_packets = 0, imu_packets = 0, other_datagrams = 0;
  std::uint64_t commands = 0, answers = 0, pushes = 0;
  std::uint64_t malformed = 0;                                  ///< from or to one of its ports and no packet
  std::map<std::string, std::uint64_t> faults;                  ///< of those, by what is wrong
  std::map<std::string, std::uint64_t> sources;                 ///< packets of points by "address:port"
  std::map<std::string, std::uint64_t> data_types, time_types;  ///< packets of points
  double duration_s = 0;  ///< by the recording's stamps, first to last packet of points
  double packets_per_s = 0, points_per_s = 0, imu_packets_per_s = 0;

  PointStream::Counters stream;
  std::uint64_t first_timestamp_ns = 0, last_timestamp_ns = 0;
  std::array<std::uint64_t, kLines> returns_per_line{};
  std::uint64_t without_return = 0, low_confidence = 0;  ///< points
  double minimum_range_m = 0, maximum_range_m = 0;
  std::optional<Error> ended_by;  ///< the recording is not whole
};

/// not_found, bad_input: no recording. A recording that breaks off is reported as far as it goes.
[[nodiscard]] Result<PcapReport> inspect_pcap(const std::filesystem::path& file);

}  // namespace rigor::livox

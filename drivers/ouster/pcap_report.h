// What a recording of an Ouster holds, for `rigor inspect F.pcap --metadata F.json`.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "drivers/ouster/frame_stream.h"

namespace rigor::ouster {

struct PcapReport {
  std::string file;
  Metadata metadata;
  std::uint64_t captured = 0, fragments = 0;  ///< frames of the network; those of them that were fragments
  std::uint64_t datagrams_given_up = 0;       ///< that lack a fragment
  std::uint64_t lidar_packets = 0, imu_packets = 0, other_datagrams = 0;
  std::uint64_t malformed = 0;                   ///< on the lidar's or the IMU's port and no packet
  std::map<std::string, std::uint64_t> faults;   ///< of those, by what is wrong
  std::map<std::string, std::uint64_t> sources;  ///< lidar packets by "address:port"
  double duration_s = 0;                         ///< by the recording's stamps, first to last lidar packet

  FrameStream::Counters frames;         ///< of the sensor
  std::uint64_t frames_incomplete = 0;  ///< of those that were handed on
  double frame_rate_hz = 0, packets_per_s = 0, imu_packets_per_s = 0;
  std::uint64_t first_timestamp_ns = 0, last_timestamp_ns = 0;  ///< the sensor's own time, of columns
  std::uint64_t columns_not_good = 0;                           ///< of packets that came

  std::uint64_t returns = 0, second_returns = 0;
  std::vector<std::uint64_t> returns_per_row;
  double minimum_range_m = 0, maximum_range_m = 0;
  std::optional<Error> ended_by;  ///< the recording is not whole
};

/// not_found, bad_input: no recording, no metadata. A recording that breaks off is reported as far as it
/// goes.
[[nodiscard]] Result<PcapReport> inspect_pcap(const std::filesystem::path& file,
                                              const std::filesystem::path& metadata);

}  // namespace rigor::ouster

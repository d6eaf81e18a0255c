// What a recording of a Velodyne holds, for `rigor inspect F.pcap`.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/velodyne/velodyne_device.h"

namespace rigor::velodyne {

struct PcapReport {
  std::string file;
  std::uint64_t frames = 0;  ///< of any kind
  std::uint64_t data_packets = 0, position_packets = 0, other_frames = 0;
  std::uint64_t malformed = 0;                   ///< on the data or position port and no packet
  std::map<std::string, std::uint64_t> faults;   ///< of those, by what is wrong
  std::uint64_t full_turns = 0;                  ///< good data packets with an azimuth of 36000, which is 0
  std::map<std::string, std::uint64_t> sources;  ///< data packets by "address:port"
  double duration_s = 0;                         ///< by the recording's stamps, first to last data packet

  std::optional<Model> model_by_byte, model_by_timing;
  std::uint8_t product_byte = 0;
  Model model = Model::vlp16;  ///< by which the rest is counted: timing, or else the byte
  bool model_known = false;
  std::map<std::string, std::uint64_t> return_modes;  ///< packets

  std::uint64_t valid_returns = 0;               ///< a return that a dual packet tells twice counts once
  std::vector<std::uint64_t> returns_per_laser;  ///< by laser id
  std::vector<double> elevation_deg;
  double minimum_range_m = 0, greatest_range_m = 0;
  std::uint64_t points_handed_on = 0;  ///< by the decoder; equal to valid_returns

  std::uint64_t revolutions = 0;  ///< whole ones, from azimuth 0 to azimuth 0
  double turns = 0;               ///< all that the rotor turned
  double rotation_hz = 0, packets_per_s = 0, position_packets_per_s = 0;

  std::uint64_t gaps = 0, packets_lost = 0;  ///< by the device's time
  double longest_gap_ms = 0;
  std::uint64_t clock_steps = 0;

  std::map<std::string, std::uint64_t> pps;  ///< position packets by PPS status
  std::string first_nmea, last_nmea;
  std::optional<Error> ended_by;  ///< the recording is not whole
};

/// not_found, bad_input: no recording. A recording that breaks off is reported as far as it goes.
[[nodiscard]] Result<PcapReport> inspect_pcap(const std::filesystem::path& file);
/// The same of a recording in memory; `name` is for messages.
[[nodiscard]] Result<PcapReport> inspect_pcap(std::span<const std::uint8_t> file, const std::string& name);

}  // namespace rigor::velodyne

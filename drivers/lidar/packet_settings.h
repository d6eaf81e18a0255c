// Keys that channels and emulators of packet LiDARs have in common.
//
//   { file: walk.pcap }                             a recording, or
//   { address: 0.0.0.0, socket_buffer_bytes: N }    where packets come to
//   { frame_id: top, buffers: 8, time: device, utc_offset_s: -37 }
#pragma once

#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <optional>
#include <string>

#include "drivers/lidar/packet_clock.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::packet_lidar {

struct PacketSettings {
  std::filesystem::path file;  ///< empty: the network
  std::string address = "0.0.0.0", frame_id;
  std::int64_t socket_buffer_bytes = 2 << 20;
  std::size_t buffers = 8;
};
/// Into `settings`, which has the driver's defaults. `network_keys`: keys of the driver that a recording has
/// no use for.
void read_packet_settings(const ChannelConfig& config, std::initializer_list<const char*> network_keys,
                          PacketSettings& settings);

/// `time`: device, arrival, or UTC by the driver's word for it.
[[nodiscard]] TimeSource read_time_source(const ConfigNode& params, const char* utc = "utc");
[[nodiscard]] std::optional<Duration> read_utc_offset(const ConfigNode& params);
/// An IPv4 address as text; empty where `fallback` is and there is none.
[[nodiscard]] std::string read_ipv4(const ConfigNode& params, std::string_view key, std::string fallback);
[[nodiscard]] std::uint16_t read_port(const ConfigNode& params, std::string_view key, std::uint16_t fallback,
                                      double least = 0);
/// In host order; 0: none.
[[nodiscard]] std::uint32_t ipv4_of(const std::string& text);

}  // namespace rigor::packet_lidar

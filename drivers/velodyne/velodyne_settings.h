// What a rig says of a Velodyne, as plain values.
//
//   backend: velodyne
//   address: 127.0.0.1        # local address that takes the packets; 0.0.0.0: any, broadcasts too
//   port: 2368
//   position_port: 8308       # 0: position packets are not listened to
//   from: 192.168.1.201       # packets of this sender alone; without it all are taken for one device's
//   model: auto               # or vlp16, hdl32e: whatever the product byte says
//   calibration: db.yaml      # the specimen's (calibration_file.h), against the rig's folder
//   unit: revolution          # a sample for each; or packet
//   cut_deg: 0                # where a revolution begins, clockwise from the connector's opposite side
//   rings: laser              # LidarPoint::ring counts lasers in firing order; or elevation, from the lowest
//   time: device              # or gps, arrival: packet_clock.h
//   socket_buffer_bytes: 2097152
//   buffers: 8                # samples that the channel can hold, those in the application's hands included
//
//   file: drive.pcap          # instead of address, port, from: a recording, against the rig's folder
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "drivers/lidar/packet_settings.h"
#include "drivers/velodyne/cloud_stream.h"

namespace rigor::velodyne {

struct SourceSettings : packet_lidar::PacketSettings {
  SourceSettings() { address = "127.0.0.1"; }

  std::string from;
  std::uint16_t port = kDataPort, position_port = kPositionPort;
  std::optional<Model> model;  ///< empty: found out
  std::filesystem::path calibration;
  RingOrder rings = RingOrder::laser;
  CloudStreamOptions stream;
};
/// Throws ConfigError. Setup.
[[nodiscard]] SourceSettings read_source_settings(const ChannelConfig& config);
/// What the channel's samples are.
void describe_clouds(const SourceSettings& settings, ChannelDescription& description);

/// Keys of an emulator beside `sensor` and what belongs to it:
///   address: 127.0.0.1        # where the packets go; a broadcast address, too
///   port: 2368, position_port: 8308, position_rate_hz: 144.5 (0: none)
///   model: vlp16              # or hdl32e
///   returns: strongest        # last, dual (the sensor model's `echoes.returns` has to be the same)
///   product: 0x22             # what the packets say; the model's own
///   pps: locked               # absent, synchronizing, error
///   latitude_deg, longitude_deg
///   pcap: sent.pcap           # what is sent is written as well, against the working directory
struct EmulatorSettings {
  std::string address = "127.0.0.1";
  std::uint16_t port = kDataPort, position_port = kPositionPort;
  double position_rate_hz = 144.5;
  Model model = Model::vlp16;
  ReturnMode returns = ReturnMode::strongest;
  std::uint8_t product = 0x22;
  PpsStatus pps = PpsStatus::locked;
  double latitude_deg = 0, longitude_deg = 0;
  std::string pcap;
};
/// Throws ConfigError. Setup.
[[nodiscard]] EmulatorSettings read_emulator_settings(const ConfigNode& params);

/// Samples, of the largest that this device can give: a revolution at 5 Hz, or at the channel's rate.
[[nodiscard]] std::size_t most_points(const SourceSettings& settings, Duration period);

}  // namespace rigor::velodyne

// What a rig says of a Livox Mid-360, as plain values.
//
//   backend: livox
//   kind: point_cloud             # or imu: the device's inertial measurement unit
//   host: 192.168.1.12            # the device: it is told to measure and to send here, and packets of others
//                                 # are passed over
//   command_port: 56100
//   data_type: cartesian_mm       # or cartesian_cm, spherical; the device's own without it
//   ready_s: 30                   # how long the device may take until it measures
//   address: 0.0.0.0              # local address that takes the packets
//   port: 56301                   # 56401 for imu
//   frame_ms: 100                 # of a point cloud; the channel's period without it
//   drop_noise: false             # leave out points of medium and low confidence
//   time: device                  # or utc (PTP, GPS), arrival: packet_clock.h
//   utc_offset_s: -37             # UTC less the device's time; −37 with PTP, which counts TAI, else 0
//   socket_buffer_bytes: 2097152
//   buffers: 8                    # samples that the channel can hold, those in the application's hands
//   included
//
//   file: drive.pcap              # instead of the network's keys: a recording, against the rig's folder
#pragma once

#include <optional>
#include <string>

#include "drivers/lidar/packet_settings.h"
#include "drivers/livox/lidar_control.h"
#include "drivers/livox/point_stream.h"

namespace rigor::livox {

struct SourceSettings : packet_lidar::PacketSettings {
  std::string host;
  std::uint16_t command_port = kCommandPort, port = kHostPointPort;
  std::optional<DataType> data_type;
  Duration ready = seconds(30);
  PointStreamOptions stream;
  bool port_given = false;
};
/// Throws ConfigError. Setup.
[[nodiscard]] SourceSettings read_source_settings(const ChannelConfig& config);

/// Keys of an emulator beside `sensor` and what belongs to it:
///   address: 127.0.0.1        # where it takes commands, and sends from
///   command_port: 56100, search_port: 56000 (0: it is not found by searching)
///   lidar_ports: true         # packets leave from 56200, 56300 and 56400; false: from any
///   serial: 47MDL00010101
///   start_up_ms: 0            # SELFCHECK and MOTORSTARTUP for so long, after start and reboot
///   host: 127.0.0.1           # where it sends until a host says otherwise
///   point_port: 56301, imu_port: 56401, state_port: 56201 (0: nothing is sent)
///   data_type: cartesian_mm, imu: true
///   mode: sampling            # or idle, ready
///   time: none                # or ptp: what its timestamps count
///   pcap: sent.pcap           # points and readings that are sent are written as well
struct EmulatorSettings {
  std::string address = "127.0.0.1";
  std::uint16_t search_port = kSearchPort;
  bool lidar_ports = true;
  LidarControl::Identity identity;
  LidarControl::Setup setup;
  TimeType time = TimeType::none;
  std::string pcap;
};
/// Throws ConfigError. Setup.
[[nodiscard]] EmulatorSettings read_emulator_settings(const ConfigNode& params);

}  // namespace rigor::livox

// What a rig says of an Ouster, as plain values.
//
//   backend: ouster
//   kind: point_cloud             # image: one of the sensor's fields; range_image: range and signal; imu:
//   its
//                                 # inertial measurement unit
//   host: 192.168.1.201           # the sensor: metadata comes from it, and packets of others are passed over
//   http_port: 80
//   tcp_port: 7501                # where HTTP has no metadata (firmware before 2.1); 0: not asked
//   configure: { udp_dest: auto, lidar_mode: 1024x10 }   # made active at arm where the sensor has others
//   ready_s: 60                   # how long the sensor may take to be RUNNING
//   metadata: os1.json            # in place of the sensor's own, against the rig's folder
//   address: 0.0.0.0              # local address that takes the packets
//   lidar_port, imu_port          # those of the metadata; else 7502, 7503
//   remission: reflectivity       # of points; or signal, near_infrared
//   field: signal                 # of an image; or near_infrared, reflectivity
//   pixel_format: Mono16          # or Mono8, which is the default of reflectivity
//   full_scale: 2000              # of Mono8: the number that becomes 255; 255 of reflectivity
//   time: device                  # or utc (PTP, sync pulse), arrival: packet_clock.h
//   utc_offset_s: -37             # UTC less the sensor's time; -37 with PTP, which counts TAI, else 0
//   socket_buffer_bytes: 4194304
//   buffers: 8                    # samples that the channel can hold, those in the application's hands
//   included
//
//   file: drive.pcap              # instead of the network's keys: a recording, against the rig's folder
//   metadata: drive.json          # needed with it
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "drivers/lidar/packet_settings.h"
#include "drivers/ouster/frame_stream.h"

namespace rigor::ouster {

struct SourceSettings : packet_lidar::PacketSettings {
  SourceSettings() { socket_buffer_bytes = 4 << 20; }

  std::string host;
  std::uint16_t http_port = 80, tcp_port = 7501;
  std::uint16_t lidar_port = 0, imu_port = 0;  ///< 0: the metadata's
  std::string configure;                       ///< JSON; empty: nothing
  Duration ready = seconds(60);
  std::filesystem::path metadata;
  FrameStreamOptions stream;
  std::optional<Duration> utc_offset;
};
/// Throws ConfigError. Setup.
[[nodiscard]] SourceSettings read_source_settings(const ChannelConfig& config);

/// Keys of an emulator beside `sensor` and what belongs to it:
///   address: 127.0.0.1        # where it serves HTTP and TCP
///   http_port: 7580, tcp_port: 7501 (0: not served)
///   product: OS-1-128, serial: "992000000001", firmware: v3.1.0
///   start_up_ms: 0            # INITIALIZING for so long, after start and reinitialize
///   imu_rate_hz: 100          # packets of a unit at rest; 0: none
///   config: { udp_dest: 127.0.0.1, udp_port_lidar: 7502, udp_profile_lidar: …, azimuth_window: [0, 360000] }
///                             # parameters as clients set them (sensor_control.h)
///   pcap: sent.pcap           # what is sent is written as well, against the working directory
struct EmulatorSettings {
  std::string address = "127.0.0.1";
  std::uint16_t http_port = 7580, tcp_port = 7501;
  std::string product = "OS-1-128", serial = "992000000001", firmware = "v3.1.0";
  Duration start_up;
  double imu_rate_hz = 100;
  std::string config;  ///< JSON
  std::string pcap;
};
/// Throws ConfigError. Setup.
[[nodiscard]] EmulatorSettings read_emulator_settings(const ConfigNode& params);

}  // namespace rigor::ouster

// What a rig says of a camera that Aravis drives, as plain values. The same keys describe the channel when it
// runs in virtual time with the emulator's model in the camera's place.
//
//   backend: aravis
//   device: Rigor-left          # id, serial, user name, MAC or model; or `address: 192.168.1.20`
//   interface: 127.0.0.1        # local address or interface name; without it every interface is asked
//   pixel_format: Mono8         # Mono8 Mono10 Mono12 Mono12p Mono16 BayerRG8 BayerRG10 BayerRG12 BayerRG16
//   RGB8 region: { x_px: 0, y_px: 0, width_px: 640, height_px: 480 } exposure_us: 4000 gain_db: 0 trigger:
//   free_run           # software: one exposure for each period of the bench's grid; hardware: by a line
//   trigger_line: Line1         # of a hardware trigger; with trigger_edge (rising, falling),
//   trigger_delay_us action: { device_key: 1, group_key: 1, group_mask: 1, lead_ms: 20, settle_s: 30 }   # of
//   trigger: action chunks: off                 # on: timestamp, exposure and gain come with each picture
//   ptp: off                    # on: the camera's clock follows a PTP master
//   part: Intensity             # of multi-part frames: component of the SFNC, or number of the part from 0
//   range_scale_mm, range_offset_mm   # of kind range_image, where the camera does not say them
//   amplitude_scale: 1          # of kind range_image: amplitude of a count
//   packet_size: auto           # or bytes, with IP and UDP headers
//   packet_delay_ns: 0
//   resend: true
//   packet_timeout_ms: 5        # silence after which what is missing is asked for again
//   frame_retention_ms: 200     # then the frame is given up
//   incomplete: mark            # hand on what is not whole, marked and with zeros in the gaps; or drop
//   socket_buffer_bytes: 4194304
//   packet_socket: auto         # packet sockets where that is allowed and worth it; or off
//   buffers: 16                 # frames that the channel can hold, those in the application's hands included
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "sensor-hal/channel/channel.h"

namespace rigor {

struct AravisSettings {
  std::string device, address, interface;
  std::string frame_id;
  PixelFormat format = PixelFormat::mono8;
  struct Region {
    std::uint32_t x_px = 0, y_px = 0, width_px = 0, height_px = 0;
  };
  std::optional<Region> region;       ///< empty: the whole sensor
  std::optional<double> exposure_us;  ///< empty: what the camera is set to
  std::optional<double> gain_db;
  bool software_trigger = false;
  bool hardware_trigger = false;
  std::string trigger_line = "Line1";  ///< the camera's name for it
  bool falling_edge = false;
  double trigger_delay_us = 0;
  /// Scheduled action commands (GigE Vision 2.0): all cameras of a group begin to expose at one instant of
  /// the PTP clock that they follow.
  struct Action {
    std::uint32_t device_key = 1, group_key = 1, group_mask = 1;
    Duration lead;    ///< from the command to the exposure
    Duration settle;  ///< arm waits so long for the camera's clock to follow its master
  };
  std::optional<Action> action;
  /// A range image of a 3D camera (kind range_image), or one picture of its multi-part frames.
  bool range = false;
  std::string part;  ///< SFNC component (Intensity, Range, Confidence, …) or number of the part; empty: none
  std::optional<double> range_scale_mm, range_offset_mm;  ///< empty: as the camera says
  double amplitude_scale = 1;                             ///< of a count
  bool chunks = false;  ///< instants, exposures and gains as the camera says them with each picture
  bool ptp = false;     ///< the camera's clock is to follow a PTP master
  std::optional<std::uint32_t> packet_size;  ///< empty: found out
  std::int64_t packet_delay_ns = 0;
  bool resend = true;
  Duration first_resend_after;
  Duration packet_timeout;
  Duration frame_retention;
  bool drop_incomplete = false;
  std::int64_t socket_buffer_bytes = 4 << 20;
  bool packet_socket_allowed = true;
  std::size_t buffers = 16;
  std::optional<Duration> arrival_delay;  ///< exposure start to arrival at best, for cameras without a latch
  int realtime_priority = 0;              ///< SCHED_FIFO of the receiving thread; 0: ordinary scheduling
  Duration reconnect_after;               ///< first pause between attempts; it doubles up to 0.25 s

  /// Each exposure is asked for by the bench.
  [[nodiscard]] bool triggered_by_bench() const { return software_trigger || action.has_value(); }
  /// Frames are asked for as multi-part ones.
  [[nodiscard]] bool parts() const { return range || !part.empty(); }
  /// How a person would name the camera: the selector as written.
  [[nodiscard]] std::string selector() const { return address.empty() ? device : address; }
};

/// Throws ConfigError. Setup context.
[[nodiscard]] AravisSettings read_aravis_settings(const ChannelConfig& config);

/// The channel's name without the side of a pair, plus `_optical`: "left.real" → "left_optical".
[[nodiscard]] std::string default_frame_id(const std::string& channel_name);

}  // namespace rigor

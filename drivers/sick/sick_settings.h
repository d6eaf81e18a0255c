// The keys of `backend: sick`: of channels, and of the emulators that stand for scanners. Both in the
// sensor's frame, as the sensor models have it: 0° is straight ahead, anticlockwise.
#pragma once

#include <string>

#include "drivers/sick/client_dialog.h"
#include "drivers/sick/scanner_device.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/models/lidar/lidar_model.h"

namespace rigor::sick {

struct ChannelSettings {
  std::string address;
  std::uint16_t port = 2112;
  std::string frame_id;
  Wish wish;
  Duration timeout;  ///< of an answer, and of a stream that says nothing
  std::size_t buffers = 16;
  double zero_index_deg = kZeroIndexDeg;  ///< device's frame
  Duration transport_delay, transport_sigma;
};
/// Throws ConfigError. `needs_address`: not in virtual time.
[[nodiscard]] ChannelSettings read_channel_settings(const ChannelConfig& config, bool needs_address);

/// The scanner that an emulator's entry describes; `scan` is that of its sensor model, or null: then the
/// entry has a map `scan` of its own. Throws ConfigError.
[[nodiscard]] ScannerConfig read_scanner(const ConfigNode& params, const models::LidarScan* scan);

}  // namespace rigor::sick

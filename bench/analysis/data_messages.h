// What `rigor check` reads of a message: its header, and of clouds, scans and frames what they hold.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {

/// What the messages of a channel are.
struct MessageForm {
  bool header = false;   ///< the first field is a std_msgs/Header
  bool spatial = false;  ///< its frame means a place
  enum class Content : std::uint8_t { other, cloud, scan, frames } content = Content::other;
};
/// `schema` may be null.
[[nodiscard]] MessageForm form_of(const record::Channel& channel, const record::Schema* schema);

/// Of a cloud or scan.
struct ScanContent {
  std::uint64_t points = 0;   ///< with a finite place that is not the origin; of a scan: finite ranges
  std::uint64_t columns = 0;  ///< of a cloud: degrees of azimuth with a point; of a scan: its rays
  double mean_intensity = 0;  ///< NaN: there is none
};
/// protocol: not as the type says.
[[nodiscard]] Result<ScanContent> read_cloud(record::Bytes message);
[[nodiscard]] Result<ScanContent> read_scan(record::Bytes message);

}  // namespace rigor

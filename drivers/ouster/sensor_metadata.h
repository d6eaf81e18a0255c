// What a sensor says of itself: where its beams point, how its packets are laid out. As JSON from the
// sensor's HTTP interface or from a file beside a recording, in either of the forms that are about:
//
//   flat    firmware 2.0 to 2.2, and files of ouster-sdk up to 0.7
//     { "beam_altitude_angles": […], "data_format": {…}, "lidar_mode": "1024x10", … }
//   nested  firmware 2.3 and 3.x, /api/v1/sensor/metadata
//     { "sensor_info": {…}, "config_params": {…}, "lidar_data_format": {…}, "beam_intrinsics": {…}, … }
//
// Sources: Ouster's Firmware User Manual (3.1, "Lidar Intrinsic Beam Angles", "HTTP API Reference"),
// ouster-sdk.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::ouster {

/// How a pixel lies in a packet.
enum class Profile : std::uint8_t {
  legacy,    ///< LEGACY: before firmware 2.3 the only one
  single,    ///< RNG19_RFL8_SIG16_NIR16
  dual,      ///< RNG19_RFL8_SIG16_NIR16_DUAL: two returns
  low_data,  ///< RNG15_RFL8_NIR8
};
inline constexpr std::array<Profile, 4> kProfiles{Profile::legacy, Profile::single, Profile::dual,
                                                  Profile::low_data};
/// As Ouster writes it.
[[nodiscard]] std::string_view name_of(Profile profile);
[[nodiscard]] std::optional<Profile> profile_named(std::string_view name);

/// "1024x10": columns of a turn, turns a second.
struct LidarMode {
  std::uint32_t columns = 1024;
  std::uint32_t rate_hz = 10;
  bool operator==(const LidarMode&) const = default;
};
[[nodiscard]] std::optional<LidarMode> mode_named(std::string_view name);
[[nodiscard]] std::string name_of(const LidarMode& mode);

/// Columns from first to last, both included; over the end of the turn where first > last.
struct ColumnWindow {
  std::uint32_t first = 0, last = 1023;
  [[nodiscard]] bool has(std::uint32_t column) const {
    return first <= last ? column >= first && column <= last : column >= first || column <= last;
  }
  bool operator==(const ColumnWindow&) const = default;
};

struct Metadata {
  std::string product_line, serial, firmware, status, timestamp_mode;
  LidarMode mode;
  Profile profile = Profile::legacy;
  std::uint32_t columns_per_packet = 16, pixels_per_column = 0;
  ColumnWindow window;
  std::vector<std::int32_t> pixel_shift;  ///< columns by which a row of the destaggered image is shifted
  /// By row, from the top. Azimuth: clockwise, of the beam against the encoder.
  std::vector<double> beam_altitude_deg, beam_azimuth_deg;
  double beam_origin_m = 0;    ///< from the lidar's origin to where beams begin, level, along the encoder
  double beam_origin_z_m = 0;  ///< and along the axis
  /// Row by row; maps lidar coordinates (imu coordinates) to sensor coordinates, in metres.
  std::array<double, 16> T_sensor_lidar{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  std::array<double, 16> T_sensor_imu{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  std::uint32_t initialization_id = 0;         ///< 0: not told
  std::uint16_t lidar_port = 0, imu_port = 0;  ///< 0: not told

  [[nodiscard]] std::uint32_t slots() const { return mode.columns / columns_per_packet; }
  [[nodiscard]] double column_period_s() const { return 1.0 / (mode.columns * mode.rate_hz); }
  /// Of the window.
  [[nodiscard]] std::uint32_t window_columns() const {
    return window.first <= window.last ? window.last - window.first + 1
                                       : mode.columns - window.first + window.last + 1;
  }
};

/// bad_input as `name: key: expected … got …`. Setup.
[[nodiscard]] Result<Metadata> parse_metadata(std::string_view json, std::string_view name);
/// not_found, bad_input. Setup.
[[nodiscard]] Result<Metadata> load_metadata(const std::filesystem::path& file);

}  // namespace rigor::ouster

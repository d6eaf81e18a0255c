// One scan as a telegram: the values of `sSN LMDscandata` and `sRA LMDscandata`, as they lie on the wire, so
// that what was decoded is encoded again byte for byte.
//
// Ranges are raw · scale + offset millimetres; raw values below 16 are no measurement (0: nothing came back,
// 1: blinded, the rest reserved). Angles are in 1/10000 degree in the device's frame: 90° is straight ahead,
// growing anticlockwise as seen from above. Times are microseconds since the device's start, modulo 2^32.
//
// Source: SICK, "Telegram Listing LiDAR sensors" 8014631, section 4.3.4; operating instructions LMS4000
// 8023198, annex 12.1 (lengths of name and comment in one byte, raw values below 16); recordings.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "drivers/sick/cola_b.h"

namespace rigor::sick {

inline constexpr std::uint16_t kFirstRange = 16;  ///< raw values below mean no measurement
inline constexpr std::size_t kMaxChannels = 16;   ///< of each width; five echoes have ten
inline constexpr std::size_t kMaxEncoders = 4;

struct ScanChannel {
  std::array<char, 5> name{};  ///< "DIST1" … "DIST5", "RSSI1" … "RSSI5", "VANG1", "ANGL1"
  float scale = 1, offset = 0;
  std::int32_t start_deg_e4 = 0;
  std::uint16_t step_deg_e4 = 0;
  std::vector<std::uint16_t> values;

  [[nodiscard]] std::string_view text() const { return {name.data(), name.size()}; }
  /// Echo of a "DISTn" or "RSSIn", from 0; -1 where the name is another.
  [[nodiscard]] int echo_of(std::string_view kind) const;
};

struct ScanPosition {
  std::array<float, 6> xyz_rotation{};
  std::uint8_t rotation_type = 0;
};
struct ScanTime {
  std::uint16_t year = 1970;
  std::uint8_t month = 1, day = 1, hour = 0, minute = 0, second = 0;
  std::uint32_t microsecond = 0;
};
struct ScanEvent {
  std::array<char, 4> type{};  ///< "FDIN"
  std::uint32_t encoder_position = 0, time_us = 0;
  std::int32_t angle = 0;
};

struct ScanData {
  std::uint16_t version = 1, device_number = 1;
  std::uint32_t serial_number = 0;
  std::array<std::uint8_t, 2> device_status{};  ///< second byte: 1 error, 2 pollution, 4 pollution error
  std::uint16_t telegram_counter = 0;           ///< telegrams given to the interface
  std::uint16_t scan_counter = 0;               ///< scans that the device made
  std::uint32_t time_since_startup_us = 0;      ///< when the mirror passed its zero index
  std::uint32_t time_of_transmission_us = 0;    ///< when the complete scan was given to the interface
  std::array<std::uint8_t, 2> inputs{}, outputs{};
  std::int16_t layer_angle = 0;
  std::uint32_t scan_frequency_hz_e2 = 0;
  std::uint32_t measurement_frequency_100hz = 0;
  struct Encoder {
    std::uint32_t position = 0;
    std::uint16_t speed = 0;
  };
  std::vector<Encoder> encoders;
  std::vector<ScanChannel> channels16, channels8;
  std::optional<ScanPosition> position;
  std::optional<std::string> name, comment;
  std::optional<ScanTime> time;
  std::optional<ScanEvent> event;
};

enum class ScanError : std::uint8_t { none, cut_short, too_long, bad_count, bad_flag };
[[nodiscard]] const char* to_text(ScanError error);

/// `values` is what follows "sSN LMDscandata ". Takes memory of `out`, which keeps it from scan to scan.
[[nodiscard]] ScanError decode_scan(Bytes values, ScanData& out);
/// Appends what decode_scan takes. Names and comments over 255 bytes are cut.
void encode_scan(const ScanData& scan, Buffer& out);

}  // namespace rigor::sick

// A SICK scanner as its clients know it: variables, methods, access levels, and scans. No socket, no thread,
// no clock: bytes in, bytes out, at instants that are told.
//
//   ScannerDevice device(config);
//   Session session;                                  // one for each connection
//   device.answer(session, telegram, now, out);       // appends the framed answer
//   if (device.measuring()) { device.begin_scan(…); device.append_scan(…, out); }
//
// What is told to one client holds for all (the device has one set of variables); only the access level and
// the subscriptions belong to a connection.
//
// Source: SICK, "Telegram Listing LiDAR sensors" 8014631, chapter 4; dialogues of sick_scan_xd with a LMS511
// and a TiM781S, as recorded.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "drivers/sick/scan_geometry.h"
#include "drivers/sick/telegram.h"
#include "rt-core/result.h"

namespace rigor::sick {

enum class Family : std::uint8_t { lms1xx, lms5xx, tim };

struct ScannerConfig {
  Family family = Family::lms1xx;
  std::string name, firmware;  ///< as DeviceIdent says them
  std::string location = "not defined";
  std::uint32_t serial_number = 1;
  ScanPattern pattern;  ///< all that the device measures; device's frame
  double scan_frequency_hz = 50;
  std::uint32_t echoes = 1;  ///< most that it can tell of one beam
  unsigned rssi_bits = 8;    ///< of what it measures: 8 or 16
  float distance_scale = 1;
  double zero_index_deg = kZeroIndexDeg;
  Duration processing = microseconds(500);  ///< from the last beam of the output range to the telegram
  bool started = true;                      ///< measures as soon as it is on, as the devices do
};
/// What a family is by default: name, firmware, RSSI and range. `pattern`, frequency and echoes are left.
[[nodiscard]] ScannerConfig scanner_config(Family family);

/// A pattern that no telegram can carry, or frequencies and steps that are none: bad_input.
[[nodiscard]] Status check(const ScannerConfig& config);

struct Session {
  std::uint8_t level = 0;  ///< 2 maintenance, 3 authorised client, 4 service
  bool scans = false;      ///< `sEN LMDscandata 1`
};

class ScannerDevice {
 public:
  explicit ScannerDevice(ScannerConfig config);

  /// Appends the answer to one telegram; an error where it is none or says what the device does not know.
  void answer(Session& session, Bytes body, DeviceTime now, Buffer& out);

  [[nodiscard]] bool measuring() const { return measuring_; }
  [[nodiscard]] const ScannerConfig& config() const { return config_; }
  [[nodiscard]] Duration period() const { return period_; }
  /// Of the scan whose zero index is passed at `zero`: when its first beam of all fires, and when its
  /// telegram goes out by itself.
  [[nodiscard]] DeviceTime first_beam(DeviceTime zero) const;
  [[nodiscard]] DeviceTime transmission(DeviceTime zero) const;

  /// A scan was made: `scan` is its number. False when the output interval leaves it out.
  [[nodiscard]] bool made_scan(std::uint64_t scan);
  /// The scan as it is sent from now on, also as an answer to `sRN LMDscandata`.
  void set_scan(std::span<const LidarPoint> points, std::uint64_t scan, DeviceTime zero,
                DeviceTime transmission);
  /// Appends `sSN LMDscandata` of the newest scan.
  void append_scan(Buffer& out) const;

  struct Counters {
    std::uint64_t requests = 0, refused = 0, malformed = 0, astray_points = 0;
  };
  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  struct OutputRange {
    std::int32_t start_deg_e4, stop_deg_e4;
  };
  struct DataConfig {
    std::uint8_t echo_mask = 1, channels_high = 0, rssi = 1, wide_rssi = 0, unit = 0;
    std::array<std::uint8_t, 2> encoder{};
    std::uint8_t position = 0, name = 0, comment = 0, time = 1;
    std::uint16_t interval = 1;
  };

  SopasError read(std::string_view name, DeviceTime now, Buffer& values);
  SopasError write(const Session& session, std::string_view name, Bytes values);
  SopasError method(Session& session, std::string_view name, Bytes values, Buffer& answer);
  SopasError subscribe(Session& session, std::string_view name, Bytes values, Buffer& answer);
  SopasError set_data_config(Bytes values);
  SopasError set_output_range(Bytes values);
  SopasError set_scan_config(Bytes values, Buffer& answer);
  void put_scan_config(Buffer& out) const;
  [[nodiscard]] ChannelPlan plan() const;

  ScannerConfig config_;
  Duration period_;
  std::uint32_t step_deg_e4_ = 0;
  OutputRange range_{};
  DataConfig data_;
  EchoFilter filter_ = EchoFilter::first;
  bool measuring_ = true;
  std::uint16_t telegram_counter_ = 0;
  ScanData scan_;
  ScanMaker maker_;
  bool have_scan_ = false;
  Counters counters_;
};

}  // namespace rigor::sick

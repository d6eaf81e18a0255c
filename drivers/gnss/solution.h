// What a receiver says of one instant, in SI units, whichever protocol it came by.
//
// Times: a receiver counts GNSS time, which knows no leap seconds. `t_device` counts it on and on from the
// first epoch's week or day, so that neither a week's end nor a leap second is a step. `utc` is what the
// receiver says the date is.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::gnss {

inline constexpr double kRadPerDeg = std::numbers::pi / 180;

/// Numbers as in UBX: the constellation, and the satellite's own number in it.
enum class Gnss : std::uint8_t {
  gps = 0,
  sbas = 1,
  galileo = 2,
  beidou = 3,
  imes = 4,
  qzss = 5,
  glonass = 6
};
struct SatelliteId {
  Gnss gnss = Gnss::gps;
  std::uint8_t satellite = 0;  ///< GPS 1 to 32, SBAS 120 to 158, GLONASS 1 to 32 (slot); 0, 255: not known
  friend auto operator<=>(const SatelliteId&, const SatelliteId&) = default;
};
/// One number for all constellations, as NMEA receivers with extended numbers and gpsd have it: GPS 1 to 32,
/// SBAS 33 to 64, GLONASS 65 to 96, QZSS 193 on, Galileo 301 on, BeiDou 401 on. 0: there is none.
[[nodiscard]] std::uint16_t nmea_number(SatelliteId id) noexcept;

struct Satellite {
  SatelliteId id;
  std::uint8_t signal = 0;  ///< NMEA's number of the signal; 0: not told apart
  float elevation_deg = std::numeric_limits<float>::quiet_NaN();
  float azimuth_deg = std::numeric_limits<float>::quiet_NaN();  ///< clockwise from north
  float cn0_dbhz = std::numeric_limits<float>::quiet_NaN();     ///< NaN: not tracked, or not told
  bool used = false;
};

/// Satellites in view.
struct Sky {
  std::optional<DeviceTime> t_device;  ///< of the instant that it belongs to; none before the first one
  std::vector<Satellite> satellites;   ///< one entry for each signal that is told apart
};

struct Solution {
  enum class Mode : std::uint8_t { none, time_only, dead_reckoning, fix_2d, fix_3d };
  DeviceTime t_device;
  std::optional<RealtimeTime> utc;  ///< none before the receiver knows the date
  Mode mode = Mode::none;
  FixStatus status = FixStatus::none;
  bool corrected = false;  ///< by SBAS, a base station or another source
  // NaN: not told.
  double latitude_deg = kNone, longitude_deg = kNone;
  double height_m = kNone, height_msl_m = kNone;  ///< above the ellipsoid, above mean sea level
  std::array<double, 3> velocity_enu_mps{kNone, kNone, kNone};
  double speed_mps = kNone, course_deg = kNone;  ///< over ground
  std::array<double, 9> covariance_enu_m2 = unknown_covariance();
  bool covariance_told = false;  ///< by the receiver; else from its dilution of precision, or not known
  double velocity_sigma_mps = kNone;
  double pdop = kNone, hdop = kNone, vdop = kNone;
  double correction_age_s = kNone;
  std::uint16_t satellites_used = 0;
  Duration time_sigma{};  ///< of the receiver's own clock; 0: not told

  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  [[nodiscard]] static constexpr std::array<double, 9> unknown_covariance() {
    std::array<double, 9> c{};
    c.fill(kNone);
    return c;
  }
  [[nodiscard]] bool has_fix() const { return status != FixStatus::none; }
};

/// The pulse that a receiver announces with UBX-TIM-TP.
struct TimePulse {
  DeviceTime t_device;         ///< of the pulse, in the time of Solution::t_device
  double quantization_ns = 0;  ///< true time of the edge less that time; NaN: not told
  bool utc_base = false;       ///< the second of UTC, else of GNSS time
};

/// The sample of a solution: covariance where it is known, else zeros (ROS: unknown).
[[nodiscard]] NavFix nav_fix_of(const Solution& solution) noexcept;

}  // namespace rigor::gnss

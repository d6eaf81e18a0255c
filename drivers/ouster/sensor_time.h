// How a sensor counts time by its configuration, and where its encoder stands with phase lock. Sources:
// Ouster's Firmware User Manual (3.1, "Time Synchronization", "Multi-Sensor Synchronization").
//
//   TIME_FROM_INTERNAL_OSC    since it was switched on
//   TIME_FROM_SYNC_PULSE_IN   pulses, one at each full second of UTC, since it was switched on; with
//                             INPUT_NMEA_UART UTC itself, and nmea_leap_seconds more
//   TIME_FROM_PTP_1588        TAI
//
// With phase lock the encoder passes `phase_lock_offset` at each full second of UTC, and as turns divide the
// second, once in each of its tenths (10 turns a second). The angle is that of the lidar's frame:
// anticlockwise from the connector.
#pragma once

#include "rt-core/time.h"

namespace rigor::ouster {

/// TAI less UTC, since 2017.
inline constexpr Duration kTaiLessUtc = seconds(37);

struct SensorTime {
  enum class Mode : std::uint8_t { internal, sync_pulse, ptp } mode = Mode::internal;
  bool nmea = false;  ///< the multipurpose IO takes NMEA messages
  Duration nmea_leap;
  bool phase_lock = false;
  double phase_lock_deg = 0;

  /// The sensor's counter at `utc`, in nanoseconds.
  [[nodiscard]] std::uint64_t count_at(RealtimeTime utc, RealtimeTime switched_on) const;
  /// When its first frame begins: at `earliest`, or with phase lock as soon thereafter as the phase says.
  [[nodiscard]] RealtimeTime first_frame(RealtimeTime earliest, Duration frame_time) const;
};

}  // namespace rigor::ouster

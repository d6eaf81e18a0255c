// Between scans of telegrams and points: angles, instants, ranges.
//
// The device's frame has its x axis at 0° of its own count and straight ahead at 90°; the sensor's frame of
// docs/conventions.md has x ahead. So azimuth = angle − 90°, both anticlockwise as seen from above.
//
// A scan begins when the mirror passes its zero index, which the telegram stamps, and turns at the scan
// frequency f. A beam at angle a is fired at
//
//     t_zero + (a − zero_index) / 360° / f
//
// No manual says where the zero index lies; −90° (straight behind, the middle of the blind sector) is what
// fits the recordings, and a setting. A LMS511 stamps the index before its scan. A TiM781S gives its scan to
// the interface 7.7 ms after the instant it stamps, when at 15 revolutions a second no beam but the first 14°
// can have been fired: the stamp is then the index behind the scan, one revolution later. `scan_instants`
// tells them apart by that alone: no beam is fired after the scan was given away.
//
// A telegram rounds the angular step to 1/10000 degree, which is 0.04° over 1141 beams of 1/6 degree. Devices
// divide the degree by twelfths (1/12, 1/6, 1/4, 1/3, 1/2, 2/3, 1): `step_deg` undoes the rounding.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "drivers/sick/scan_data.h"
#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::sick {

inline constexpr double kAheadDeg = 90;       ///< in the device's frame
inline constexpr double kZeroIndexDeg = -90;  ///< device's frame
inline constexpr std::size_t kMaxEchoes = 5;

/// Of the step of a telegram or a setting, 1/10000 degree.
[[nodiscard]] double step_deg(std::uint32_t step_deg_e4);

/// Microseconds modulo 2^32 made into a time that goes on (71 minutes are not the end).
class MicrosecondClock {
 public:
  /// Of readings that are less than 35 minutes apart, earlier or later.
  [[nodiscard]] DeviceTime at(std::uint32_t us) noexcept;
  void reset() noexcept { known_ = false; }

 private:
  std::int64_t us_ = 0;
  bool known_ = false;
};

/// Instants of one scan on the device's clock.
struct ScanInstants {
  DeviceTime first_beam, transmission;
  Duration period;     ///< of a revolution; 0 where the telegram does not say
  Duration beam_step;  ///< from beam to beam
};
[[nodiscard]] ScanInstants scan_instants(const ScanData& scan, MicrosecondClock& clock,
                                         double zero_index_deg = kZeroIndexDeg) noexcept;

/// Scans to points. Keeps the sines of a scan's beams until another geometry comes.
class CloudMaker {
 public:
  /// Points in the order of firing, echoes of a beam from the first on; no measurement, no point. The
  /// return_index is the echo's: 0 for DIST1. Remission is the RSSI as sent, NaN where none came, or none
  /// that is a number. Scale and offset come from the device, too: a range that is not finite is no point.
  /// False: more points than `points` has room for, no DIST1, or beams further apart than 2^31 ns, which a
  /// point cannot say.
  [[nodiscard]] bool fill(const ScanData& scan, Duration beam_step, std::span<std::byte> memory,
                          std::uint32_t& count);

 private:
  std::int32_t start_deg_e4_ = 0;
  std::uint16_t step_deg_e4_ = 0;
  std::vector<float> cosine_, sine_;
};

/// Beams of a device as it is set: device's frame.
struct ScanPattern {
  double start_deg = 0;
  double step_deg = 1;
  std::uint32_t beams = 0;
  [[nodiscard]] double stop_deg() const { return start_deg + step_deg * (beams > 0 ? beams - 1 : 0); }
};

enum class EchoFilter : std::uint8_t { first = 0, all = 1, last = 2 };

/// How points become channels.
struct ChannelPlan {
  ScanPattern pattern;
  EchoFilter filter = EchoFilter::first;
  std::uint32_t echoes = 1;  ///< DIST channels
  bool rssi = true;
  bool rssi_16_bit = false;
  unsigned rssi_shift = 0;   ///< of the points' remission, before it is sent
  float distance_scale = 1;  ///< 2: twice as far, by steps of 2 mm
};

/// Points to scans: each point goes to the beam that its azimuth is nearest to. Keeps its memory.
class ScanMaker {
 public:
  /// Fills the channels. Points between beams (by more than half a step), beyond the pattern, and echoes
  /// beyond what there are channels for are left out. Returns how many lay where no beam is.
  std::size_t fill(std::span<const LidarPoint> points, const ChannelPlan& plan, ScanData& scan);

 private:
  struct Echo {
    float range_mm, rssi;
  };
  std::vector<std::array<Echo, kMaxEchoes>> echoes_;
  std::vector<std::uint8_t> counts_;
};

}  // namespace rigor::sick

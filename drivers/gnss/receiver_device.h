// A u-blox receiver as its hosts know it: which messages it sends, how it is configured, and what RTCM does
// to its fix. No socket, no thread, no clock: bytes in, bytes out, at instants that are told.
//
//   ReceiverDevice device(settings);
//   device.receive(bytes, now);                        // of the host; answers wait in output()
//   device.speak(measured, utc, index, pulse_follows); // the messages of one instant
//
// Source: as ubx.h. What it measures comes from the model of a receiver (sensor-hal/models/gnss). Satellites
// have directions that stand still: their number is the model's, their geometry is no constellation's, and
// the dilution of precision is that of this geometry.
#pragma once

#include <string>
#include <vector>

#include "drivers/gnss/gnss_settings.h"
#include "drivers/gnss/nmea.h"

namespace rigor::gnss {

struct Measured {
  NavFix fix;
  std::array<double, 3> velocity_enu_mps{};
};

/// Dilution of precision of the used satellites of a sky: the square roots of the diagonal of (GᵀG)⁻¹, with a
/// row (e, n, u, 1) of G for each. NaN with fewer than four, or all in one plane.
struct Dilution {
  double geometric = Solution::kNone, position = Solution::kNone, time = Solution::kNone,
         vertical = Solution::kNone, horizontal = Solution::kNone, northing = Solution::kNone,
         easting = Solution::kNone;
};
[[nodiscard]] Dilution dilution_of(const Sky& sky) noexcept;

/// `used` satellites, and three more in view: GPS 1 to 12, Galileo, GLONASS and BeiDou in turns.
[[nodiscard]] Sky made_sky(unsigned used);

class ReceiverDevice {
 public:
  explicit ReceiverDevice(const EmulatorSettings& settings);

  /// Bytes of the host: UBX requests, RTCM 3 corrections.
  void receive(Bytes bytes, BenchTime now);
  /// Appends the messages of one instant to output(). `index` counts instants; `pulse`: a full second of GNSS
  /// time begins with the next instant or before it.
  void speak(const Measured& measured, RealtimeTime utc, std::uint64_t index, BenchTime now);
  [[nodiscard]] Buffer& output() { return output_; }
  [[nodiscard]] unsigned baud() const { return baud_; }
  /// Between instants; a host may have set it.
  [[nodiscard]] Duration period() const { return period_; }
  [[nodiscard]] const Solution& solution() const { return solution_; }

  struct Counters {
    std::uint64_t requests = 0, refused = 0, rtcm = 0, malformed = 0;
  };
  [[nodiscard]] Counters counters() const;

 private:
  [[nodiscard]] bool due(std::string_view message, std::uint64_t index) const;
  [[nodiscard]] bool configure(const Message& m);
  bool set_rate(UbxId id, std::uint8_t rate);
  bool set_item(const ConfigItem& item);
  void speak_ubx(const Sky& sky, const Dilution& d, std::uint64_t index, GpsTime gps);
  void speak_nmea(const Sky& sky, std::uint64_t index);

  EmulatorSettings settings_;
  Duration period_;
  unsigned baud_;
  bool ubx_out_ = true, nmea_out_ = true, high_precision_ = false;
  std::vector<std::uint8_t> rates_;  ///< by place in output_messages()
  MessageStream host_;
  Buffer output_, sentences_;
  Solution solution_;
  std::optional<BenchTime> corrected_at_;
  Counters counters_;
};

}  // namespace rigor::gnss

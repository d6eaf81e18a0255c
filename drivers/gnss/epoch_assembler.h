// From messages to solutions: what a receiver says of one instant comes in several messages, and nothing but
// the next instant's first message, or silence, says that the last one has come.
//
//   UBX    messages with one time of week: NAV-PVT, and NAV-DOP, NAV-COV, NAV-HPPOSLLH, NAV-EOE where they
//   are NMEA   sentences with one time of day, and those without a time between them
//
// The message that was the last of an instant is remembered: from the second instant on a solution is handed
// over as soon as that message is there. Where both protocols are on one line, NAV-PVT wins, because its
// values are finer and its time has no leap seconds.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "drivers/gnss/gnss_time.h"
#include "drivers/gnss/message_stream.h"
#include "drivers/gnss/solution.h"

namespace rigor::gnss {

class EpochAssembler {
 public:
  struct Options {
    /// Of one range, standard deviation: a receiver that tells its dilution of precision alone is taken to
    /// have √2·this·HDOP across both horizontal axes, and this·VDOP upwards.
    double range_error_m = 5;
  };
  struct Counters {
    std::uint64_t solutions = 0, skies = 0, pulses = 0, raw_measurements = 0;
    std::uint64_t malformed = 0;          ///< messages whose checksum is right and whose fields are not
    std::uint64_t incomplete_groups = 0;  ///< of GSV, left out because a sentence of them is missing
    std::uint64_t after_the_end = 0;      ///< messages of an instant that was handed over already
  };
  /// `arrival`: of the first message of the instant.
  struct Handler {
    std::function<void(const Solution&, BenchTime arrival)> solution;
    std::function<void(const Sky&)> sky;  ///< of the solution that came last or comes next
    std::function<void(const TimePulse&)> pulse;
    std::function<void(Bytes payload)> raw;  ///< RXM-RAWX
  };

  EpochAssembler(const Options& options, Handler handler);
  /// I/O thread; calls the handler.
  void take(const Message& message, BenchTime arrival);
  /// The line is silent, or the recording ends: what is pending is complete.
  void flush();
  /// The receiver was away: nothing pending, no memory of its clock.
  void reset();
  [[nodiscard]] const Counters& counters() const { return counters_; }
  /// GPS time less UTC, where a message told it.
  [[nodiscard]] std::optional<int> leap_seconds() const { return leap_seconds_; }

 private:
  /// A message's place in the order of an instant: what it is, and the how-manieth of its kind.
  using Tag = std::uint64_t;
  struct Pending {
    bool any = false, handed = false, ubx = false;
    std::int64_t key = 0;  ///< time of week or of day
    bool has_covariance = false, has_fine_place = false, has_accuracy = false;
    BenchTime arrival;
    Tag last = 0;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> seen;  ///< kinds, and how often
    Solution s;
  };

  void take_ubx(const Message& m, BenchTime arrival);
  void take_nmea(const Message& m, BenchTime arrival);
  bool take_sentence(const struct Sentence& s, BenchTime arrival);
  bool take_gsa(const struct Sentence& s);
  bool take_gsv(const struct Sentence& s);
  /// Of a message of this time: the pending instant, begun anew where it is another. Null: it was handed
  /// over.
  Solution* open(bool ubx, std::int64_t key, BenchTime arrival);
  bool open_day(const struct TimeOfDay& t, BenchTime arrival);
  void close(std::uint32_t kind);
  void hand_over();
  void finish_sky();
  void drop_open_group();
  void set_date(const struct Date& date);

  Options options_;
  Handler handler_;
  Counters counters_;
  Pending now_;
  Tag end_ = 0;
  bool ubx_speaks_ = false;
  unsigned sentences_since_pvt_ = 0;
  Unwrapper week_{kWeek_ns}, day_{kDay_ns};
  std::int64_t leaps_ns_ = 0;  ///< leap seconds that went by, of NMEA
  bool in_leap_second_ = false;
  std::optional<std::int64_t> utc_minus_day_ns_;
  std::optional<int> leap_seconds_;
  NavSat sat_;
  std::vector<SatelliteId> used_;
  bool used_of_this_ = false;
  Sky sky_;
  bool sky_open_ = false;
  int sky_next_ = 1, sky_total_ = 0;
  std::size_t sky_group_ = 0;  ///< where the open group's satellites begin
};

}  // namespace rigor::gnss

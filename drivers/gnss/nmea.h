// NMEA 0183 sentences of satellite receivers: values from text and back. No socket, no clock. Source: NMEA
// 0183 version 4.11 as u-blox describes it (UBX-22008968, chapter 2). Sentences come as the text between `$`
// and `*` (message_stream.h).
//
// A field that is empty is a value that the receiver does not know: numbers are NaN then. A field that is no
// number makes the sentence malformed.
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/gnss/bytes.h"
#include "drivers/gnss/solution.h"

namespace rigor::gnss {

inline constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

/// A sentence in fields.
struct Sentence {
  static constexpr std::size_t kMaxFields = 40;
  std::string_view talker, formatter;  ///< "GN", "RMC"
  std::array<std::string_view, kMaxFields> field{};
  std::size_t fields = 0;
  [[nodiscard]] std::string_view operator[](std::size_t i) const { return i < fields ? field[i] : ""; }
};
/// Empty: no address of five characters, proprietary (`PUBX`), or more fields than any sentence has.
[[nodiscard]] std::optional<Sentence> split_sentence(std::string_view text) noexcept;

/// Of the day; 60 seconds and more in a leap second.
struct TimeOfDay {
  std::int64_t ns = 0;
  bool leap_second = false;  ///< the second is 60
};
struct Date {
  int year = 0, month = 0, day = 0;
};

/// What every sentence with a place has. Degrees; south and west are negative.
struct NmeaPlace {
  double latitude_deg = kUnknown, longitude_deg = kUnknown;
};
struct Gga {
  std::optional<TimeOfDay> time;
  NmeaPlace place;
  int quality = 0;  ///< 0 none, 1 fix, 2 with corrections, 4 RTK fixed, 5 RTK float, 6 estimated
  int satellites = 0;
  double hdop = kUnknown, height_msl_m = kUnknown, geoid_separation_m = kUnknown;
  double correction_age_s = kUnknown;
};
struct Rmc {
  std::optional<TimeOfDay> time;
  std::optional<Date> date;
  bool valid = false;
  NmeaPlace place;
  double speed_mps = kUnknown, course_deg = kUnknown;
  char mode = 0;  ///< of NMEA 2.3 and later: A, D, E, F, N, R; 0: not told
};
struct Gll {
  std::optional<TimeOfDay> time;
  NmeaPlace place;
  bool valid = false;
};
struct Vtg {
  double course_deg = kUnknown, speed_mps = kUnknown;
};
struct Gst {
  std::optional<TimeOfDay> time;
  double sigma_latitude_m = kUnknown, sigma_longitude_m = kUnknown, sigma_height_m = kUnknown;
};
struct Zda {
  std::optional<TimeOfDay> time;
  std::optional<Date> date;
};
struct Gsa {
  int mode = 1;  ///< 1 none, 2 2D, 3 3D
  std::array<SatelliteId, 12> used{};
  std::size_t count = 0;
  double pdop = kUnknown, hdop = kUnknown, vdop = kUnknown;
};
struct Gsv {
  int total = 0, number = 0;
  unsigned signal = 0;  ///< of NMEA 4.10 and later
  std::array<Satellite, 4> satellite{};
  std::size_t count = 0;
};

// Empty: fields that are no values of this sentence.
[[nodiscard]] std::optional<Gga> parse_gga(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Rmc> parse_rmc(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Gll> parse_gll(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Vtg> parse_vtg(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Gst> parse_gst(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Zda> parse_zda(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Gsa> parse_gsa(const Sentence& s) noexcept;
[[nodiscard]] std::optional<Gsv> parse_gsv(const Sentence& s) noexcept;

/// Appends `$…*hh\r\n` of what stands between `$` and `*`.
void append_sentence(Buffer& out, std::string_view text);

/// How many digits a receiver writes.
struct NmeaDigits {
  int minutes = 5, height = 1, time = 2;  ///< behind the point; of high precision 7, 3, 2
};
/// Appends what a receiver says of one epoch: RMC, VTG, GGA, GSA for each constellation, GLL, GST, ZDA; GN as
/// talker. Without a fix the places are empty.
void append_solution_sentences(Buffer& out, const Solution& solution, const Sky& sky,
                               const NmeaDigits& digits);
/// Appends GSV, by constellation: GP, GL, GA, GB, GQ, with the numbers of NMEA 4.11.
void append_sky_sentences(Buffer& out, const Sky& sky);

}  // namespace rigor::gnss

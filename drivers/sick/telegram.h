// Telegrams of CoLa-B: a command type, a name, and binary values behind a space.
//
//   sRN read    → sRA        sWN write → sWA        sMN method → sAN        sEN subscribe → sEA, then sSN
//   anything    → sFA + uint16 error, without a space and without a name (so it was recorded)
//
// Source: SICK, "Telegram Listing LiDAR sensors" 8014631, section 2.4; the errors' names are SICK's own.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/sick/cola_b.h"

namespace rigor::sick {

enum class SopasError : std::uint16_t {
  ok = 0,
  method_access_denied = 1,
  unknown_method = 2,
  unknown_variable = 3,
  local_condition_failed = 4,  ///< a value outside the range that the variable takes
  invalid_data = 5,
  buffer_underflow = 8,  ///< more data was expected
  write_access_denied = 10,
  unknown_command = 12,
  unknown_event = 15
};
/// SICK's own name: "METHODIN_ACCESSDENIED"; empty where the manual has none.
[[nodiscard]] std::string_view sopas_error_name(std::uint16_t error);

/// Views into a body.
struct Telegram {
  std::string_view type;  ///< "sRN"
  std::string_view name;  ///< "LMDscandata"; empty in an error
  Bytes values;           ///< what is behind the space

  [[nodiscard]] bool is(std::string_view t, std::string_view n) const { return type == t && name == n; }
  [[nodiscard]] bool error() const { return type == "sFA"; }
  /// Of an error; 6 (unknown) where the device did not say.
  [[nodiscard]] std::uint16_t error_code() const;
};

/// Empty when these bytes are no telegram: shorter than a type, or a name that is none.
[[nodiscard]] std::optional<Telegram> parse_telegram(Bytes body);

/// "sRN name", framed; `values` follow a space when there are some.
void append_telegram(Buffer& out, std::string_view type, std::string_view name, Bytes values = {});
void append_error(Buffer& out, SopasError error);

/// A string with its length in two bytes, as FirmwareVersion, DeviceIdent and LocationName have them.
void append_string(Buffer& out, std::string_view text);

}  // namespace rigor::sick

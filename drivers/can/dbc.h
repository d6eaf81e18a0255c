// CAN databases (DBC files): which messages a bus carries and what their bits mean.
//
//   BO_ 496 TableState: 8 Turntable                                     a message: id, name, bytes, sender
//    SG_ position : 0|32@1- (0.001,0) [-1e6|1e6] "deg"  Bench           a signal: bits, factor, offset, unit
//
//   value = raw · factor + offset
//
// Read of the format: BU_, BO_, SG_ with multiplexing (`M`, `m3`, `m3M`), SG_MUL_VAL_, SIG_VALTYPE_,
// VAL_TABLE_, VAL_, BO_TX_BU_, and the attributes GenMsgCycleTime, GenSigStartValue, VFrameFormat and
// CANFD_BRS with their defaults. Everything else (comments, environment variables, groups, relations) is
// passed over. Identifiers above 2^31 are extended ones. A message is CAN FD where VFrameFormat says so or
// where it has more than 8 bytes. Bytes that are not UTF-8 are taken for Windows-1252, as the makers of the
// format write them.
//
// Positions: bit 8·n + k is bit k of byte n, k = 0 the least significant. Intel signals (`@1`) grow upwards
// from their start bit, the least significant; Motorola ones (`@0`) are given by their most significant bit
// and run down to bit 0 of the byte, then from bit 7 of the next.
//
// Setup context; allocates. A file is bounded: 64 MiB, 65536 messages, 4096 signals in each.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::can {

/// Multiplexors that may select one another down to a signal. A file with more is refused.
inline constexpr std::size_t kMostMultiplexors = 8;

enum class BitOrder : std::uint8_t { intel, motorola };
enum class RawType : std::uint8_t { integer, float32, float64 };

struct ValueName {
  std::int64_t raw = 0;
  std::string text;
};

struct Signal {
  struct MuxRange {
    std::uint64_t first = 0, last = 0;  ///< raw values of the multiplexor, both included
  };
  std::string name, unit;
  std::uint16_t start_bit = 0, length_bits = 0;
  BitOrder order = BitOrder::intel;
  RawType type = RawType::integer;
  bool is_signed = false;
  double factor = 1, offset = 0;
  double minimum = 0, maximum = 0;  ///< equal: the file states no range
  bool multiplexor = false;
  int multiplexed_by = -1;      ///< index in the message; -1: always there
  std::vector<MuxRange> shown;  ///< by which values of the multiplexor
  std::vector<ValueName> values;
  double start_raw = 0;  ///< GenSigStartValue

  [[nodiscard]] bool has_range() const noexcept { return minimum < maximum; }
  [[nodiscard]] bool shown_by(std::uint64_t multiplexor_raw) const noexcept;
};

struct Message {
  std::string name;
  std::vector<std::string> senders;  ///< the first is that of BO_; `Vector__XXX` (nobody) is left out
  std::uint32_t id = 0;
  bool extended = false, fd = false, bit_rate_switch = false;
  std::uint16_t length = 0;  ///< bytes; more than 64 belong to a transport protocol
  Duration cycle;            ///< GenMsgCycleTime; 0: not cyclic
  std::vector<Signal> signals;

  [[nodiscard]] int index_of(std::string_view signal) const noexcept;  ///< -1: none
  [[nodiscard]] bool fits_a_frame() const noexcept { return length <= 64; }
};

struct Dbc {
  std::string name;  ///< of the file, for messages
  std::vector<std::string> nodes;
  std::vector<Message> messages;

  [[nodiscard]] const Message* message(std::string_view message_name) const noexcept;
  [[nodiscard]] const Message* message(std::uint32_t id, bool extended) const noexcept;
};

/// bad_input with `name:line:column: expected …, got …`.
[[nodiscard]] Result<Dbc> parse_dbc(std::string_view text, std::string_view name);
[[nodiscard]] Result<Dbc> load_dbc(const std::filesystem::path& file);

}  // namespace rigor::can

// What the registers of a device mean: names, types, scales, units and byte orders, and the way between
// values and raw registers.
//
//   registers:
//     - { name: position, table: input_registers, address: 0, type: s32, byte_order: CDAB, scale: 0.001,
//     unit: deg }
//
//   value = raw · scale + offset
//
// Modbus says nothing of types wider than a register, so makers differ in how they spread the bytes A (most
// significant) to D over two registers:
//
//   byte_order   first register   second        64 bits
//   ABCD         A B              C D           ABCD EFGH
//   CDAB         C D              A B           GHEF CDAB   registers the other way round
//   BADC         B A              D C           BADC FEHG   bytes within each register the other way round
//   DCBA         D C              B A           HGFE DCBA   both
//
// Values of one register know the order of their two bytes alone: BADC and DCBA swap them. Addresses are
// those of the protocol, counted from 0 in each table ("40001" of a manual is holding register 0).
//
// A register of 16 bits may hold several things: `bit: 3` is one of its bits, `bits: [4, 3]` three of them
// from bit 4 on (0 is the least significant), as an unsigned number. Written, such a field changes its own
// bits alone (function 22, mask write).
//
// What is asked for in one go: neighbours, and where `max_gap` allows it what lies between them; values with
// `every: n` only at each n-th instant, apart from the others.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::modbus {

enum class ValueType : std::uint8_t { boolean, u16, s16, u32, s32, u64, s64, f32, f64 };
enum class ByteOrder : std::uint8_t { abcd, cdab, badc, dcba };

/// Registers that a value of this type takes.
[[nodiscard]] constexpr std::uint16_t width(ValueType t) noexcept {
  switch (t) {
    case ValueType::boolean:
    case ValueType::u16:
    case ValueType::s16:
      return 1;
    case ValueType::u32:
    case ValueType::s32:
    case ValueType::f32:
      return 2;
    case ValueType::u64:
    case ValueType::s64:
    case ValueType::f64:
      return 4;
  }
  return 1;
}

/// Coils and discrete inputs hold one bit each, the other tables 16.
[[nodiscard]] constexpr bool is_bits(RegisterTable t) noexcept {
  return t == RegisterTable::coils || t == RegisterTable::discrete_inputs;
}
[[nodiscard]] const char* table_name(RegisterTable t) noexcept;

struct RegisterValue {
  std::string name, unit;
  RegisterTable table = RegisterTable::holding_registers;
  std::uint16_t address = 0;
  ValueType type = ValueType::u16;
  ByteOrder order = ByteOrder::abcd;
  double scale = 1, offset = 0;
  std::uint8_t first_bit = 0, bit_count = 16;  ///< of a u16 or bool register: which of its bits
  std::uint32_t every = 1;                     ///< asked for at each n-th instant
  [[nodiscard]] bool is_field() const noexcept { return bit_count < 16; }
  /// The bits of its register that are its own.
  [[nodiscard]] std::uint16_t mask() const noexcept {
    return static_cast<std::uint16_t>(((1u << bit_count) - 1u) << first_bit);
  }
};

/// Adjacent registers that travel in one request; their raw values stand in the map's raw block from `raw_at`
/// on.
struct Request {
  RegisterTable table = RegisterTable::holding_registers;
  std::uint16_t address = 0, count = 0;
  std::size_t raw_at = 0;
  std::uint32_t every = 1;
  std::uint16_t mask = 0xFFFF;  ///< of a single register that is written: its other bits stay as they are
};

enum class EncodeStatus : std::uint8_t { good, not_a_number, out_of_range };

/// Raw registers of one value. 64-bit integers beyond 2^53 lose their last digits, as every double does.
/// Any thread, no allocation. `raw` has width(v.type) elements; bits are 0 or 1 in an element each.
[[nodiscard]] double decode(const RegisterValue& v, std::span<const std::uint16_t> raw) noexcept;
/// Rounds to the nearest raw integer, halves away from zero. What does not fit is refused and `raw` stays as
/// it was: an actuator never gets a value that was clipped without being told so. A boolean is 0 or 1 alone.
[[nodiscard]] EncodeStatus encode(const RegisterValue& v, double value,
                                  std::span<std::uint16_t> raw) noexcept;

class RegisterMap {
 public:
  enum class Access : std::uint8_t { read, write };

  struct Grouping {
    std::uint16_t max_gap = 0;        ///< registers or bits between two values that are read for nothing
    std::uint16_t max_registers = 0;  ///< in a request; 0: the protocol's limits
  };

  RegisterMap() = default;
  /// Groups adjacent values into as few requests as the limits allow; no value is split over two. What lies
  /// between two values is never written, and read only within `max_gap`.
  RegisterMap(std::vector<RegisterValue> values, Access access, Grouping grouping);
  RegisterMap(std::vector<RegisterValue> values, Access access)
      : RegisterMap(std::move(values), access, Grouping{}) {}

  /// Reads the list `key` of `owner`, 1 to `max_values` entries, and its `max_gap` (read only) and
  /// `max_registers`. Throws ConfigError.
  [[nodiscard]] static RegisterMap parse(const ConfigNode& owner, std::string_view key, Access access,
                                         std::size_t max_values);

  [[nodiscard]] const std::vector<RegisterValue>& values() const noexcept { return values_; }
  [[nodiscard]] const std::vector<Request>& requests() const noexcept { return requests_; }
  [[nodiscard]] std::size_t raw_size() const noexcept { return raw_size_; }
  /// Whether two raw blocks agree in all that a write of this map changes.
  [[nodiscard]] bool same(std::span<const std::uint16_t> a, std::span<const std::uint16_t> b) const noexcept;
  /// -1: no such value.
  [[nodiscard]] int index_of(std::string_view name) const noexcept;

  /// Any thread, no allocation. `raw` has raw_size() elements, `out` at least as many as there are values.
  /// Returns how many are NaN or infinite (which only f32 and f64 can be).
  unsigned decode(std::span<const std::uint16_t> raw, std::span<double> out) const noexcept;
  /// All or nothing: where one value does not fit, its index is in `bad` and `raw` is not to be sent.
  [[nodiscard]] EncodeStatus encode(std::span<const double> in, std::span<std::uint16_t> raw,
                                    std::size_t& bad) const noexcept;

 private:
  std::vector<RegisterValue> values_;
  std::vector<std::size_t> raw_at_;  // of each value
  std::vector<Request> requests_;
  std::size_t raw_size_ = 0;
};

/// One entry of such a list. Throws ConfigError; keys that it does not know are errors.
[[nodiscard]] RegisterValue parse_register(const ConfigNode& n, RegisterMap::Access access);

}  // namespace rigor::modbus

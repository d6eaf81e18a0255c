#include "drivers/modbus/register_map.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

#include "drivers/modbus/pdu.h"

namespace rigor::modbus {
namespace {

constexpr std::uint16_t swapped(std::uint16_t r) noexcept {
  return static_cast<std::uint16_t>((r << 8) | (r >> 8));
}

/// The value's bits, most significant register first whatever the order on the wire.
std::uint64_t gather(const RegisterValue& v, std::span<const std::uint16_t> raw) noexcept {
  const std::size_t n = width(v.type);
  const bool words = v.order == ByteOrder::cdab || v.order == ByteOrder::dcba;
  const bool bytes = v.order == ByteOrder::badc || v.order == ByteOrder::dcba;
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint16_t r = raw[words ? n - 1 - i : i];
    bits = (bits << 16) | (bytes ? swapped(r) : r);
  }
  return bits;
}

void scatter(const RegisterValue& v, std::uint64_t bits, std::span<std::uint16_t> raw) noexcept {
  const std::size_t n = width(v.type);
  const bool words = v.order == ByteOrder::cdab || v.order == ByteOrder::dcba;
  const bool bytes = v.order == ByteOrder::badc || v.order == ByteOrder::dcba;
  for (std::size_t i = 0; i < n; ++i) {
    const auto r = static_cast<std::uint16_t>(bits >> (16 * (n - 1 - i)));
    raw[words ? n - 1 - i : i] = bytes ? swapped(r) : r;
  }
}

/// The bits of a field as they lie in the register on the wire.
std::uint16_t wire_mask(const RegisterValue& v) noexcept {
  const bool bytes = v.order == ByteOrder::badc || v.order == ByteOrder::dcba;
  return bytes ? swapped(v.mask()) : v.mask();
}

/// [low, below): both bounds are exact as doubles, while the largest 64-bit integers are not.
struct IntegerRange {
  double low, below;
};
constexpr IntegerRange range_of(ValueType t) noexcept {
  switch (t) {
    case ValueType::boolean:
      return {0, 2};
    case ValueType::u16:
      return {0, 65536};
    case ValueType::s16:
      return {-32768, 32768};
    case ValueType::u32:
      return {0, 4294967296.0};
    case ValueType::s32:
      return {-2147483648.0, 2147483648.0};
    case ValueType::u64:
      return {0, 18446744073709551616.0};
    default:
      return {-9223372036854775808.0, 9223372036854775808.0};
  }
}

RegisterTable parse_table(const ConfigNode& n, RegisterMap::Access access) {
  const bool write = access == RegisterMap::Access::write;
  const auto name = n.choice("table", {"coils", "discrete_inputs", "input_registers", "holding_registers"});
  const auto table = name == "coils"             ? RegisterTable::coils
                     : name == "discrete_inputs" ? RegisterTable::discrete_inputs
                     : name == "input_registers" ? RegisterTable::input_registers
                                                 : RegisterTable::holding_registers;
  if (write && (table == RegisterTable::discrete_inputs || table == RegisterTable::input_registers))
    throw n.error("table",
                  "expected coils or holding_registers, got " + name + ", which Modbus cannot write");
  return table;
}

ValueType parse_type(const ConfigNode& n, RegisterTable table) {
  static const std::vector<std::string> kNames{"bool", "u16", "s16", "u32", "s32",
                                               "u64",  "s64", "f32", "f64"};
  const auto name = n.choice_or("type", kNames, is_bits(table) ? "bool" : "u16");
  const auto type = static_cast<ValueType>(std::find(kNames.begin(), kNames.end(), name) - kNames.begin());
  if (is_bits(table) && type != ValueType::boolean)
    throw n.error("type",
                  "expected bool, the only type of " + std::string(table_name(table)) + ", got " + name);
  return type;
}

/// `bit` and `bits` of a register of 16.
void parse_field(const ConfigNode& n, RegisterValue& v) {
  const bool one = n.has("bit"), some = n.has("bits");
  if (!one && !some) return;
  const char* key = one ? "bit" : "bits";
  if (one && some) throw n.error("bits", "expected `bit` or `bits`, got both");
  if (is_bits(v.table))
    throw n.error(key, "expected none: " + std::string(table_name(v.table)) + " hold one bit each");
  if (v.type != ValueType::u16 && v.type != ValueType::boolean)
    throw n.error(key, "expected type u16 or bool for a field of a register");
  if (one) {
    v.first_bit = static_cast<std::uint8_t>(n.integer("bit", {.min = 0, .max = 15}));
    v.bit_count = 1;
    return;
  }
  if (v.type == ValueType::boolean) throw n.error(key, "expected `bit` for a bool, which is one bit");
  const auto b = n.numbers("bits", 2);
  const auto whole = [](double x) { return x == std::floor(x); };
  if (!whole(b[0]) || !whole(b[1]) || b[0] < 0 || b[1] < 1 || b[0] + b[1] > 16)
    throw n.error(key, "expected [first bit, how many] within 0 to 15, least significant first");
  v.first_bit = static_cast<std::uint8_t>(b[0]);
  v.bit_count = static_cast<std::uint8_t>(b[1]);
}

}  // namespace

RegisterValue parse_register(const ConfigNode& n, RegisterMap::Access access) {
  RegisterValue v;
  v.name = n.text("name");
  if (v.name.empty()) throw n.error("name", "expected a name, got \"\"");
  v.unit = n.text_or("unit", "");
  v.table = parse_table(n, access);
  v.type = parse_type(n, v.table);
  v.address = static_cast<std::uint16_t>(n.integer("address", {.min = 0, .max = 65536.0 - width(v.type)}));
  const auto order = n.choice_or("byte_order", {"ABCD", "CDAB", "BADC", "DCBA"}, "ABCD");
  v.order = order == "ABCD"   ? ByteOrder::abcd
            : order == "CDAB" ? ByteOrder::cdab
            : order == "BADC" ? ByteOrder::badc
                              : ByteOrder::dcba;
  parse_field(n, v);
  if (access == RegisterMap::Access::read)
    v.every = static_cast<std::uint32_t>(n.integer_or("every", 1, {.min = 1, .max = 1e6}));
  if (v.type == ValueType::boolean) {
    for (const char* key : {"scale", "offset"})
      if (n.has(key)) throw n.error(key, "expected none for a bool, which is 0 or 1; remove it");
  } else {
    v.scale = n.number_or("scale", 1);
    if (v.scale == 0) throw n.error("scale", "expected a number other than 0, got 0");
    v.offset = n.number_or("offset", 0);
  }
  n.finish();
  return v;
}

const char* table_name(RegisterTable t) noexcept {
  switch (t) {
    case RegisterTable::coils:
      return "coils";
    case RegisterTable::discrete_inputs:
      return "discrete_inputs";
    case RegisterTable::input_registers:
      return "input_registers";
    case RegisterTable::holding_registers:
      return "holding_registers";
  }
  return "?";
}

double decode(const RegisterValue& v, std::span<const std::uint16_t> raw) noexcept {
  std::uint64_t bits = gather(v, raw);
  if (v.is_field()) bits = (bits & v.mask()) >> v.first_bit;
  double x = 0;
  switch (v.type) {
    case ValueType::boolean:
      return bits != 0 ? 1 : 0;
    case ValueType::u16:
    case ValueType::u32:
    case ValueType::u64:
      x = static_cast<double>(bits);
      break;
    case ValueType::s16:
      x = static_cast<std::int16_t>(bits);
      break;
    case ValueType::s32:
      x = static_cast<std::int32_t>(bits);
      break;
    case ValueType::s64:
      x = static_cast<double>(static_cast<std::int64_t>(bits));
      break;
    case ValueType::f32:
      x = static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bits)));
      break;
    case ValueType::f64:
      x = std::bit_cast<double>(bits);
      break;
  }
  return x * v.scale + v.offset;
}

EncodeStatus encode(const RegisterValue& v, double value, std::span<std::uint16_t> raw) noexcept {
  if (std::isnan(value)) return EncodeStatus::not_a_number;
  const double x = (value - v.offset) / v.scale;
  if (!std::isfinite(x)) return EncodeStatus::out_of_range;
  if (v.type == ValueType::f32) {
    // Halfway between the largest float and the next power of two rounds up to infinity.
    const auto f =
        std::fabs(x) < 0x1.ffffffp127 ? static_cast<float>(x) : std::numeric_limits<float>::infinity();
    if (!std::isfinite(f)) return EncodeStatus::out_of_range;
    scatter(v, std::bit_cast<std::uint32_t>(f), raw);
    return EncodeStatus::good;
  }
  if (v.type == ValueType::f64) {
    scatter(v, std::bit_cast<std::uint64_t>(x), raw);
    return EncodeStatus::good;
  }
  const double r = std::round(x);
  const auto range = range_of(v.type);
  if (r < range.low || r >= range.below) return EncodeStatus::out_of_range;
  if (v.is_field()) {
    if (r >= static_cast<double>(1u << v.bit_count)) return EncodeStatus::out_of_range;
    const auto field = static_cast<std::uint64_t>(r) << v.first_bit;
    scatter(v, (gather(v, raw) & ~std::uint64_t{v.mask()}) | field, raw);
    return EncodeStatus::good;
  }
  const auto bits =
      r < 0 ? static_cast<std::uint64_t>(static_cast<std::int64_t>(r)) : static_cast<std::uint64_t>(r);
  scatter(v, bits, raw);
  return EncodeStatus::good;
}

RegisterMap::RegisterMap(std::vector<RegisterValue> values, Access access, Grouping grouping)
    : values_(std::move(values)), raw_at_(values_.size()) {
  const bool write = access == Access::write;
  std::vector<std::size_t> order(values_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto key = [&](const RegisterValue& v) { return std::tuple(v.every, v.table, v.address); };
    return key(values_[a]) < key(values_[b]);
  });
  for (const auto i : order) {
    const auto& v = values_[i];
    const bool bits = is_bits(v.table);
    unsigned limit =
        write ? (bits ? kMaxWriteBits : kMaxWriteRegisters) : (bits ? kMaxReadBits : kMaxReadRegisters);
    if (!bits && grouping.max_registers != 0) limit = std::min<unsigned>(limit, grouping.max_registers);
    const unsigned gap = write ? 0u : grouping.max_gap;
    const unsigned first = v.address, end = first + width(v.type);
    auto* last = requests_.empty() ? nullptr : &requests_.back();
    const unsigned last_end = last ? last->address + unsigned{last->count} : 0;
    const bool field = write && v.is_field();
    const bool last_field = last && last->mask != 0xFFFF;
    // A field is written by itself, together with the other fields of its register.
    const bool apart = (field || last_field) && !(field && last_field && last->address == first);
    if (!last || last->every != v.every || last->table != v.table || apart || first > last_end + gap ||
        std::max(end, last_end) - last->address > limit) {
      requests_.push_back(
          {v.table, v.address, 0, raw_size_, v.every, field ? std::uint16_t{0} : std::uint16_t{0xFFFF}});
      last = &requests_.back();
    }
    if (field) last->mask = static_cast<std::uint16_t>(last->mask | wire_mask(v));
    const auto count = std::max<unsigned>(last->count, end - last->address);
    raw_size_ += count - last->count;
    last->count = static_cast<std::uint16_t>(count);
    raw_at_[i] = last->raw_at + (first - last->address);
  }
}

RegisterMap RegisterMap::parse(const ConfigNode& owner, std::string_view key, Access access,
                               std::size_t max_values) {
  const auto items = owner.list(key);
  if (items.empty() || items.size() > max_values)
    throw owner.error(key, "expected 1 to " + std::to_string(max_values) + " registers, got " +
                               std::to_string(items.size()));
  std::vector<RegisterValue> values;
  for (const auto& item : items) {
    auto v = parse_register(item, access);
    for (const auto& other : values) {
      if (other.name == v.name) throw item.error("name", "expected each name once, got " + v.name + " again");
      const unsigned begin = v.address, end = begin + width(v.type);
      const unsigned other_begin = other.address, other_end = other_begin + width(other.type);
      const bool beside = v.is_field() && other.is_field() && (v.mask() & other.mask()) == 0;
      if (access == Access::write && other.table == v.table && begin < other_end && other_begin < end &&
          !beside)
        throw item.error("address",
                         "expected registers of its own, got some that " + other.name + " has too");
    }
    values.push_back(std::move(v));
  }
  Grouping grouping;
  if (access == Access::read)
    grouping.max_gap = static_cast<std::uint16_t>(owner.integer_or("max_gap", 0, {.min = 0, .max = 2000}));
  grouping.max_registers = static_cast<std::uint16_t>(
      owner.integer_or("max_registers", 0, {.min = 0, .max = double{kMaxReadRegisters}}));
  if (grouping.max_registers != 0)
    for (std::size_t i = 0; i < values.size(); ++i)
      if (!is_bits(values[i].table) && width(values[i].type) > grouping.max_registers)
        throw items[i].error("type", "expected at most the " + std::to_string(grouping.max_registers) +
                                         " registers that `max_registers` allows in a request");
  return RegisterMap(std::move(values), access, grouping);
}

bool RegisterMap::same(std::span<const std::uint16_t> a, std::span<const std::uint16_t> b) const noexcept {
  for (const auto& r : requests_)
    for (std::size_t i = r.raw_at; i < r.raw_at + r.count; ++i)
      if (((a[i] ^ b[i]) & r.mask) != 0) return false;
  return true;
}

int RegisterMap::index_of(std::string_view name) const noexcept {
  for (std::size_t i = 0; i < values_.size(); ++i)
    if (values_[i].name == name) return static_cast<int>(i);
  return -1;
}

unsigned RegisterMap::decode(std::span<const std::uint16_t> raw, std::span<double> out) const noexcept {
  unsigned strange = 0;
  for (std::size_t i = 0; i < values_.size(); ++i) {
    out[i] = modbus::decode(values_[i], raw.subspan(raw_at_[i], width(values_[i].type)));
    strange += !std::isfinite(out[i]);
  }
  return strange;
}

EncodeStatus RegisterMap::encode(std::span<const double> in, std::span<std::uint16_t> raw,
                                 std::size_t& bad) const noexcept {
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const auto status = modbus::encode(values_[i], in[i], raw.subspan(raw_at_[i], width(values_[i].type)));
    if (status == EncodeStatus::good) continue;
    bad = i;
    return status;
  }
  return EncodeStatus::good;
}

}  // namespace rigor::modbus

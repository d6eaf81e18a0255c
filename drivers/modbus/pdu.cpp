#include "drivers/modbus/pdu.h"

#include <algorithm>
#include <optional>

#include "rt-core/byte_order.h"

namespace rigor::modbus {
namespace {

// Function codes.
constexpr std::uint8_t kReadCoils = 1, kReadDiscreteInputs = 2, kReadHolding = 3, kReadInput = 4;
constexpr std::uint8_t kWriteCoil = 5, kWriteRegister = 6, kWriteCoils = 15, kWriteRegisters = 16;
constexpr std::uint8_t kMaskWrite = 22, kReadWrite = 23;
constexpr std::uint16_t kMaxReadWriteRead = 125, kMaxReadWriteWrite = 121;

/// What a request asks of the model, checked against the length that really came.
struct Order {
  std::optional<RegisterTable> write_table, read_table;
  std::uint16_t write_address = 0, write_count = 0, read_address = 0, read_count = 0;
  std::array<std::uint16_t, kMaxWriteBits> values{};
  bool mask = false;
  std::uint16_t and_mask = 0, or_mask = 0;
  Exception refusal = Exception::none;
};

bool count_fits(std::uint16_t address, std::uint16_t count, unsigned max, Exception& refusal) {
  if (count < 1 || count > max) return refusal = Exception::illegal_value, false;
  if (unsigned{address} + count > 65536) return refusal = Exception::illegal_address, false;
  return true;
}

bool parse_read(std::span<const std::uint8_t> pdu, RegisterTable table, unsigned max, Order& o) {
  if (pdu.size() != 5) return false;
  o.read_table = table;
  o.read_address = load_be<std::uint16_t>(pdu, 1);
  o.read_count = load_be<std::uint16_t>(pdu, 3);
  (void)count_fits(o.read_address, o.read_count, max, o.refusal);
  return true;
}

bool parse_write_one(std::span<const std::uint8_t> pdu, Order& o) {
  if (pdu.size() != 5) return false;
  const bool coil = pdu[0] == kWriteCoil;
  o.write_table = coil ? RegisterTable::coils : RegisterTable::holding_registers;
  o.write_address = load_be<std::uint16_t>(pdu, 1);
  o.write_count = 1;
  o.values[0] = load_be<std::uint16_t>(pdu, 3);
  if (coil && o.values[0] != 0 && o.values[0] != 0xFF00) o.refusal = Exception::illegal_value;
  if (coil) o.values[0] = o.values[0] != 0;
  return true;
}

bool parse_write_many(std::span<const std::uint8_t> pdu, Order& o) {
  if (pdu.size() < 6) return false;
  const bool coils = pdu[0] == kWriteCoils;
  o.write_table = coils ? RegisterTable::coils : RegisterTable::holding_registers;
  o.write_address = load_be<std::uint16_t>(pdu, 1);
  o.write_count = load_be<std::uint16_t>(pdu, 3);
  if (!count_fits(o.write_address, o.write_count, coils ? kMaxWriteBits : kMaxWriteRegisters, o.refusal))
    return true;
  const std::size_t bytes = coils ? (o.write_count + 7u) / 8u : o.write_count * std::size_t{2};
  if (pdu[5] != bytes || pdu.size() != 6 + bytes) return false;
  for (std::size_t i = 0; i < o.write_count; ++i)
    o.values[i] = coils ? static_cast<std::uint16_t>((pdu[6 + i / 8] >> (i % 8)) & 1)
                        : load_be<std::uint16_t>(pdu, 6 + 2 * i);
  return true;
}

bool parse_mask_write(std::span<const std::uint8_t> pdu, Order& o) {
  if (pdu.size() != 7) return false;
  o.mask = true;
  o.write_table = RegisterTable::holding_registers;
  o.write_address = load_be<std::uint16_t>(pdu, 1);
  o.write_count = 1;
  o.and_mask = load_be<std::uint16_t>(pdu, 3);
  o.or_mask = load_be<std::uint16_t>(pdu, 5);
  return true;
}

bool parse_read_write(std::span<const std::uint8_t> pdu, Order& o) {
  if (pdu.size() < 10) return false;
  o.read_table = o.write_table = RegisterTable::holding_registers;
  o.read_address = load_be<std::uint16_t>(pdu, 1);
  o.read_count = load_be<std::uint16_t>(pdu, 3);
  o.write_address = load_be<std::uint16_t>(pdu, 5);
  o.write_count = load_be<std::uint16_t>(pdu, 7);
  if (!count_fits(o.read_address, o.read_count, kMaxReadWriteRead, o.refusal) ||
      !count_fits(o.write_address, o.write_count, kMaxReadWriteWrite, o.refusal))
    return true;
  const std::size_t bytes = o.write_count * std::size_t{2};
  if (pdu[9] != bytes || pdu.size() != 10 + bytes) return false;
  for (std::size_t i = 0; i < o.write_count; ++i) o.values[i] = load_be<std::uint16_t>(pdu, 10 + 2 * i);
  return true;
}

/// False where the length is not that of the function.
bool parse_order(std::span<const std::uint8_t> pdu, Order& o) {
  switch (pdu[0]) {
    case kReadCoils:
      return parse_read(pdu, RegisterTable::coils, kMaxReadBits, o);
    case kReadDiscreteInputs:
      return parse_read(pdu, RegisterTable::discrete_inputs, kMaxReadBits, o);
    case kReadHolding:
      return parse_read(pdu, RegisterTable::holding_registers, kMaxReadRegisters, o);
    case kReadInput:
      return parse_read(pdu, RegisterTable::input_registers, kMaxReadRegisters, o);
    case kWriteCoil:
    case kWriteRegister:
      return parse_write_one(pdu, o);
    case kWriteCoils:
    case kWriteRegisters:
      return parse_write_many(pdu, o);
    case kMaskWrite:
      return parse_mask_write(pdu, o);
    case kReadWrite:
      return parse_read_write(pdu, o);
    default:
      o.refusal = Exception::illegal_function;
      return true;
  }
}

using Values = std::array<std::uint16_t, kMaxReadBits>;

/// Writes, then reads, as section 6.17 has it.
Exception carry_out(RegisterModel& model, Order& o, BenchTime t, Values& out) {
  if (o.write_table) {
    if (o.mask) {
      std::uint16_t old = 0;
      if (!model.read(*o.write_table, o.write_address, {&old, 1}, t)) return Exception::illegal_address;
      o.values[0] = static_cast<std::uint16_t>((old & o.and_mask) | (o.or_mask & ~o.and_mask));
    }
    if (!model.write(*o.write_table, o.write_address, {o.values.data(), o.write_count}, t))
      return Exception::illegal_address;
  }
  if (o.read_table && !model.read(*o.read_table, o.read_address, {out.data(), o.read_count}, t))
    return Exception::illegal_address;
  return Exception::none;
}

void word_answer(std::span<const std::uint8_t> request, const Order& o, const Values& out, Pdu& answer) {
  auto* p = answer.bytes.data();
  p[0] = request[0];
  if (!o.read_table) {
    // Writes answer with what they asked; those of many values without the values.
    answer.size = o.mask ? 7 : 5;
    std::copy_n(request.begin() + 1, answer.size - 1, p + 1);
    return;
  }
  const bool bits = *o.read_table == RegisterTable::coils || *o.read_table == RegisterTable::discrete_inputs;
  const std::size_t bytes = bits ? (o.read_count + 7u) / 8u : o.read_count * std::size_t{2};
  p[1] = static_cast<std::uint8_t>(bytes);
  answer.size = 2 + bytes;
  if (bits) {
    std::fill_n(p + 2, bytes, std::uint8_t{0});
    for (std::size_t i = 0; i < o.read_count; ++i)
      if (out[i] != 0) p[2 + i / 8] = static_cast<std::uint8_t>(p[2 + i / 8] | 1u << (i % 8));
  } else {
    for (std::size_t i = 0; i < o.read_count; ++i) store_be(answer.bytes, 2 + 2 * i, out[i]);
  }
}

}  // namespace

const char* exception_text(unsigned code) noexcept {
  switch (static_cast<Exception>(code)) {
    case Exception::illegal_function:
      return "illegal function";
    case Exception::illegal_address:
      return "illegal data address";
    case Exception::illegal_value:
      return "illegal data value";
    case Exception::device_failure:
      return "server device failure";
    case Exception::acknowledge:
      return "acknowledge";
    case Exception::busy:
      return "server device busy";
    case Exception::memory_parity:
      return "memory parity error";
    case Exception::gateway_path:
      return "gateway path unavailable";
    case Exception::gateway_target:
      return "gateway target device failed to respond";
    case Exception::none:
      break;
  }
  return "exception";
}

void refuse(std::span<const std::uint8_t> request, Exception why, Pdu& answer) noexcept {
  answer.exception = why;
  answer.bytes[0] = static_cast<std::uint8_t>(request[0] | 0x80);
  answer.bytes[1] = static_cast<std::uint8_t>(why);
  answer.size = 2;
}

bool serve_request(RegisterModel& model, std::span<const std::uint8_t> request, BenchTime t, Pdu& answer) {
  answer.exception = Exception::none;
  Order o;
  if (request.empty() || request.size() > kMaxPdu || !parse_order(request, o)) return false;
  Values out{};
  const Exception why = o.refusal != Exception::none ? o.refusal : carry_out(model, o, t, out);
  if (why != Exception::none)
    refuse(request, why, answer);
  else
    word_answer(request, o, out, answer);
  return true;
}

std::size_t request_size(std::span<const std::uint8_t> begin) noexcept {
  if (begin.empty()) return 0;
  switch (begin[0]) {
    case kReadCoils:
    case kReadDiscreteInputs:
    case kReadHolding:
    case kReadInput:
    case kWriteCoil:
    case kWriteRegister:
      return 5;
    case kWriteCoils:
    case kWriteRegisters:
      return begin.size() < 6 ? 0 : 6 + std::size_t{begin[5]};
    case kMaskWrite:
      return 7;
    case kReadWrite:
      return begin.size() < 10 ? 0 : 10 + std::size_t{begin[9]};
    default:
      return 0;
  }
}

}  // namespace rigor::modbus

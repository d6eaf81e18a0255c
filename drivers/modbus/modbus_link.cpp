#include "drivers/modbus/modbus_link.h"

#include <modbus/modbus.h>

#include <array>
#include <cerrno>

namespace rigor::modbus {
namespace {

void set_timeouts(modbus_t* m, Duration timeout) {
  const auto us = static_cast<std::uint32_t>(timeout.ns() / 1000);
  modbus_set_response_timeout(m, us / 1'000'000, us % 1'000'000);
  // Between two bytes of an answer; the whole answer is a single segment as a rule.
  modbus_set_byte_timeout(m, us / 1'000'000, us % 1'000'000);
}

}  // namespace

Endpoint Endpoint::parse(const ConfigNode& n) {
  Endpoint e;
  e.address = n.text("address");
  if (e.address.empty()) throw n.error("address", "expected a host name or address, got \"\"");
  e.port = static_cast<std::uint16_t>(n.integer_or("port", 502, {.min = 1, .max = 65535}));
  e.unit = static_cast<std::uint8_t>(n.integer_or("unit", 255, {.min = 0, .max = 255}));
  e.timeout = seconds_from(n.number_or("timeout_ms", 500, {.min = 1, .max = 60000}) * 1e-3);
  return e;
}

std::string Endpoint::text() const {
  const bool six = address.find(':') != std::string::npos;
  return (six ? "[" + address + "]" : address) + ":" + std::to_string(port);
}

void Link::Free::operator()(_modbus* context) const noexcept {
  modbus_close(context);
  modbus_free(context);
}

Status Link::open(const Endpoint& endpoint) {
  close();
  std::unique_ptr<_modbus, Free> m(
      modbus_new_tcp_pi(endpoint.address.c_str(), std::to_string(endpoint.port).c_str()));
  if (!m)
    return fail(ErrorCode::bad_input, endpoint.text(),
                "expected a host name or address that libmodbus takes");
  set_timeouts(m.get(), endpoint.timeout);
  if (modbus_set_slave(m.get(), endpoint.unit) != 0)
    return fail(ErrorCode::bad_input, endpoint.text(),
                "expected a unit from 0 to 247 or 255, got " + std::to_string(endpoint.unit));
  errno = 0;
  if (modbus_connect(m.get()) != 0) {
    const std::string why = errno != 0 ? modbus_strerror(errno) : "no such host";
    return fail(
        ErrorCode::not_found, endpoint.text(),
        "expected a Modbus TCP device, got: " + why +
            "; check that it is on and that `address` and `port` are its own, or start an emulated one with "
            "`rigor emulate`");
  }
  context_ = std::move(m);
  return {};
}

void Link::adopt(int socket, Duration timeout) {
  close();
  // The address is never used: the context is given its socket.
  context_.reset(modbus_new_tcp("127.0.0.1", 502));
  set_timeouts(context_.get(), timeout);
  modbus_set_socket(context_.get(), socket);
}

void Link::close() noexcept { context_.reset(); }

LinkStatus Link::finish(const Request& request, bool good) noexcept {
  if (good) return LinkStatus::good;
  last_errno_ = errno;
  last_ = request;
  if (last_errno_ >= EMBXILFUN && last_errno_ <= EMBXGTAR) return LinkStatus::exception;
  close();
  if (last_errno_ == ETIMEDOUT) return LinkStatus::timeout;
  if (last_errno_ >= MODBUS_ENOBASE) return LinkStatus::protocol;
  return LinkStatus::disconnected;
}

LinkStatus Link::read(const Request& r, std::span<std::uint16_t> out) noexcept {
  if (!context_) return LinkStatus::disconnected;
  auto* m = context_.get();
  errno = 0;
  if (!is_bits(r.table)) {
    const int n = r.table == RegisterTable::input_registers
                      ? modbus_read_input_registers(m, r.address, r.count, out.data())
                      : modbus_read_registers(m, r.address, r.count, out.data());
    return finish(r, n == r.count);
  }
  std::array<std::uint8_t, MODBUS_MAX_READ_BITS> bits;
  const int n = r.table == RegisterTable::coils ? modbus_read_bits(m, r.address, r.count, bits.data())
                                                : modbus_read_input_bits(m, r.address, r.count, bits.data());
  if (n == r.count)
    for (std::size_t i = 0; i < r.count; ++i) out[i] = bits[i] != 0;
  return finish(r, n == r.count);
}

LinkStatus Link::write(const Request& r, std::span<const std::uint16_t> in) noexcept {
  if (!context_) return LinkStatus::disconnected;
  auto* m = context_.get();
  errno = 0;
  // The single-register functions are the ones that every device has.
  if (!is_bits(r.table))
    return finish(r, r.count == 1 ? modbus_write_register(m, r.address, in[0]) == 1
                                  : modbus_write_registers(m, r.address, r.count, in.data()) == r.count);
  std::array<std::uint8_t, MODBUS_MAX_WRITE_BITS> bits;
  for (std::size_t i = 0; i < r.count; ++i) bits[i] = in[i] != 0;
  return finish(r, r.count == 1 ? modbus_write_bit(m, r.address, bits[0]) == 1
                                : modbus_write_bits(m, r.address, r.count, bits.data()) == r.count);
}

LinkStatus Link::read(const RegisterMap& map, std::span<std::uint16_t> raw) noexcept {
  for (const auto& r : map.requests())
    if (const auto s = read(r, raw.subspan(r.raw_at, r.count)); s != LinkStatus::good) return s;
  return LinkStatus::good;
}

LinkStatus Link::write(const RegisterMap& map, std::span<const std::uint16_t> raw) noexcept {
  for (const auto& r : map.requests())
    if (const auto s = write(r, raw.subspan(r.raw_at, r.count)); s != LinkStatus::good) return s;
  return LinkStatus::good;
}

std::string Link::failure() const {
  return std::string(table_name(last_.table)) + " " + std::to_string(last_.address) + " to " +
         std::to_string(last_.address + last_.count - 1) + ": " +
         (last_errno_ != 0 ? modbus_strerror(last_errno_) : "the connection is closed");
}

}  // namespace rigor::modbus

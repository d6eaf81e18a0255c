#include "drivers/modbus/modbus_link.h"

#include <modbus/modbus.h>

#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <map>

#include "drivers/network/tcp_socket.h"

namespace rigor::modbus {
namespace {

void set_timeouts(modbus_t* m, Duration timeout) {
  const auto us = static_cast<std::uint32_t>(timeout.ns() / 1000);
  modbus_set_response_timeout(m, us / 1'000'000, us % 1'000'000);
  // Between two bytes of an answer; the whole answer is a single segment as a rule.
  modbus_set_byte_timeout(m, us / 1'000'000, us % 1'000'000);
}

/// The address is never used: the context is given its socket.
modbus_t* socket_context() { return modbus_new_tcp("127.0.0.1", 502); }

}  // namespace

Endpoint Endpoint::parse(const ConfigNode& n, unsigned default_retries) {
  Endpoint e;
  if (n.choice_or("transport", {"tcp", "rtu"}, "tcp") == "rtu") {
    e.serial = parse_line_settings(n);
    e.serial->device = n.text("device");
    if (e.serial->device.empty()) throw n.error("device", "expected a serial port, got \"\"");
    e.unit = static_cast<std::uint8_t>(n.integer_or("unit", 1, {.min = 1, .max = 247}));
  } else {
    e.address = n.text("address");
    if (e.address.empty()) throw n.error("address", "expected a host name or address, got \"\"");
    e.port = static_cast<std::uint16_t>(n.integer_or("port", 502, {.min = 1, .max = 65535}));
    e.unit = static_cast<std::uint8_t>(n.integer_or("unit", 255, {.min = 0, .max = 255}));
  }
  e.timeout = seconds_from(n.number_or("timeout_ms", 500, {.min = 1, .max = 60000}) * 1e-3);
  e.retries = static_cast<unsigned>(n.integer_or("retries", default_retries, {.min = 0, .max = 10}));
  return e;
}

std::string Endpoint::text() const {
  if (serial) return serial->text() + " unit " + std::to_string(unit);
  return network::endpoint_text(address, port);
}

std::string LinkCounters::trouble() const {
  std::string out;
  const auto add = [&](std::uint64_t n, const std::string& one, const std::string& many) {
    if (n != 0) out += (out.empty() ? "" : ", ") + std::to_string(n) + " " + (n == 1 ? one : many);
  };
  for (std::size_t code = 0; code < exceptions.size(); ++code) {
    const std::string tail =
        " " + std::to_string(code) + " (" + exception_text(static_cast<unsigned>(code)) + ")";
    add(exceptions[code].load(std::memory_order_relaxed), "exception" + tail, "exceptions" + tail);
  }
  add(timeouts.load(std::memory_order_relaxed), "timeout", "timeouts");
  add(broken.load(std::memory_order_relaxed), "broken answer", "broken answers");
  return out;
}

void Link::Free::operator()(_modbus* context) const noexcept {
  modbus_close(context);
  modbus_free(context);
}

std::shared_ptr<SharedLine> SharedLine::of(const std::string& device) {
  static std::mutex mutex;
  static std::map<std::string, std::weak_ptr<SharedLine>> lines;
  std::error_code none;
  const auto real = std::filesystem::canonical(device, none);
  const std::lock_guard lock(mutex);
  auto& known = lines[none ? device : real.string()];
  auto line = known.lock();
  if (!line) known = line = std::make_shared<SharedLine>();
  return line;
}

Status Link::open(const Endpoint& endpoint) {
  close();
  endpoint_ = endpoint;
  line_.reset();
  std::unique_ptr<_modbus, Free> m;
  FileDescriptor connection;
  if (endpoint.serial) {
    const auto& s = *endpoint.serial;
    gap_ = times_of(s).gap;
    const char parity = serial::is_pseudo_terminal(s.device) ? 'N' : s.parity;
    m.reset(modbus_new_rtu(s.device.c_str(), static_cast<int>(s.baud), parity, static_cast<int>(s.data_bits),
                           static_cast<int>(s.stop_bits)));
  } else {
    auto made = network::connect_tcp(endpoint.address, endpoint.port, monotonic_now() + endpoint.timeout, -1,
                                     "a Modbus TCP device");
    if (!made)
      return fail(made.error().code, made.error().where,
                  made.error().message +
                      "; check that it is on and that `address` and `port` are its own, or start an emulated "
                      "one with `rigor emulate`");
    connection = std::move(*made);
    m.reset(socket_context());
  }
  if (!m)
    return fail(ErrorCode::bad_input, endpoint.text(), "expected a device that libmodbus takes, got none");
  set_timeouts(m.get(), endpoint.timeout);
  if (modbus_set_slave(m.get(), endpoint.unit) != 0)
    return fail(ErrorCode::bad_input, endpoint.text(),
                "expected a unit from 0 to 247 or 255, got " + std::to_string(endpoint.unit));
  // Opening a port throws away what is in its buffers: not while another conversation on the line waits for
  // its answer.
  std::shared_ptr<SharedLine> line;
  std::unique_lock<std::mutex> turn;
  if (endpoint.serial) {
    line = SharedLine::of(endpoint.serial->device);
    turn = std::unique_lock(line->turn);
    // libmodbus opens any file as a port and does not report why one cannot be used.
    if (auto port = serial::open_serial(*endpoint.serial); !port) return tl::unexpected<Error>(port.error());
  }
  if (endpoint.serial && modbus_connect(m.get()) != 0) {
    const int e = errno;
    return fail(ErrorCode::unavailable, endpoint.text(),
                std::string("cannot open the serial port: ") + modbus_strerror(e) + serial::serial_cure(e));
  }
  if (connection) modbus_set_socket(m.get(), connection.release());
  if (endpoint.serial) {
    if (auto set = serial::set_rs485(modbus_get_socket(m.get()), *endpoint.serial); !set)
      return tl::unexpected<Error>(set.error());
    line_ = std::move(line);
  }
  context_ = std::move(m);
  return {};
}

void Link::adopt(int socket, Duration timeout, bool rtu, int unit) {
  close();
  endpoint_.reset();
  line_.reset();  // nothing to wait for: a line in memory has no silences
  context_.reset(rtu ? modbus_new_rtu("/dev/null", 19200, 'E', 8, 1) : socket_context());
  set_timeouts(context_.get(), timeout);
  modbus_set_slave(context_.get(), unit);
  modbus_set_socket(context_.get(), socket);
}

void Link::close() noexcept { context_.reset(); }

/// On a line: the silence that parts frames, and nothing left of an answer that came too late.
std::unique_lock<std::mutex> Link::before_request() noexcept {
  counters_.requests.fetch_add(1, std::memory_order_relaxed);
  if (!line_) return {};
  std::unique_lock turn(line_->turn);
  const auto due = line_->last_activity + gap_;
  if (monotonic_now() < due) {
    const timespec t{due.ns() / 1'000'000'000, due.ns() % 1'000'000'000};
    while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) == EINTR) {
    }
  }
  ::tcflush(modbus_get_socket(context_.get()), TCIFLUSH);
  return turn;
}

LinkStatus Link::finish(const Request& request, bool good) noexcept {
  const int error = errno;
  if (line_) line_->last_activity = monotonic_now();
  if (good) return LinkStatus::good;
  last_errno_ = error;
  last_ = request;
  if (last_errno_ >= EMBXILFUN && last_errno_ <= EMBXGTAR) {
    counters_.exceptions[exception_code() % kExceptionCodes].fetch_add(1, std::memory_order_relaxed);
    return LinkStatus::exception;
  }
  // A port stays open: it has no connection that could be lost, and what comes late is flushed.
  const bool timeout = last_errno_ == ETIMEDOUT;
  const bool broken = last_errno_ >= MODBUS_ENOBASE;
  if (!(line_ && (timeout || broken))) close();
  if (timeout) return counters_.timeouts.fetch_add(1, std::memory_order_relaxed), LinkStatus::timeout;
  if (broken) return counters_.broken.fetch_add(1, std::memory_order_relaxed), LinkStatus::protocol;
  return LinkStatus::disconnected;
}

unsigned Link::exception_code() const noexcept {
  return last_errno_ >= EMBXILFUN && last_errno_ <= EMBXGTAR
             ? static_cast<unsigned>(last_errno_ - MODBUS_ENOBASE)
             : 0u;
}

template <class F>
LinkStatus Link::attempts(const Request& r, F&& once) noexcept {
  for (unsigned attempt = 0;; ++attempt) {
    const auto s = context_ ? once() : LinkStatus::disconnected;
    if (s == LinkStatus::good || !endpoint_ || attempt >= endpoint_->retries) return s;
    // An exception is an answer; only "busy" means: ask again.
    if (s == LinkStatus::exception && exception_code() != static_cast<unsigned>(Exception::busy)) return s;
    if (!context_) {
      const int why = last_errno_;
      if (!open(Endpoint(*endpoint_))) return last_errno_ = why, last_ = r, s;
      counters_.reconnects.fetch_add(1, std::memory_order_relaxed);
    }
    counters_.retries.fetch_add(1, std::memory_order_relaxed);
  }
}

LinkStatus Link::read(const Request& r, std::span<std::uint16_t> out) noexcept {
  if (!context_) return LinkStatus::disconnected;
  return attempts(r, [&] { return read_once(r, out); });
}

LinkStatus Link::write(const Request& r, std::span<const std::uint16_t> in) noexcept {
  if (!context_) return LinkStatus::disconnected;
  return attempts(r, [&] { return write_once(r, in); });
}

LinkStatus Link::read_once(const Request& r, std::span<std::uint16_t> out) noexcept {
  auto* m = context_.get();
  const auto turn = before_request();
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

LinkStatus Link::write_once(const Request& r, std::span<const std::uint16_t> in) noexcept {
  auto* m = context_.get();
  const auto turn = before_request();
  errno = 0;
  if (r.mask != 0xFFFF)
    return finish(r, modbus_mask_write_register(m, r.address, static_cast<std::uint16_t>(~r.mask),
                                                static_cast<std::uint16_t>(in[0] & r.mask)) == 1);
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

LinkStatus Poller::poll(Link& link, std::uint64_t index, std::span<std::uint16_t> raw) noexcept {
  const auto& requests = map_->requests();
  // Instants that were skipped may have been those at which something was due.
  for (std::size_t i = 0; i < requests.size(); ++i)
    if (index / requests[i].every != last_index_ / requests[i].every) due_[i] = true;
  last_index_ = index;
  for (std::size_t i = 0; i < requests.size(); ++i) {
    if (!due_[i]) continue;
    const auto& r = requests[i];
    if (const auto s = link.read(r, raw.subspan(r.raw_at, r.count)); s != LinkStatus::good) return s;
    due_[i] = false;
  }
  return LinkStatus::good;
}

}  // namespace rigor::modbus

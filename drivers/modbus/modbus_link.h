// One connection to a Modbus device, as a master, over TCP or a serial line: libmodbus behind a small wall,
// with its ways to fail sorted.
//
// One thread at a time. Nothing here runs on the loop: requests block for up to the endpoint's timeout.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/modbus/pdu.h"
#include "drivers/modbus/register_map.h"
#include "drivers/modbus/rtu_codec.h"
#include "drivers/serial/serial_line.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

struct _modbus;

namespace rigor::modbus {

using serial::SerialSettings;

/// Reads a line's settings; the defaults are those of the specification: 19200, even, 8, and as many stop
/// bits as make 11 bits a character. Throws ConfigError.
[[nodiscard]] inline SerialSettings parse_line_settings(const ConfigNode& n) {
  return SerialSettings::parse(n, {19200, 'E', true, 8});
}
[[nodiscard]] inline LineTimes times_of(const SerialSettings& s) noexcept {
  return LineTimes::of(s.baud, s.bits_per_character());
}

/// Where a device is, and how patient one is with it.
struct Endpoint {
  std::string address = "127.0.0.1";  ///< name, IPv4 or IPv6 address
  std::uint16_t port = 502;
  std::optional<SerialSettings> serial;  ///< `transport: rtu`: in place of address and port
  std::uint8_t unit = 255;  ///< TCP: 255 is the device itself and no gateway behind it; RTU: 1 to 247
  Duration timeout = milliseconds(500);
  unsigned retries = 0;  ///< of one request that timed out, came back broken, or found the device busy

  /// Reads `transport` (tcp, rtu), `unit`, `timeout_ms`, `retries`; of TCP `address`, `port`; of RTU `device`
  /// and the line's settings. Throws ConfigError.
  [[nodiscard]] static Endpoint parse(const ConfigNode& n, unsigned default_retries);
  [[nodiscard]] std::string text() const;
};

enum class LinkStatus : std::uint8_t {
  good,
  exception,  ///< the device refused; the connection is as good as before
  timeout,  ///< no answer; a TCP connection is closed, since a late answer would be taken for the next one's
  disconnected,  ///< the peer is gone; closed
  protocol       ///< an answer that makes no sense; a TCP connection is closed
};

/// What devices answered with, since the beginning. Written by the link's thread, read by any.
struct LinkCounters {
  std::array<std::atomic<std::uint64_t>, kExceptionCodes> exceptions{};  ///< by code; unknown ones at 0
  std::atomic<std::uint64_t> requests{0}, timeouts{0}, broken{0}, retries{0}, reconnects{0};
  /// "3 exceptions 2 (illegal data address), 1 timeout"; empty where there is nothing to tell.
  [[nodiscard]] std::string trouble() const;
};

/// A serial line, which carries one request at a time: links of one process to one port take turns.
struct SharedLine {
  std::mutex turn;
  MonotonicTime last_activity;
  /// The one of this port, whatever links lead to it. Any thread.
  [[nodiscard]] static std::shared_ptr<SharedLine> of(const std::string& device);
};

class Link {
 public:
  Link() = default;

  /// not_found when nobody answers there (of a serial line: when there is no such port), with what to do.
  /// Keeps the endpoint for retries.
  [[nodiscard]] Status open(const Endpoint& endpoint);
  /// Takes over a connected stream socket (virtual time); `rtu`: with the framing of a serial line.
  void adopt(int socket, Duration timeout, bool rtu = false, int unit = 255);
  void close() noexcept;
  [[nodiscard]] bool is_open() const noexcept { return context_ != nullptr; }

  /// Once; what may be tried again is, as often as the endpoint says.
  [[nodiscard]] LinkStatus read(const Request& request, std::span<std::uint16_t> out) noexcept;
  [[nodiscard]] LinkStatus write(const Request& request, std::span<const std::uint16_t> in) noexcept;
  /// All requests of a map; stops at the first that fails.
  [[nodiscard]] LinkStatus read(const RegisterMap& map, std::span<std::uint16_t> raw) noexcept;
  [[nodiscard]] LinkStatus write(const RegisterMap& map, std::span<const std::uint16_t> raw) noexcept;

  /// What the last request that failed died of, for people; and which registers it was about.
  [[nodiscard]] std::string failure() const;
  /// The exception code of the last request that failed, 0 where it was none.
  [[nodiscard]] unsigned exception_code() const noexcept;
  [[nodiscard]] const LinkCounters& counters() const noexcept { return counters_; }

 private:
  struct Free {
    void operator()(_modbus* context) const noexcept;
  };
  template <class F>
  LinkStatus attempts(const Request& request, F&& once) noexcept;
  LinkStatus read_once(const Request& request, std::span<std::uint16_t> out) noexcept;
  LinkStatus write_once(const Request& request, std::span<const std::uint16_t> in) noexcept;
  LinkStatus finish(const Request& request, bool good) noexcept;
  [[nodiscard]] std::unique_lock<std::mutex> before_request() noexcept;

  std::unique_ptr<_modbus, Free> context_;
  std::optional<Endpoint> endpoint_;  ///< of an open or lost connection; none of an adopted one
  std::shared_ptr<SharedLine> line_;  ///< of a serial line
  Duration gap_;
  int last_errno_ = 0;
  Request last_;
  LinkCounters counters_;
};

/// Asks for the registers of a map at the instants at which they are due, and keeps the others as they were.
class Poller {
 public:
  explicit Poller(const RegisterMap& map) : map_(&map), due_(map.requests().size(), true) {}
  Poller() = default;

  /// The `index`-th instant. On a failure what was due stays so.
  [[nodiscard]] LinkStatus poll(Link& link, std::uint64_t index, std::span<std::uint16_t> raw) noexcept;
  /// What came so far no longer counts (a new run begins, or the device was away): the next instant asks for
  /// everything.
  void forget() noexcept { due_.assign(due_.size(), true); }

 private:
  const RegisterMap* map_ = nullptr;
  std::vector<char> due_;
  std::uint64_t last_index_ = 0;
};

}  // namespace rigor::modbus

// One connection to a Modbus TCP device, as a master: libmodbus behind a small wall, with its ways to fail
// sorted.
//
// One thread at a time. Nothing here runs on the loop: requests block for up to the endpoint's timeout.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "drivers/modbus/register_map.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

struct _modbus;

namespace rigor::modbus {

/// Where a device is.
struct Endpoint {
  std::string address = "127.0.0.1";  ///< name, IPv4 or IPv6 address
  std::uint16_t port = 502;
  std::uint8_t unit = 255;  ///< unit identifier; 255: the device itself and no gateway behind it
  Duration timeout = milliseconds(500);

  /// Reads `address`, `port`, `unit`, `timeout_ms`. Throws ConfigError.
  [[nodiscard]] static Endpoint parse(const ConfigNode& n);
  [[nodiscard]] std::string text() const;
};

enum class LinkStatus : std::uint8_t {
  good,
  exception,  ///< the device refused; the connection is as good as before
  timeout,    ///< no answer; the connection is closed, since a late answer would be taken for the next one's
  disconnected,  ///< the peer is gone; closed
  protocol       ///< an answer that makes no sense; closed
};

class Link {
 public:
  Link() = default;

  /// not_found when nobody answers there, with what to do.
  [[nodiscard]] Status open(const Endpoint& endpoint);
  /// Takes over a connected stream socket (virtual time).
  void adopt(int socket, Duration timeout);
  void close() noexcept;
  [[nodiscard]] bool is_open() const noexcept { return context_ != nullptr; }

  [[nodiscard]] LinkStatus read(const Request& request, std::span<std::uint16_t> out) noexcept;
  [[nodiscard]] LinkStatus write(const Request& request, std::span<const std::uint16_t> in) noexcept;
  /// All requests of a map; stops at the first that fails.
  [[nodiscard]] LinkStatus read(const RegisterMap& map, std::span<std::uint16_t> raw) noexcept;
  [[nodiscard]] LinkStatus write(const RegisterMap& map, std::span<const std::uint16_t> raw) noexcept;
  /// What the last request that failed died of, for people; and which registers it was about.
  [[nodiscard]] std::string failure() const;

 private:
  struct Free {
    void operator()(_modbus* context) const noexcept;
  };
  LinkStatus finish(const Request& request, bool good) noexcept;

  std::unique_ptr<_modbus, Free> context_;
  int last_errno_ = 0;
  Request last_;
};

}  // namespace rigor::modbus

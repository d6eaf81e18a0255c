// TCP sockets, made in one way for all drivers: connections to devices, and ports that emulated devices
// serve. Sockets do not block and are not inherited by other programs.
#pragma once

#include <cstdint>
#include <string>

#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::network {

/// "192.168.1.10:502", "[::1]:502".
[[nodiscard]] std::string endpoint_text(const std::string& address, std::uint16_t port);

/// Waits until `fd` has one of `events`, or until `limit`. Returns 0, ETIMEDOUT, ECANCELED (`cut_fd` is
/// readable; below 0 there is none), or the errno of the wait. Any thread.
[[nodiscard]] int wait_for_socket(int fd, short events, MonotonicTime limit, int cut_fd) noexcept;

/// Connects to a host name or an address. All addresses of a name are tried within the limit. not_found: no
/// such host, nobody listens there, or not until `limit`. `device` is expected there, for messages. Setup or
/// I/O thread.
[[nodiscard]] Result<FileDescriptor> connect_tcp(const std::string& address, std::uint16_t port,
                                                 MonotonicTime limit, int cut_fd = -1,
                                                 const std::string& device = "a device");

struct TcpListener {
  FileDescriptor socket;
  std::uint16_t port = 0;  ///< the one that was taken, where any was asked for
};
/// Listens on an address of this machine; port 0 takes a free one. bad_input: no address. not_found: the
/// address is another machine's. unavailable: the port is taken, or not allowed. `what` is served there, for
/// messages: "Modbus". Setup.
[[nodiscard]] Result<TcpListener> listen_tcp(const std::string& address, std::uint16_t port,
                                             const std::string& what);

struct TcpClient {
  FileDescriptor socket;
  std::string address;  ///< "127.0.0.1"
};
/// The next client of a listener, or none. Small packets leave at once, and a client that vanished without a
/// word is found out within half a minute.
[[nodiscard]] TcpClient accept_tcp(const FileDescriptor& listener);

}  // namespace rigor::network

// Where the bytes of an emulated device leave for one host at a time: a pseudo-terminal, or a socket.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::serial {

/// One thread at a time.
class DeviceEnd {
 public:
  virtual ~DeviceEnd() = default;
  [[nodiscard]] virtual Status open() = 0;
  /// The descriptor to read and write, not blocking; -1 while no host is there.
  [[nodiscard]] virtual int fd() = 0;
  /// Reading or writing failed, or the stream ended.
  virtual void lost() = 0;
  /// Called when there is no host: wait at most this long for one. `cut` is readable when it is to return.
  virtual void await(int cut, Duration at_most) = 0;
  [[nodiscard]] virtual std::string endpoint() const = 0;
  /// Bits a second that the host has set its end of the line to; 0 where the end has no speed.
  [[nodiscard]] virtual unsigned client_baud() const { return 0; }
};

/// `link`: a symbolic link of that name is made (one that is there is replaced, anything else is refused);
/// empty: none.
[[nodiscard]] std::unique_ptr<DeviceEnd> make_pty_end(std::string link);
/// Serves one client; others wait in the queue of the socket. Port 0 takes a free one; endpoint() has it.
[[nodiscard]] std::unique_ptr<DeviceEnd> make_tcp_end(std::string address, std::uint16_t port);

/// Waits until `cut` is readable, at most so long.
void pause_until_cut(int cut, Duration at_most);
/// As write(2), without the signal of a socket whose other end has closed.
[[nodiscard]] ssize_t put_bytes(int fd, const char* bytes, std::size_t count) noexcept;

}  // namespace rigor::serial

// A TCP client's socket that never blocks for longer than it is told, and not at all once it is cut short.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::network {

class TcpStream {
 public:
  /// not_found: nobody listens there, or not until `limit`. `cut_fd`: readable when everything is to end
  /// (Deadline::cut_fd). `device` is expected there, for messages.
  [[nodiscard]] Status connect(const std::string& address, std::uint16_t port, MonotonicTime limit,
                               int cut_fd, const std::string& device = "a device");
  [[nodiscard]] bool is_open() const { return socket_.is_open(); }
  void close() { socket_.reset(); }

  enum class Outcome : std::uint8_t { data, timeout, closed, cut };
  /// Waits for at least one byte.
  [[nodiscard]] Outcome receive(std::span<std::uint8_t> into, MonotonicTime limit, std::size_t& size);
  /// All of it, or false.
  [[nodiscard]] bool send(std::span<const std::uint8_t> bytes, MonotonicTime limit);

 private:
  [[nodiscard]] Outcome wait(short events, MonotonicTime limit) const;
  FileDescriptor socket_;
  int cut_ = -1;
};

}  // namespace rigor::network

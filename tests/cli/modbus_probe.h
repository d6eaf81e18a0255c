// Asks a Modbus TCP device for one register, by the bytes of the protocol.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <optional>

namespace rigor::test {

/// `function`: 3 for holding registers, 4 for input registers.
inline std::optional<std::uint16_t> read_register(std::uint16_t port, std::uint8_t function,
                                                  std::uint16_t address) {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const timeval timeout{5, 0};
  setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const std::array<std::uint8_t, 12> ask{0,
                                         1,
                                         0,
                                         0,
                                         0,
                                         6,
                                         255,
                                         function,
                                         static_cast<std::uint8_t>(address >> 8),
                                         static_cast<std::uint8_t>(address),
                                         0,
                                         1};
  std::array<std::uint8_t, 11> answer{};
  std::size_t got = 0;
  if (connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0 &&
      write(fd, ask.data(), ask.size()) == static_cast<ssize_t>(ask.size()))
    for (ssize_t n = 1; n > 0 && got < answer.size(); got += static_cast<std::size_t>(n > 0 ? n : 0))
      n = read(fd, answer.data() + got, answer.size() - got);
  close(fd);
  if (got != answer.size() || answer[7] != function) return std::nullopt;
  return static_cast<std::uint16_t>(answer[9] << 8 | answer[10]);
}

}  // namespace rigor::test

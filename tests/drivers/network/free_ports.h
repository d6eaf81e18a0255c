#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstdint>

namespace rigor::network::test {

/// Two UDP ports of 127.0.0.1 that nobody has now.
inline std::array<std::uint16_t, 2> free_ports() {
  std::array<int, 2> fd{};
  std::array<std::uint16_t, 2> port{};
  for (std::size_t i = 0; i < 2; ++i) {
    fd[i] = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_in a{};
    a.sin_family = AF_INET;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t length = sizeof a;
    if (bind(fd[i], reinterpret_cast<sockaddr*>(&a), sizeof a) == 0 &&
        getsockname(fd[i], reinterpret_cast<sockaddr*>(&a), &length) == 0)
      port[i] = ntohs(a.sin_port);
  }
  for (const int f : fd) close(f);
  return port;
}

}  // namespace rigor::network::test

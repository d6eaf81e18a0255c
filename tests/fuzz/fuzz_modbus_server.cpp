// A client's bytes on the Modbus server of an emulated device. Input: the stream as it comes, cut into writes
// of up to 32 bytes.
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "drivers/modbus/modbus_server.h"

using namespace rigor;
using namespace rigor::modbus;

namespace {

/// 16 registers in each table.
class Registers final : public RegisterModel {
 public:
  bool read(RegisterTable, std::uint16_t address, std::span<std::uint16_t> out, BenchTime) override {
    if (address + out.size() > std::size(words_)) return false;
    std::copy_n(words_ + address, out.size(), out.begin());
    return true;
  }
  bool write(RegisterTable, std::uint16_t address, std::span<const std::uint16_t> in, BenchTime) override {
    if (address + in.size() > std::size(words_)) return false;
    std::copy(in.begin(), in.end(), words_ + address);
    return true;
  }

 private:
  std::uint16_t words_[16] = {};
};

}  // namespace

/// One server for all inputs, each of which is another client of it: a thread for each would take ten times
/// as long as what it does.
std::uint16_t port_of_server() {
  static Server server(std::make_shared<Registers>(), [] { return BenchTime(0); },
                       {.max_clients = 64, .idle_limit = Duration(0)});
  static const bool good = server.listen("127.0.0.1", 0) && server.start();
  if (!good) std::abort();
  return server.port();
}

/// libFuzzer's timer interrupts connect() now and then; the connection is then made in the background.
bool connected(int client, const sockaddr_in& server) {
  if (::connect(client, reinterpret_cast<const sockaddr*>(&server), sizeof server) == 0) return true;
  if (errno != EINTR) return false;
  pollfd made{client, POLLOUT, 0};
  int ready = 0;
  while ((ready = ::poll(&made, 1, 5000)) < 0 && errno == EINTR) {
  }
  int error = 0;
  socklen_t size = sizeof error;
  return ready > 0 && ::getsockopt(client, SOL_SOCKET, SO_ERROR, &error, &size) == 0 && error == 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::uint16_t port = port_of_server();
  const int client = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in server{};
  server.sin_family = AF_INET;
  server.sin_port = htons(port);
  server.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (!connected(client, server)) std::abort();
  // No port is left in TIME_WAIT.
  const linger none{1, 0};
  const int on = 1;
  ::setsockopt(client, SOL_SOCKET, SO_LINGER, &none, sizeof none);
  ::setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  for (std::size_t at = 0; at < size;) {
    const auto sent = ::send(client, data + at, std::min<std::size_t>(32, size - at), MSG_NOSIGNAL);
    if (sent < 0 && errno == EINTR) continue;
    if (sent < 0) break;
    at += static_cast<std::size_t>(sent);
  }
  ::shutdown(client, SHUT_WR);
  // Answers, then the end: the server must close on its own when the stream is over.
  std::uint8_t answers[512];
  while (true) {
    pollfd p{client, POLLIN, 0};
    const int ready = ::poll(&p, 1, 5000);
    if (ready < 0 && errno == EINTR) continue;  // libFuzzer's own timer
    if (ready <= 0) std::abort();
    if (::recv(client, answers, sizeof answers, 0) <= 0) break;
  }
  ::close(client);
  return 0;
}

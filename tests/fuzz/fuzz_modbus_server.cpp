// A client's bytes on the Modbus server of an emulated device. Input: the stream as it comes, cut into writes
// of up to 32 bytes.
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

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0) std::abort();
  Server server(std::make_shared<Registers>(), [] { return BenchTime(0); }, {.idle_limit = Duration(0)});
  server.adopt(ends[0]);
  if (!server.start()) std::abort();
  for (std::size_t at = 0; at < size; at += 32)
    if (::send(ends[1], data + at, std::min<std::size_t>(32, size - at), MSG_NOSIGNAL) < 0) break;
  ::shutdown(ends[1], SHUT_WR);
  // Answers, then the end: the server must close on its own when the stream is over.
  std::uint8_t answers[512];
  while (true) {
    pollfd p{ends[1], POLLIN, 0};
    const int ready = ::poll(&p, 1, 5000);
    if (ready < 0 && errno == EINTR) continue;  // libFuzzer's own timer
    if (ready <= 0) std::abort();
    if (::recv(ends[1], answers, sizeof answers, 0) <= 0) break;
  }
  server.stop();
  ::close(ends[1]);
  return 0;
}

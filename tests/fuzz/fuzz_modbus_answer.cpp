// A device that answers anything: libmodbus and our link over a socket whose other end has its answers ready.
// Input: which request and framing, then the bytes that come back. What is read must be within what was asked
// for.
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstdlib>

#include "drivers/modbus/modbus_link.h"

using namespace rigor;
using namespace rigor::modbus;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2 || size > 4096) return 0;
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) std::abort();
  const bool rtu = (data[0] & 0x80) != 0;
  const auto table = static_cast<RegisterTable>(data[0] & 3);
  const auto count = static_cast<std::uint16_t>(1 + data[1] % 120);
  if (::send(ends[1], data + 2, size - 2, MSG_NOSIGNAL) < 0) std::abort();
  // No more comes: an answer that is cut off is an end, not a wait.
  ::shutdown(ends[1], SHUT_WR);
  {
    Link link;
    link.adopt(ends[0], milliseconds(50), rtu, 1);
    std::array<std::uint16_t, 128> out;
    out.fill(0xA5C3);
    const Request request{table, 3, count, 0};
    const auto status =
        (data[0] & 4) != 0 && !is_bits(table) ? link.write(request, out) : link.read(request, out);
    for (std::size_t i = count; i < out.size(); ++i)
      if (out[i] != 0xA5C3) std::abort();  // written behind what was asked for
    if (status != LinkStatus::good) (void)link.failure();
    (void)link.counters().trouble();
  }
  ::close(ends[1]);
  return 0;
}

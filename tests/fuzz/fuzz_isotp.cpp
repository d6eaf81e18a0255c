// Frames of a stranger to a receiver and to a sender of ISO-TP, in any order and at any time. Input: two
// bytes of options, then records of `length:8 (bit 7: wait) bytes`.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "drivers/can/isotp_codec.h"

using namespace rigor;
using namespace rigor::can;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  IsoTpOptions o;
  o.tx_id = 1;
  o.rx_id = 2;
  o.fd = (data[0] & 1) != 0;
  o.block_size = data[0] >> 4;
  if ((data[0] & 2) != 0) o.padding = 0;
  o.most_bytes = 5000;
  IsoTpReceiver receiver(o);
  IsoTpSender sender(o);
  BenchTime now(0);
  const std::vector<std::uint8_t> message(1 + data[1] * 21u, 0x55);
  if (message.size() <= o.most_bytes && !sender.start(message, now)) std::abort();
  std::size_t at = 2;
  while (at < size) {
    CanFrame f;
    f.id = 2;
    f.fd = o.fd;
    const std::size_t most = o.fd ? 64 : 8, wanted = std::min<std::size_t>(data[at] & 0x7f, most);
    if ((data[at] & 0x80) != 0) now = now + milliseconds(300);
    ++at;
    f.length = static_cast<std::uint8_t>(std::min(wanted, size - at));
    std::copy_n(data + at, f.length, f.data.begin());
    at += f.length;
    if (const auto answer = receiver.receive(f, now); answer && answer->length > 64) std::abort();
    receiver.check(now);
    if (receiver.message().size() > o.most_bytes) std::abort();
    sender.receive(f, now);
    for (int i = 0; i < 20; ++i) {
      const auto out = sender.next(now);
      if (!out) break;
      if (out->length == 0 || out->length > most) std::abort();
    }
    now = now + microseconds(500);
  }
  return 0;
}

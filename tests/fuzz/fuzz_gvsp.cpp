// Datagrams on the stream port of the client, in sequence. Input: records of `time:8 length:16 bytes`. A
// frame that is called complete must have every packet, and memory stays bounded.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "drivers/aravis/gvsp_assembler.h"

using namespace rigor;
using namespace rigor::gige;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  GvspAssemblerOptions options;
  options.packet_size = 64;
  options.payload_bytes = 16 * 8;
  options.extended_ids = (data[0] & 1) != 0;
  if ((data[0] & 2) != 0) options.part_bytes = {100, 28};
  GvspAssembler assembler(options);
  DeviceTime now(0);
  Bytes rest(data + 1, size - 1);
  AssembledFrame frame;
  while (rest.size() >= 3) {
    now = now + milliseconds(rest[0]);
    const std::size_t length = std::min<std::size_t>(load_be<std::uint16_t>(rest, 1), rest.size() - 3);
    assembler.push(rest.subspan(3, length), now);
    rest = rest.subspan(3 + length);
    for (const auto& c : assembler.resends(now)) {
      if (c.first_packet > c.last_packet) std::abort();
      (void)encode_packet_resend_cmd(1, c);
    }
    while (assembler.take(now, frame)) {
      if (frame.data.size() != options.payload_bytes) std::abort();
      if (frame.complete != frame.missing.empty()) std::abort();
      if (frame.complete && frame.leader.part_count != options.part_bytes.size()) std::abort();
      if (frame.complete && options.part_bytes.empty() &&
          payload_bytes(frame.leader.region, frame.leader.format) != options.payload_bytes)
        std::abort();
    }
  }
  return 0;
}

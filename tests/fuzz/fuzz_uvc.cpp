// A host on the control pipe of the emulated USB camera. Input: records of `setup:8 length:8 data`.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "drivers/v4l2/device_table.h"
#include "drivers/v4l2/uvc_control.h"

using namespace rigor::v4l2;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  uvc::ControlPipe pipe({{{kYuyv, 640, 480, 614400}, {kMjpg, 640, 480, 307200}}, {333'333, 666'666}, 1024});
  std::span<const std::uint8_t> rest(data, size);
  while (rest.size() >= 9) {
    const auto word = [&](std::size_t i) { return static_cast<std::uint16_t>(rest[i] | rest[i + 1] << 8); };
    const uvc::SetupPacket setup{rest[0], rest[1], word(2), word(4), word(6)};
    const std::size_t length = std::min<std::size_t>(rest[8], rest.size() - 9);
    const auto stage = rest.subspan(9, length);
    rest = rest.subspan(9 + length);
    const uvc::Answer a = pipe.setup(setup);
    if (a.length > a.bytes.size() || a.length > setup.length) std::abort();
    if (a.kind == uvc::Answer::Kind::expect || (setup.request_type & 1) == 0) (void)pipe.data(stage);
    const uvc::StreamControl& c = pipe.committed();
    if (c.format_index < 1 || c.format_index > 2 || c.frame_index != 1 ||
        (c.interval != 333'333 && c.interval != 666'666))
      std::abort();
  }
  return 0;
}

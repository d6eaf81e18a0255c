// What a Velodyne's port, a recording's frames and a calibration file can hold. Input: a byte that says
// which, then for 0 records of `length:16 bytes` as datagrams of one stream (model and unit by the byte's
// upper bits), for 1 a position packet, for 2 a captured frame of some link type, for 3 and 4 a calibration
// file.
#include <cmath>
#include <cstdlib>
#include <memory>
#include <string_view>

#include "drivers/velodyne/calibration_file.h"
#include "drivers/velodyne/cloud_stream.h"
#include "drivers/velodyne/udp_frame.h"

using namespace rigor;
using namespace rigor::velodyne;

namespace {

void fuzz_stream(std::uint8_t how, Bytes rest) {
  const Model model = (how & 8) != 0 ? Model::hdl32e : Model::vlp16;
  CloudStreamOptions options;
  options.unit = (how & 16) != 0 ? CloudUnit::packet : CloudUnit::revolution;
  options.time = static_cast<TimeSource>(how >> 5 & 3);
  options.max_points = 5000;
  CloudStream stream(PacketDecoder::create(model, factory_calibration(model)).value(), options);
  const EpochPair epoch{BenchTime(0), RealtimeTime(1'700'000'000'000'000'000), Duration(1)};
  stream.set_epoch(epoch);
  BenchTime now(0);
  std::uint64_t last = 0;
  bool any = false;
  while (rest.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(rest[0] | rest[1] << 8, rest.size() - 2);
    now = now + microseconds(1327);
    stream.take(rest.subspan(2, length), now, [&](const Cloud& c) {
      if (c.points.size() > options.max_points) std::abort();
      if (any && c.sequence <= last) std::abort();
      last = c.sequence, any = true;
      for (const LidarPoint& p : c.points)
        if (!std::isfinite(p.x_m) || !std::isfinite(p.y_m) || p.ring >= facts_of(model).lasers) std::abort();
    });
    rest = rest.subspan(2 + length);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::uint8_t how = data[0];
  const Bytes rest(data + 1, size - 1);
  const std::string_view text(reinterpret_cast<const char*>(rest.data()), rest.size());
  switch (how & 7) {
    case 0:
      fuzz_stream(how, rest);
      break;
    case 1:
      if (const auto p = parse_position(rest)) (void)parse_rmc(p->nmea);
      (void)parse_rmc(text);
      break;
    case 2: {
      const int links[] = {kLinkNull, kLinkEthernet, kLinkRaw, kLinkSll};
      if (const auto udp = udp_of_frame(links[how >> 3 & 3], rest)) {
        PacketFault fault{};
        (void)DataPacket::parse(udp->payload, fault);
        if (udp->payload.data() + udp->payload.size() > rest.data() + rest.size()) std::abort();
      }
      break;
    }
    default: {
      const auto c = parse_calibration(text, "fuzz", (how & 8) != 0 ? Model::hdl32e : Model::vlp16);
      if (c && !PacketDecoder::create((how & 8) != 0 ? Model::hdl32e : Model::vlp16, *c)) std::abort();
      break;
    }
  }
  return 0;
}

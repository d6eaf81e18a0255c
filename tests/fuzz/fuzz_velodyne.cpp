// What a Velodyne's ports and a recording's frames can hold. Input: a byte that says which, then for 0
// records of `length:16 bytes` as datagrams of one stream (model, unit and time by the byte's upper bits),
// for 1 a position packet, for 2 a captured frame of some link type.
#include <cmath>
#include <cstdlib>
#include <memory>
#include <string_view>

#include "drivers/network/udp_frame.h"
#include "drivers/velodyne/cloud_stream.h"

using namespace rigor;
using namespace rigor::velodyne;
using namespace rigor::network;

namespace {

struct Options {
  Model model;
  CloudStreamOptions stream;
  explicit Options(std::uint8_t how) : model((how & 8) != 0 ? Model::hdl32e : Model::vlp16) {
    stream.unit = (how & 16) != 0 ? CloudUnit::packet : CloudUnit::revolution;
    stream.time = static_cast<TimeSource>(how >> 5 & 3);
    stream.max_points = 5000;
  }
};

/// Making a stream takes longer than most inputs: there is one of each kind, as new for each input.
CloudStream& fresh_stream(std::uint8_t how) {
  static std::unique_ptr<CloudStream> streams[16];
  auto& s = streams[how >> 3 & 15];
  if (!s) {
    const Options o(how);
    s = std::make_unique<CloudStream>(PacketDecoder::create(o.model, factory_calibration(o.model)).value(),
                                      o.stream);
    s->clock().set_epoch({BenchTime(0), RealtimeTime(1'700'000'000'000'000'000), Duration(1)});
  }
  s->reset();
  return *s;
}

void fuzz_stream(std::uint8_t how, Bytes rest) {
  const Options o(how);
  CloudStream& stream = fresh_stream(how);
  BenchTime now(0);
  std::uint64_t last = 0;
  bool any = false;
  while (rest.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(rest[0] | rest[1] << 8, rest.size() - 2);
    now = now + microseconds(1327);
    stream.take(rest.subspan(2, length), now, [&](const Cloud& c) {
      if (c.points.size() > o.stream.max_points) std::abort();
      if (any && c.sequence <= last) std::abort();
      last = c.sequence, any = true;
      for (const LidarPoint& p : c.points)
        if (!std::isfinite(p.x_m) || !std::isfinite(p.y_m) || p.ring >= facts_of(o.model).lasers)
          std::abort();
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
  switch ((how & 7) % 3) {
    case 0:
      fuzz_stream(how, rest);
      break;
    case 1:
      if (const auto p = parse_position(rest)) (void)parse_rmc(p->nmea);
      (void)parse_rmc(text);
      break;
    default: {
      const int links[] = {kLinkNull, kLinkEthernet, kLinkRaw, kLinkSll};
      if (const auto udp = udp_of_frame(links[how >> 3 & 3], rest)) {
        PacketFault fault{};
        (void)DataPacket::parse(udp->payload, fault);
        if (udp->payload.data() + udp->payload.size() > rest.data() + rest.size()) std::abort();
      }
      break;
    }
  }
  return 0;
}

// What a receiver's line and a host's line can hold. Input: a byte that says which, then for 0 a stream of
// UBX, NMEA and RTCM (in pieces of the byte's upper bits), for 1 records of `length:16 payload` that become
// UBX frames with right checksums (class and id are the first two bytes), for 2 lines that become sentences
// with right checksums, for 3 such records to an emulated receiver as its host's requests.
#include <cmath>
#include <cstdlib>

#include "drivers/gnss/nmea.h"
#include "drivers/gnss/receiver_device.h"
#include "drivers/gnss/receiver_stream.h"

using namespace rigor;
using namespace rigor::gnss;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

void read_stream(Bytes bytes, std::size_t piece) {
  std::uint64_t last = 0;
  bool any = false;
  ReceiverStream::Options options;
  options.period = milliseconds(100);
  ReceiverStream stream(
      options, {.solution =
                    [&](const Solution& s, const ReceiverStream::Place& p) {
                      check(!any || p.sequence > last);
                      last = p.sequence, any = true;
                      if (s.has_fix()) {
                        check(!(s.latitude_deg > 215) && !(s.latitude_deg < -215));
                      }
                      const NavFix f = nav_fix_of(s);
                      for (const double c : f.covariance_enu_m2) check(std::isfinite(c));
                    },
                .sky =
                    [&](const Sky& s, const ReceiverStream::Place&) {
                      check(s.satellites.size() <= 256);
                      for (const Satellite& v : s.satellites) (void)nmea_number(v.id);
                    },
                .pulse = [](const TimePulse&) {},
                .raw = [](Bytes payload) { check(payload.size() >= 16); },
                .message = [](const Message& m) { check(m.frame.size() <= kMaxUbxPayload + kUbxOverhead); }});
  std::int64_t now = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    stream.take(bytes.subspan(at, std::min(piece, bytes.size() - at)), BenchTime(now += 10'000'000));
    if (now % 70'000'000 == 0) stream.idle();
    if (now % 110'000'000 == 0) stream.take_edge(BenchTime(now - 1000), BenchTime(now));
  }
  stream.finish();
  const auto& c = stream.messages().counters();
  check(c.bytes == bytes.size() && c.garbage <= c.bytes);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::uint8_t how = data[0];
  Bytes rest(data + 1, size - 1);
  Buffer made;
  switch (how & 3) {
    case 0:
      read_stream(rest, 1 + (how >> 2) * 7U);
      return 0;
    case 2: {
      std::string_view text(reinterpret_cast<const char*>(rest.data()), rest.size());
      while (!text.empty()) {
        const auto line = text.substr(0, text.find('\n'));
        append_sentence(made, line);
        text.remove_prefix(std::min(text.size(), line.size() + 1));
      }
      read_stream(made, 4096);
      return 0;
    }
    default:
      break;
  }
  while (rest.size() >= 4) {
    const std::size_t length = std::min<std::size_t>(
        {std::size_t{rest[0]} | std::size_t{rest[1]} << 8, rest.size() - 4, kMaxUbxPayload});
    append_ubx(made, ubx_id(rest[2], rest[3]), rest.subspan(4, length));
    rest = rest.subspan(4 + length);
  }
  if ((how & 3) == 1) {
    read_stream(made, 4096);
    return 0;
  }
  EmulatorSettings settings;
  settings.generation = (how & 4) != 0 ? 8 : 9;
  settings.messages = {"pvt", "sat", "gga"};
  ReceiverDevice device(settings);
  device.receive(made, BenchTime(0));
  check(device.period() >= milliseconds(25) && serial::is_standard_baud(device.baud()));
  // Whatever was set, what it says is understood.
  device.output().clear();
  Measured m;
  m.fix.status = FixStatus::fix;
  m.fix.satellites = how;
  device.speak(m, RealtimeTime(1'700'000'000'000'000'000), 0, BenchTime(0));
  MessageStream stream;
  stream.add(device.output());
  while (stream.next()) {
  }
  check(stream.counters().garbage == 0);
  return 0;
}

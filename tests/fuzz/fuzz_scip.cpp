// SCIP 2.0, both sides: a host's bytes on the emulated scanner, a scanner's bytes on the host's session. The
// first byte says which; the rest is the stream, cut into pieces whose lengths come from the stream itself.
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "drivers/usb/scan_keeper.h"

using namespace rigor;
using namespace rigor::usb;

namespace {

bool measure(std::uint64_t scan, DeviceTime, std::span<std::uint32_t> range,
             std::span<std::uint32_t> intensity) {
  for (std::size_t s = 0; s < range.size(); ++s) {
    range[s] = static_cast<std::uint32_t>((scan + s * 7) % 70000);
    intensity[s] = static_cast<std::uint32_t>(s);
  }
  return scan % 5 != 4;
}

/// The same scanner with a narrow field of view: what it says has no other form, and takes a tenth of the
/// time.
ScannerModel narrow(ScannerModel m) {
  m.parameters.first_step = 4;
  m.parameters.front_step = 40;
  m.parameters.last_step = 75;
  m.end_step = 80;
  return m;
}

template <class F>
void in_pieces(std::string_view bytes, F&& f) {
  std::int64_t ns = 0;
  while (!bytes.empty()) {
    const std::size_t n =
        std::min<std::size_t>(bytes.size(), 1 + (static_cast<unsigned char>(bytes[0]) & 63));
    f(bytes.substr(0, n), ns += 7'000'000);
    bytes.remove_prefix(n);
  }
}

void host_on_device(const ScannerModel& model, std::string_view bytes) {
  ScipDevice device(model, measure, {.backlog_bytes = 4 * 1024});
  ScipReplyReader reader;
  ScipReply reply;
  static ScipScan scan;  // overwritten by each scan: its memory is taken once
  in_pieces(bytes, [&](std::string_view piece, std::int64_t ns) {
    device.receive(piece, DeviceTime(ns));
    if (device.output().size() > 64 * 1024) std::abort();  // bounded, whatever is asked for
    reader.push(device.output(), ns);
    device.output().clear();
    while (reader.next(reply)) {
      if (reply.status().empty()) std::abort();  // what the emulator says is well-formed
      if (decode_scan(reply, scan) == ScanDecode::broken) std::abort();
    }
  });
  device.advance(DeviceTime(1'000'000'000));
}

void device_on_host(std::string_view bytes) {
  ScipClient client({});
  client.begin(0);
  ScanKeeper keeper;
  RunOrigin origin;
  origin.publish(BenchTime(0));
  bool started = false;
  static Sample sample = [] {
    Sample s;
    s.reserve(10000 * sizeof(LidarPoint));
    return s;
  }();
  static ScipScan scan;
  std::int64_t arrival = 0;
  ScipClient::Reading reading;
  in_pieces(bytes, [&](std::string_view piece, std::int64_t ns) {
    client.receive(piece, ns);
    client.tick(ns);
    client.sent(ns);
    if (client.phase() == ScipClient::Phase::ready && !started) {
      started = true;
      (void)client.check();
      keeper.begin(milliseconds(10), client.request(), client.parameters());
      client.start(ns);
    }
    while (client.next_reading(reading)) keeper.reading(reading);
    while (client.next_scan(scan, arrival))
      if (started) {
        const auto kept = keeper.place(scan, BenchTime(arrival), origin);
        if (kept.in_run && kept.in_order) keeper.fill(scan, sample);
      }
  });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  static const ScannerModel kUrg = narrow(urg_04lx()), kUtm = narrow(utm_30lx());
  switch (data[0] % 3) {
    case 0:
      host_on_device(kUrg, bytes);
      break;
    case 1:
      host_on_device(kUtm, bytes);
      break;
    default:
      device_on_host(bytes);
      break;
  }
  return 0;
}

// A SICK scanner's stream on its client, and a client's stream on an emulated scanner: framing, telegrams,
// scans to points, variables and methods. First byte: how long the pieces are, and who is spoken to.
#include <algorithm>
#include <cstdlib>

#include "drivers/sick/client_dialog.h"
#include "drivers/sick/scan_receiver.h"
#include "drivers/sick/scanner_device.h"

using namespace rigor;
using namespace rigor::sick;

namespace {

void as_client(FrameParser& parser, ClientDialog& dialog) {
  static ScanData scan;
  CloudMaker clouds;
  MicrosecondClock clock;
  static std::vector<std::byte> memory(4096 * sizeof(LidarPoint));
  for (Bytes body = parser.next(); body.data(); body = parser.next()) {
    const auto t = parse_telegram(body);
    if (!t) continue;
    if (!dialog.done()) (void)dialog.answer(*t);
    if (dialog.done() && !dialog.streaming()) dialog.begin_stream();
    (void)dialog.max_points();
    if (t->name != "LMDscandata" || decode_scan(t->values, scan) != ScanError::none) continue;
    // What was understood is said again in the same bytes.
    Buffer again;
    encode_scan(scan, again);
    if (!std::equal(again.begin(), again.end(), t->values.begin(), t->values.end())) std::abort();
    const ScanInstants i = scan_instants(scan, clock);
    std::uint32_t count = 0;
    (void)clouds.fill(scan, i.beam_step, memory, count);
    if (count > 4096) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1) return 0;
  const std::size_t piece = 1 + (data[0] & 0x7F);
  const bool client = (data[0] & 0x80) != 0;
  const Bytes stream(data + 1, size - 1);
  FrameParser parser(client ? kMaxScanBody : 4096);
  ScannerConfig config = scanner_config(Family::lms5xx);
  config.pattern = {-5, 10, 20};
  ScannerDevice device(config);
  const LidarPoint point{1, 2, 0, 100, 0, 0, 0, 0};
  Session session;
  Wish wish;
  wish.echoes = EchoFilter::all;
  ClientDialog dialog(wish);
  for (std::size_t at = 0; at < stream.size(); at += piece) {
    parser.add(stream.subspan(at, std::min(piece, stream.size() - at)));
    if (client) {
      as_client(parser, dialog);
      continue;
    }
    Buffer out;
    for (Bytes body = parser.next(); body.data(); body = parser.next()) {
      device.answer(session, body, DeviceTime(1'000'000'000), out);
      if (device.made_scan(3)) device.set_scan({&point, 1}, 3, DeviceTime(1000), DeviceTime(2000));
    }
    // Every answer is a telegram.
    FrameParser back;
    back.add(out);
    while (back.next().data()) {
    }
    if (back.pending() != 0 || back.skipped_bytes() != 0) std::abort();
  }
  return 0;
}

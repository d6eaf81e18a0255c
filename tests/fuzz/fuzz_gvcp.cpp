// Datagrams on the control port of the emulated camera, in sequence, from its controller and from a stranger;
// and the same bytes as acknowledges on the client's side. Input: records of `who:8 length:16 bytes`.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "drivers/aravis/gige_device_model.h"

using namespace rigor;
using namespace rigor::gige;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // Each input meets a camera fresh from the box; making its description anew each time would only cost time.
  static const GigeDeviceModel fresh = [] {
    GigeCameraConfig config;
    config.sensor_width_px = 64;
    config.sensor_height_px = 48;
    config.formats = {PixelFormat::mono8, PixelFormat::mono12p, PixelFormat::rgb8};
    return GigeDeviceModel::create(config).value();
  }();
  GigeDeviceModel model = fresh;
  DeviceTime now(1'000'000'000);
  std::vector<std::uint8_t> packet(kGvspMaxDatagram);
  Bytes rest(data, size);
  while (rest.size() >= 3) {
    const std::uint8_t who = rest[0];
    const std::size_t length = std::min<std::size_t>(load_be<std::uint16_t>(rest, 1), rest.size() - 3);
    const Bytes datagram = rest.subspan(3, length);
    rest = rest.subspan(3 + length);
    const Endpoint from{0x7F000001U + (who & 1), static_cast<std::uint16_t>(5000 + (who & 2))};
    now = now + microseconds(100 * (who >> 2));
    const auto a = model.handle_gvcp(from, datagram, now);
    if (a.ack.size() > kGvcpHeaderSize + kGvcpMaxPayload) std::abort();
    if (a.resend && a.resend->block) {
      for (auto i = a.resend->first; i <= a.resend->last; ++i) {
        if (a.resend->block->encode_packet(i, packet) == 0) std::abort();
      }
    }
    FrameJob job;
    if (model.begin_frame(now, job)) {
      if (job.picture().size() != payload_bytes(job.request.region, job.request.format)) std::abort();
      std::fill(job.picture().begin(), job.picture().end(), std::uint8_t{7});
      (void)model.finish_frame(std::move(job), true);
    }
    GvcpAck ack;
    (void)decode_gvcp_ack(datagram, ack);
    if (!a.ack.empty() && decode_gvcp_ack(a.ack, ack) != DecodeStatus::ok) std::abort();
  }
  return 0;
}

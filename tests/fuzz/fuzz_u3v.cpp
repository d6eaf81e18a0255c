// A host of the emulated USB3 Vision camera: what it sends by USB/IP, and commands of the control endpoint
// inside of it. Input: records of `kind:8 length:16 bytes`.
//
//   kind & 3   0: bytes of the connection as they are   1: a command on the control endpoint
//              2: IN transfers, one for each byte       3: time passes: so many ms as the first byte says
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "drivers/aravis/u3v_usb_device.h"
#include "drivers/network/usbip_session.h"
#include "rt-core/byte_order.h"

using namespace rigor;

namespace {

/// Whatever the host did, the session's answers are whole messages of USB/IP.
void check_answers(const std::string& out, std::size_t& at) {
  using namespace usbip;
  while (out.size() - at >= kHeaderBytes) {
    const auto h = decode_header({reinterpret_cast<const std::uint8_t*>(out.data()) + at, kHeaderBytes});
    if (!h || (h->command != Command::submitted && h->command != Command::unlinked)) std::abort();
    // Data follows an IN transfer alone; the harness gives those sequence numbers of their own.
    const bool in = h->command == Command::submitted && (h->sequence & 0x40000000) != 0;
    at += kHeaderBytes + (in ? h->length : 0);
    if (at > out.size()) std::abort();
  }
  if (at != out.size()) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // Each input meets a camera fresh from the box; making its description anew each time would only cost time.
  static const u3v::Camera fresh = [] {
    u3v::CameraOptions o;
    o.camera.sensor_width_px = 64, o.camera.sensor_height_px = 48;
    o.camera.formats = {gige::PixelFormat::mono8, gige::PixelFormat::mono12p, gige::PixelFormat::rgb8};
    o.camera.line_period = milliseconds(7);
    o.start_delay = milliseconds(3);
    o.response_ms = 2;
    return u3v::Camera::create(o).value();
  }();
  u3v::UsbDevice device(fresh, "1-1");
  usbip::Session session(device);
  DeviceTime now(1'000'000'000);
  device.set_now(now);
  std::string in, out;
  usbip::append_operation(in, {usbip::kVersion, usbip::kImportRequest, 0});
  usbip::append_bus_id(in, "1-1");
  if (!session.receive(in, out)) std::abort();
  std::size_t checked = out.size();
  bool raw = false;
  std::uint32_t sequence = 0;
  usbip::Bytes rest(data, size);
  while (rest.size() >= 3) {
    const std::uint8_t kind = rest[0] & 3;
    const std::size_t length = std::min<std::size_t>(load_be<std::uint16_t>(rest, 1), rest.size() - 3);
    const auto bytes = rest.subspan(3, length);
    rest = rest.subspan(3 + length);
    usbip::Header h;
    h.sequence = ++sequence;
    switch (kind) {
      case 0:
        in.append(bytes.begin(), bytes.end());
        raw = true;  // its sequence numbers may be any
        break;
      case 1:
        h.endpoint = 1;
        h.length = static_cast<std::uint32_t>(length);
        usbip::append_header(in, h);
        in.append(bytes.begin(), bytes.end());
        break;
      case 2:
        for (const std::uint8_t b : bytes) {
          h.sequence = ++sequence | 0x40000000;
          h.in = true;
          h.endpoint = 1 + b % 3;
          h.length = std::uint32_t{b} * 16;
          usbip::append_header(in, h);
        }
        break;
      default:
        now = now + milliseconds(length > 0 ? bytes[0] : 1);
        device.advance(now);
        for (int i = 0; i < 8; ++i) {
          u3v::FrameJob job;
          if (!device.camera().begin_frame(now, job)) break;
          const auto expected = gige::payload_bytes(job.request.region, job.request.format);
          if (job.picture().size() != expected) std::abort();
          std::fill(job.picture().begin(), job.picture().end(), std::uint8_t{7});
          if (const auto f = device.camera().finish_frame(std::move(job), true)) {
            std::size_t sum = 0;
            for (const auto& part : f->transfers) sum += part.bytes;
            if (sum > expected || u3v::decode_trailer(f->trailer)->valid_bytes != sum) std::abort();
            (void)device.send_frame(*f);
          }
        }
        break;
    }
    device.set_now(now);
    if (!session.receive(in, out)) return 0;
    if (!raw) check_answers(out, checked);
    if (out.size() > (4u << 20)) return 0;
  }
  return 0;
}

#include "tests/drivers/v4l2/usbip_camera.h"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

#include "drivers/network/usbip_device.h"
#include "drivers/v4l2/uvc_gadget.h"
#include "rt-core/byte_order.h"
#include "rt-core/time.h"
#include "tests/drivers/v4l2/v4l2_test_tools.h"

namespace rigor::v4l2::test {
namespace {

constexpr std::uint32_t kDeviceId = 0x00010002;

void add(std::vector<std::uint8_t>& to, const std::vector<std::uint8_t>& more) {
  to.insert(to.end(), more.begin(), more.end());
}

/// The configuration with its interfaces 0 (control) and 1 (streaming; setting 1 has the endpoint).
std::vector<std::uint8_t> describe(const uvc::StreamOffer& offer) {
  std::vector<std::uint8_t> formats;
  std::uint8_t index = 0;
  for (const uvc::StreamFormat& f : offer.formats) {
    std::vector<std::uint8_t> d{27, 0x24, 0x04, ++index, 1};
    add(d, uvc_guid(f.code));
    add(d, {static_cast<std::uint8_t>(f.code == kGrey ? 8 : 16), 1, 0, 0, 0, 0});
    add(d, {static_cast<std::uint8_t>(26 + 4 * offer.intervals.size()), 0x24, 0x05, 1, 0});
    append_le(d, static_cast<std::uint16_t>(f.width_px));
    append_le(d, static_cast<std::uint16_t>(f.height_px));
    const auto bits_per_s =
        static_cast<std::uint32_t>(std::uint64_t{f.frame_bytes} * 8 * 10'000'000 / offer.intervals.front());
    for (const std::uint32_t v :
         {bits_per_s, bits_per_s, static_cast<std::uint32_t>(f.frame_bytes), offer.intervals.front()})
      append_le(d, v);
    d.push_back(static_cast<std::uint8_t>(offer.intervals.size()));
    for (const std::uint32_t i : offer.intervals) append_le(d, i);
    add(formats, d);
  }
  std::vector<std::uint8_t> all{8, 0x0b, 0, 2, 0x0e, 3, 0, 0};  // the two interfaces are one function
  add(all, {9, 4, 0, 0, 0, 0x0e, 1, 0, 0});
  add(all, {13, 0x24, 1, 0x10, 1, 13 + 18 + 9, 0, 0, 0x6c, 0xdc, 2, 1, 1});    // UVC 1.1, 48 MHz
  add(all, {18, 0x24, 2, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0});  // terminal 1: a camera
  add(all, {9, 0x24, 3, 2, 0x01, 0x01, 0, 1, 0});                              // terminal 2: USB, fed by 1
  add(all, {9, 4, 1, 0, 0, 0x0e, 2, 0, 0});
  const auto n = static_cast<std::uint8_t>(offer.formats.size());
  all.insert(all.end(), {static_cast<std::uint8_t>(13 + n), 0x24, 1, n});
  append_le(all, static_cast<std::uint16_t>(13 + n + formats.size()));
  add(all, {0x81, 0, 2, 0, 0, 0, 1});
  all.insert(all.end(), n, 0);
  add(all, formats);
  add(all, {9, 4, 1, 1, 1, 0x0e, 2, 0, 0});
  add(all, {7, 5, 0x81, 0x05});  // isochronous, asynchronous
  append_le(all, static_cast<std::uint16_t>(offer.payload_bytes));
  all.push_back(1);
  std::vector<std::uint8_t> configuration{9, 2};
  append_le(configuration, static_cast<std::uint16_t>(all.size() + 9));
  add(configuration, {2, 1, 0, 0x80, 50});
  add(configuration, all);
  return configuration;
}

std::vector<std::uint8_t> bytes_of(const std::string& text) { return {text.begin(), text.end()}; }

bool send_all(const FileDescriptor& fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::send(fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (n <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}
bool receive_all(const FileDescriptor& fd, std::vector<std::uint8_t>& bytes, std::size_t n) {
  bytes.resize(n);
  return n == 0 || ::recv(fd.get(), bytes.data(), n, MSG_WAITALL) == static_cast<ssize_t>(n);
}

}  // namespace

std::string attach_to_host(int fd) {
  const std::string host = "/sys/devices/platform/vhci_hcd.0/";
  std::ifstream status(host + "status");
  std::string line, hub, port, state;
  for (bool found = false; !found;) {
    if (!std::getline(status, line)) return "vhci_hcd has no free port";
    std::istringstream words(line);
    found = words >> hub >> port >> state && hub == "hs" && state == "004";
  }
  std::ofstream attach(host + "attach");
  attach << std::stoul(port) << " " << fd << " " << kDeviceId << " "
         << static_cast<std::uint32_t>(usbip::Speed::high) << std::flush;
  return attach ? std::string() : "vhci_hcd refuses the camera: " + std::string(std::strerror(errno));
}

UsbipCamera::UsbipCamera(uvc::StreamOffer offer, std::string product)
    : product_(std::move(product)), configuration_(describe(offer)), pipe_(std::move(offer)) {}

std::vector<std::byte> UsbipCamera::picture(std::uint32_t number, std::size_t bytes) {
  std::vector<std::byte> p(bytes);
  FormulaCamera::fill(number, p);
  for (std::size_t i = 0; i < 4; ++i) p[i] = static_cast<std::byte>(number >> 8 * i);
  return p;
}

std::string UsbipCamera::plug() {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) return std::strerror(errno);
  fd_ = FileDescriptor(ends[0]);
  waiting_.clear(), sending_ = false;
  // It answers from the first moment on: the kernel asks as soon as it is plugged in.
  thread_ = std::thread([this] { run(); });
  std::string problem = attach_to_host(ends[1]);
  ::close(ends[1]);
  if (!problem.empty()) unplug();
  return problem;
}

void UsbipCamera::unplug() {
  if (!fd_) return;
  ::shutdown(fd_.get(), SHUT_RDWR);
  thread_.join();
  fd_.reset();
  streams_ = false;
}

void UsbipCamera::run() {
  for (;;) {
    int wait_ms = -1;
    if (streams_) {
      const std::int64_t now = monotonic_now().ns();
      if (!sending_ && now >= due_ns_) next_picture();
      while (sending_ && !waiting_.empty()) {
        if (!fill(waiting_.front())) return;
        waiting_.pop_front();
      }
      // Without a transfer to fill there is nothing to do before the host sends one.
      if (!sending_) wait_ms = static_cast<int>(std::max<std::int64_t>(0, (due_ns_ - now) / 1'000'000 + 1));
    }
    pollfd p{fd_.get(), POLLIN, 0};
    const int n = ::poll(&p, 1, wait_ms);
    if (n < 0 && errno != EINTR) return;
    if (n > 0 && !serve_one()) return;
  }
}

void UsbipCamera::next_picture() {
  picture_ = picture(sent_, pipe_.committed().max_frame_bytes);
  done_ = 0;
  sending_ = true;
  // On the grid; what was missed on it is not made up for.
  const std::int64_t period_ns = std::int64_t{pipe_.committed().interval} * 100, now = monotonic_now().ns();
  while (due_ns_ <= now) due_ns_ += period_ns;
}

bool UsbipCamera::serve_one() {
  std::vector<std::uint8_t> bytes, data, packets;
  if (!receive_all(fd_, bytes, usbip::kHeaderBytes)) return false;
  const auto h = usbip::decode_header(bytes);
  if (!h) return false;
  if (h->command == usbip::Command::unlink) {
    const auto it = std::find_if(waiting_.begin(), waiting_.end(),
                                 [&](const auto& t) { return t.header.sequence == h->unlink; });
    usbip::Header r;
    r.command = usbip::Command::unlinked;
    r.sequence = h->sequence;
    if (it != waiting_.end()) {
      r.status = -ECONNRESET;
      waiting_.erase(it);
    }
    std::string answer;
    usbip::append_header(answer, r);
    return send_all(fd_, answer);
  }
  if (h->command != usbip::Command::submit) return false;
  if (!h->in && !receive_all(fd_, data, h->length)) return false;
  if (h->endpoint == 0) return control(*h, data);
  if (h->endpoint != 1 || h->packets > 256) return reply(*h, -EPIPE, {});
  if (!receive_all(fd_, packets, h->packets * usbip::kIsochronousPacketBytes)) return false;
  Transfer t{*h, {}};
  for (std::size_t at = 0; at < packets.size(); at += usbip::kIsochronousPacketBytes)
    t.packets.push_back(usbip::decode_isochronous_packet(usbip::Bytes(packets).subspan(at)));
  waiting_.push_back(std::move(t));
  return true;
}

/// As much of the picture as one transfer takes; its packets after the picture's end stay empty.
bool UsbipCamera::fill(Transfer& t) {
  constexpr std::size_t kPayloadHeader = 2;
  std::string data;
  for (usbip::IsochronousPacket& p : t.packets) {
    p.actual_length = 0, p.status = 0;
    if (!sending_) continue;
    const std::size_t n = std::min<std::size_t>(p.length - kPayloadHeader, picture_.size() - done_);
    const bool last = done_ + n == picture_.size();
    const std::uint32_t every = damage_every_;
    const bool damaged = last && every != 0 && sent_ % every == every - 1;
    // End of header; end of frame; the bit that changes with each frame.
    data += static_cast<char>(kPayloadHeader);
    data += static_cast<char>(0x80 | (last ? 0x02 : 0) | (sent_ & 1));
    if (!damaged) data.append(reinterpret_cast<const char*>(picture_.data()) + done_, n);
    p.actual_length = static_cast<std::uint32_t>(kPayloadHeader + (damaged ? 0 : n));
    done_ += n;
    if (last) sending_ = false, ++sent_;
  }
  usbip::Header r = t.header;
  r.command = usbip::Command::submitted, r.device_id = 0, r.in = false, r.endpoint = 0;
  r.length = static_cast<std::uint32_t>(data.size());
  std::string answer;
  usbip::append_header(answer, r);
  answer += data;
  for (const usbip::IsochronousPacket& p : t.packets) usbip::append_isochronous_packet(answer, p);
  return send_all(fd_, answer);
}

bool UsbipCamera::control(const usbip::Header& header, std::span<const std::uint8_t> data) {
  const uvc::SetupPacket s = usbip::decode_setup(header.setup);
  bool stall = false;
  std::vector<std::uint8_t> bytes;
  if ((s.request_type & 0x60) == 0) {
    bytes = standard(s, stall);
  } else {
    const uvc::Answer a = pipe_.setup(s);
    stall = a.kind == uvc::Answer::Kind::stall || (a.kind == uvc::Answer::Kind::expect && !pipe_.data(data));
    if (a.kind == uvc::Answer::Kind::data) bytes.assign(a.bytes.begin(), a.bytes.begin() + a.length);
  }
  if (stall) return reply(header, -EPIPE, {});
  bytes.resize(std::min<std::size_t>(bytes.size(), s.length));
  return header.in ? reply(header, 0, bytes) : reply(header, 0, {}, static_cast<std::uint32_t>(data.size()));
}

std::vector<std::uint8_t> UsbipCamera::standard(const uvc::SetupPacket& s, bool& stall) {
  switch (s.request) {
    case 0x06:  // GET_DESCRIPTOR
      switch (s.value >> 8) {
        case 1:
          return {18, 1, 0, 2, 0xef, 2, 1, 64, 0x6b, 0x1d, 0x02, 0x01, 0, 1, 1, 2, 3, 1};
        case 2:
          return configuration_;
        case 3:
          if ((s.value & 0xFF) == 0) return {4, 3, 0x09, 0x04};
          return bytes_of(usbip::string_descriptor((s.value & 0xFF) == 1   ? "Rigor"
                                                   : (s.value & 0xFF) == 2 ? product_
                                                                           : "1"));
        default:
          stall = true;
          return {};
      }
    case 0x0b:  // SET_INTERFACE: the setting with the endpoint is the stream
      if (s.index == 1) {
        streams_ = s.value == 1;
        sending_ = false;
        due_ns_ = monotonic_now().ns();
      }
      return {};
    case 0x00:
      return {0, 0};  // GET_STATUS
    case 0x08:
      return {1};  // GET_CONFIGURATION
    case 0x0a:
      return {streams_ ? std::uint8_t{1} : std::uint8_t{0}};  // GET_INTERFACE
    case 0x01:                                                // CLEAR_FEATURE
    case 0x03:                                                // SET_FEATURE
    case 0x09:
      return {};  // SET_CONFIGURATION
    default:
      stall = true;
      return {};
  }
}

bool UsbipCamera::reply(const usbip::Header& to, std::int32_t status, std::span<const std::uint8_t> data,
                        std::uint32_t out_bytes) {
  usbip::Header r;
  r.command = usbip::Command::submitted;
  r.sequence = to.sequence;
  r.status = status;
  r.length = out_bytes + static_cast<std::uint32_t>(data.size());
  std::string answer;
  usbip::append_header(answer, r);
  answer.append(reinterpret_cast<const char*>(data.data()), data.size());
  return send_all(fd_, answer);
}

}  // namespace rigor::v4l2::test

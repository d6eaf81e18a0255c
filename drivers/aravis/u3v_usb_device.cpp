#include "drivers/aravis/u3v_usb_device.h"

#include <cstdio>
#include <initializer_list>

#include "rt-core/byte_order.h"

namespace rigor::u3v {
namespace {

constexpr std::uint8_t kMiscellaneous = 0xEF, kU3vSubclass = 0x05;
constexpr std::uint8_t kControlProtocol = 0, kEventProtocol = 1, kStreamProtocol = 2;
constexpr std::uint16_t kUsb3 = 0x0300, kPacketBytes = 1024;
constexpr std::size_t kMostFrames = 4;
/// A host sends one command at a time; one that reads no answers is stalled, and gets no more events.
constexpr std::size_t kMostAnswers = 64, kMostEventMessages = 64;
/// Messages of a frame carry a tag: its trailer its payload's bytes, what comes before it none.
constexpr std::uint64_t kTrailerTag = std::uint64_t{1} << 63;

using Descriptor = std::vector<std::uint8_t>;
void add(Descriptor& to, std::initializer_list<std::uint8_t> bytes) { to.insert(to.end(), bytes); }

/// Strings by their indices; the GUID is the vendor's number and eight characters of the serial number.
enum StringIndex : std::uint8_t { kVendor = 1, kModel, kSerial, kGuid, kFamily, kVersion, kInfo, kUserName };

std::string guid_of(const std::string& serial) {
  std::uint32_t hash = 2166136261u;  // FNV-1a
  for (const char c : serial) hash = (hash ^ static_cast<std::uint8_t>(c)) * 16777619u;
  char text[16];
  std::snprintf(text, sizeof text, "%04X%08X", kVendorId, hash);
  return text;
}

void add_endpoint(Descriptor& d, std::uint8_t address, std::uint8_t burst) {
  add(d, {7, 5, address, 2});  // bulk
  append_le(d, kPacketBytes);
  add(d, {0});
  add(d, {6, 0x30, burst, 0, 0, 0});  // SuperSpeed companion
}

void add_interface(Descriptor& d, std::uint8_t number, std::uint8_t endpoints, std::uint8_t protocol) {
  add(d, {9, 4, number, 0, endpoints, kMiscellaneous, kU3vSubclass, protocol, 0});
}

Descriptor configuration_descriptor() {
  Descriptor d{9, 2, 0, 0, 3, 1, 0, 0x80, 112};               // bus powered, 896 mA
  add(d, {8, 11, 0, 3, kMiscellaneous, kU3vSubclass, 0, 0});  // three interfaces are one function
  add_interface(d, 0, 2, kControlProtocol);
  // Device info (USB3 Vision, table 3-6): GenCP 1.2, USB3 Vision 1.1; strings; SuperSpeed and high speed.
  add(d, {20, 0x24,  0x01,    2,      0,       1,        0,     1,       0,         1,
          0,  kGuid, kVendor, kModel, kFamily, kVersion, kInfo, kSerial, kUserName, 0x0C});
  add_endpoint(d, kControlOut, 0);
  add_endpoint(d, kControlIn, 0);
  add_interface(d, 1, 1, kEventProtocol);
  add_endpoint(d, kEventIn, 0);
  add_interface(d, 2, 1, kStreamProtocol);
  add_endpoint(d, kStreamIn, 15);
  store_le(d, 2, static_cast<std::uint16_t>(d.size()));
  return d;
}

usbip::Descriptors describe(const Camera& camera, const std::string& bus_id) {
  const CameraState& s = camera.state();
  usbip::Descriptors all;
  all.strings = {s.vendor, s.model, s.serial, guid_of(s.serial), s.family, s.version, s.info, s.user_name};
  Descriptor& d = all.device;
  add(d, {18, 1});
  append_le(d, kUsb3);
  add(d, {kMiscellaneous, 2, 1, 9});  // interfaces are associated; packets of 2^9 on endpoint 0
  for (const std::uint16_t v : {kVendorId, kProductId, std::uint16_t{0x0100}}) append_le(d, v);
  add(d, {kVendor, kModel, kSerial, 1});
  all.configuration = configuration_descriptor();
  // What it can on the bus: link power states of USB 2.0, and SuperSpeed besides high speed.
  all.bos = {5, 15, 22, 0, 2, 7, 16, 2, 2, 0, 0, 0, 10, 16, 3, 0, 0x0C, 0, 3, 10, 0xFF, 0x07};
  usbip::ExportedDevice& e = all.exported;
  e.bus_id = bus_id;
  e.path = "/sys/devices/rigor/usb1/" + bus_id;
  e.number = 2;
  e.vendor = kVendorId, e.product = kProductId, e.release = 0x0100;
  e.device_class = {kMiscellaneous, 2, 1};
  for (const std::uint8_t protocol : {kControlProtocol, kEventProtocol, kStreamProtocol})
    e.interfaces.push_back({kMiscellaneous, kU3vSubclass, protocol});
  return all;
}

usbip::Device::Message shared(std::vector<std::uint8_t> bytes) {
  return std::make_shared<const std::vector<std::uint8_t>>(std::move(bytes));
}

}  // namespace

UsbDevice::UsbDevice(Camera camera, const std::string& bus_id)
    : usbip::Device(describe(camera, bus_id)), camera_(std::move(camera)) {}

void UsbDevice::on_attach() {
  camera_.power_on();
  acks_.clear();
  cut_frames();
  ++counters_.attached;
}

void UsbDevice::on_detach() {
  camera_.power_on();
  acks_.clear();
  cut_frames();
}

void UsbDevice::cut_frames() {
  counters_.frames_cut += frames_waiting_;
  frames_waiting_ = 0;
}

bool UsbDevice::on_write(std::uint8_t endpoint, usbip::Bytes data) {
  if (endpoint != kControlOut || acks_.size() + waiting_messages(kControlIn) >= kMostAnswers) return false;
  const bool was_streaming = camera_.streaming();
  std::vector<TimedAck> acks;
  camera_.handle(data, now_, acks);
  for (TimedAck& a : acks) acks_.push_back(std::move(a));
  if (was_streaming && !camera_.streaming()) {
    drop_messages(kStreamIn);
    cut_frames();
  }
  advance(now_);
  return true;
}

void UsbDevice::advance(DeviceTime now) {
  now_ = now;
  // In the order of the commands: an answer that takes its time keeps those behind it waiting.
  while (!acks_.empty() && acks_.front().due <= now) {
    const Message m = shared(std::move(acks_.front().bytes));
    acks_.pop_front();
    send(kControlIn, m, 0, m->size());
  }
  for (auto& e : camera_.take_events()) {
    if (waiting_messages(kEventIn) >= kMostEventMessages) break;
    const Message m = shared(std::move(e));
    send(kEventIn, m, 0, m->size());
  }
}

DeviceTime UsbDevice::next_due() const { return acks_.empty() ? DeviceTime::never() : acks_.front().due; }

bool UsbDevice::send_frame(const Frame& f) {
  if (!camera_.streaming() || !camera_.current(f.epoch)) return false;
  if (frames_waiting_ >= kMostFrames) {
    ++counters_.frames_dropped;
    return false;
  }
  ++frames_waiting_;
  send(kStreamIn, shared(f.leader), 0, f.leader.size());
  std::size_t bytes = f.leader.size() + f.trailer.size();
  for (const Frame::Part& p : f.transfers) {
    send(kStreamIn, f.payload, p.at, p.bytes);
    bytes += p.bytes;
  }
  send(kStreamIn, shared(f.trailer), 0, f.trailer.size(), kTrailerTag | bytes);
  return true;
}

void UsbDevice::on_sent(std::uint8_t endpoint, std::uint64_t tag) {
  if (endpoint != kStreamIn || (tag & kTrailerTag) == 0) return;
  ++counters_.frames_sent;
  counters_.bytes_sent += tag & ~kTrailerTag;
  if (frames_waiting_ > 0) --frames_waiting_;
}

void UsbDevice::on_reset(std::uint8_t endpoint) {
  if (endpoint == kStreamIn) {
    camera_.reset_stream();
    cut_frames();
  } else if (endpoint == kControlIn) {
    acks_.clear();
  }
}

}  // namespace rigor::u3v

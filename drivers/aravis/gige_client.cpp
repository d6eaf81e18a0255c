#include "drivers/aravis/gige_client.h"

#include <algorithm>
#include <charconv>
#include <cstdio>

#include "rt-core/device_text.h"

namespace rigor::gige {
namespace {

constexpr std::size_t kUrlSize = 512;
constexpr std::size_t kMaxXmlSize = 16 << 20;
constexpr std::uint32_t kMinPacketSize = 576;  // an IP datagram that every host takes
constexpr const char* kWhere = "gige client";

Status dropped(const Result<GvcpAck>& r) {
  if (!r) return tl::unexpected<Error>(r.error());
  return {};
}

/// `Local:name;address;size`, both in hexadecimal.
bool parse_local_url(std::string_view url, std::uint32_t& address, std::uint32_t& size) {
  const auto a = url.find(';');
  const auto b = a == std::string_view::npos ? a : url.find(';', a + 1);
  if (b == std::string_view::npos || url.size() < 6 ||
      (url.substr(0, 6) != "Local:" && url.substr(0, 6) != "local:")) {
    return false;
  }
  const auto hex = [&](std::size_t from, std::size_t end, std::uint32_t& v) {
    const auto r = std::from_chars(url.data() + from, url.data() + end, v, 16);
    return r.ec == std::errc() && r.ptr == url.data() + end;
  };
  const auto end = std::min(url.find('?', b), url.size());
  return hex(a + 1, b, address) && hex(b + 1, end, size);
}

}  // namespace

GigeClient::GigeClient(GigeTransport& transport, const GigeClientOptions& options)
    : transport_(&transport), options_(options), control_buffer_(2048), stream_buffer_(kGvspMaxDatagram) {}

std::uint16_t GigeClient::next_id() {
  id_ = id_ == 0xFFFF ? std::uint16_t{1} : static_cast<std::uint16_t>(id_ + 1);
  return id_;
}

Result<GvcpAck> GigeClient::ask(const Datagram& command, GvcpCommand expected_ack) {
  if (command.empty()) return fail(ErrorCode::internal, kWhere, "a command does not fit a datagram");
  for (int i = 0; i < options_.attempts; ++i) {
    transport_->send_control(command);
    while (const auto size = transport_->receive_control(control_buffer_)) {
      GvcpAck ack;
      if (decode_gvcp_ack(Bytes(control_buffer_).first(size), ack) != DecodeStatus::ok || ack.ack_id != id_ ||
          ack.command != static_cast<std::uint16_t>(expected_ack)) {
        continue;  // an old answer, or none of ours
      }
      return ack;
    }
  }
  return fail(ErrorCode::timeout, kWhere, "the camera did not answer; is it on?");
}

Result<GvcpAck> GigeClient::transact(const Datagram& command, GvcpCommand expected_ack) {
  auto ack = ask(command, expected_ack);
  if (ack && ack->status != GvStatus::success)
    return fail(ErrorCode::protocol, kWhere, std::string("the camera refused: ") + to_string(ack->status));
  return ack;
}

Result<DiscoveryAck> GigeClient::discover() {
  auto ack = transact(encode_discovery_cmd(next_id()), GvcpCommand::discovery_ack);
  if (!ack) return tl::unexpected<Error>(ack.error());
  const auto* d = std::get_if<DiscoveryAck>(&ack->body);
  if (d == nullptr) return fail(ErrorCode::protocol, kWhere, "the camera's discovery answer is empty");
  return *d;
}

Status GigeClient::connect() {
  if (auto s = write(reg::kControlPrivilege, reg::kPrivilegeControl); !s) return s;
  if (auto s = write(reg::kHeartbeatTimeout, options_.heartbeat_timeout_ms); !s) return s;
  const auto to = transport_->stream_endpoint();
  if (auto s = write(reg::kStreamDestination, to.ip); !s) return s;
  if (auto s = write(reg::kStreamPort, to.port); !s) return s;
  return write(reg::kStreamPacketSize, options_.packet_size);
}

Status GigeClient::disconnect() {
  assembler_.reset();
  return write(reg::kControlPrivilege, 0);
}

Result<std::uint32_t> GigeClient::read(std::uint32_t address) {
  auto ack =
      transact(encode_read_register_cmd(next_id(), std::span(&address, 1)), GvcpCommand::read_register_ack);
  if (!ack) return tl::unexpected<Error>(ack.error());
  const auto* r = std::get_if<ReadRegisterAck>(&ack->body);
  if (r == nullptr || r->values.count != 1) {
    return fail(ErrorCode::protocol, kWhere, "expected one register in the answer, got another number");
  }
  return r->values.items[0];
}

Status GigeClient::write(std::uint32_t address, std::uint32_t value) {
  const RegisterWrite w{address, value};
  return dropped(
      transact(encode_write_register_cmd(next_id(), std::span(&w, 1)), GvcpCommand::write_register_ack));
}

Result<std::vector<std::uint8_t>> GigeClient::read_memory(std::uint32_t address, std::size_t size) {
  std::vector<std::uint8_t> out;
  while (out.size() < size) {
    const auto count = static_cast<std::uint16_t>(std::min(size - out.size(), kGvcpMaxReadMemory));
    const auto at = address + static_cast<std::uint32_t>(out.size());
    auto ack = transact(encode_read_memory_cmd(next_id(), {at, count}), GvcpCommand::read_memory_ack);
    if (!ack) return tl::unexpected<Error>(ack.error());
    const auto* m = std::get_if<ReadMemoryAck>(&ack->body);
    if (m == nullptr || m->address != at || m->data.size() != count) {
      return fail(ErrorCode::protocol, kWhere,
                  "the camera answered with another piece of memory than was asked for");
    }
    out.insert(out.end(), m->data.begin(), m->data.end());
  }
  return out;
}

Result<double> GigeClient::read_double(std::uint32_t address) {
  auto bytes = read_memory(address, 8);
  if (!bytes) return tl::unexpected<Error>(bytes.error());
  return load_be<double>(*bytes, 0);
}

Status GigeClient::write_double(std::uint32_t address, double value) {
  std::array<std::uint8_t, 8> bytes{};
  store_be(bytes, 0, value);
  return dropped(transact(encode_write_memory_cmd(next_id(), address, bytes), GvcpCommand::write_memory_ack));
}

Result<std::string> GigeClient::read_genicam_xml() {
  auto field = read_memory(reg::kFirstUrl, kUrlSize);
  if (!field) return tl::unexpected<Error>(field.error());
  const std::string url(field->begin(), std::find(field->begin(), field->end(), std::uint8_t{0}));
  std::uint32_t address = 0, size = 0;
  if (!parse_local_url(url, address, size) || size > kMaxXmlSize || address > 0xFFFFFFFF - size) {
    return fail(ErrorCode::protocol, kWhere,
                "expected a URL `Local:name;address;size`, got `" + device_text(url) + "`");
  }
  auto xml = read_memory(address, size);
  if (!xml) return tl::unexpected<Error>(xml.error());
  return std::string(xml->begin(), xml->end());
}

Status GigeClient::set_region(const Region& r) {
  // Offsets first to 0, so that every order of sizes fits on the way.
  const std::array<RegisterWrite, 6> steps{{{reg::kOffsetX, 0},
                                            {reg::kOffsetY, 0},
                                            {reg::kWidth, r.width_px},
                                            {reg::kHeight, r.height_px},
                                            {reg::kOffsetX, r.x_px},
                                            {reg::kOffsetY, r.y_px}}};
  for (const auto& s : steps) {
    if (auto ok = write(s.address, s.value); !ok) return ok;
  }
  return {};
}

Status GigeClient::set_pixel_format(PixelFormat f) {
  return write(reg::kPixelFormat, static_cast<std::uint32_t>(f));
}
Status GigeClient::set_exposure(Duration e) {
  return write_double(reg::kExposureTime, static_cast<double>(e.ns()) / 1e3);
}
Status GigeClient::set_gain(double gain_db) { return write_double(reg::kGain, gain_db); }
Status GigeClient::set_frame_rate(double rate_hz) { return write_double(reg::kFrameRate, rate_hz); }

Status GigeClient::set_acquisition(AcquisitionMode mode, std::uint32_t frame_count) {
  if (auto s = write(reg::kAcquisitionMode, static_cast<std::uint32_t>(mode)); !s) return s;
  return mode == AcquisitionMode::multi_frame ? write(reg::kAcquisitionFrameCount, frame_count) : Status();
}

Status GigeClient::set_software_trigger(bool on) { return write(reg::kTriggerMode, on ? 1 : 0); }

Status GigeClient::set_parts(bool range, bool amplitude) {
  const std::array<RegisterWrite, 5> steps{{{reg::kStreamConfiguration, reg::kMultipart},
                                            {reg::kComponentSelector, range ? kRange : kIntensity},
                                            {reg::kComponentEnable, 1},
                                            {reg::kComponentSelector, range ? kIntensity : kRange},
                                            {reg::kComponentEnable, range && amplitude ? 1u : 0u}}};
  for (const auto& s : steps)
    if (auto ok = write(s.address, s.value); !ok) return ok;
  parts_ = range && amplitude ? 2 : 1;
  return {};
}

Status GigeClient::start() {
  auto payload = read(reg::kPayloadSize);
  if (!payload) return tl::unexpected<Error>(payload.error());
  auto size = read(reg::kStreamPacketSize);
  if (!size) return tl::unexpected<Error>(size.error());
  auto stream = options_.stream;
  stream.payload_bytes = *payload;
  stream.packet_size = *size & 0xFFFF;
  stream.part_bytes.assign(parts_, parts_ > 0 ? *payload / parts_ : 0);
  stream.extended_ids = parts_ > 0;
  if (*payload > options_.max_payload_bytes)
    return fail(ErrorCode::protocol, kWhere,
                "expected a frame of at most " + std::to_string(options_.max_payload_bytes) +
                    " bytes, the camera says " + std::to_string(*payload));
  if (stream.packet_size < kMinPacketSize)
    return fail(ErrorCode::protocol, kWhere,
                "expected packets of at least " + std::to_string(kMinPacketSize) +
                    " bytes, the camera says " + std::to_string(stream.packet_size));
  assembler_.emplace(stream);
  return write(reg::kAcquisitionStart, 1);
}

Status GigeClient::stop() { return write(reg::kAcquisitionStop, 1); }
Status GigeClient::trigger() { return write(reg::kTriggerSoftware, 1); }

Result<GvStatus> GigeClient::action(const ActionCmd& command) {
  auto ack = ask(encode_action_cmd(next_id(), command), GvcpCommand::action_ack);
  if (!ack) return tl::unexpected<Error>(ack.error());
  return ack->status;
}

Status GigeClient::heartbeat() {
  auto privilege = read(reg::kControlPrivilege);
  if (!privilege) return tl::unexpected<Error>(privilege.error());
  if ((*privilege & (reg::kPrivilegeControl | reg::kPrivilegeExclusive)) == 0) {
    return fail(ErrorCode::wrong_state, kWhere, "control of the camera is lost; connect again");
  }
  return {};
}

bool GigeClient::poll(DeviceTime now, AssembledFrame& out) {
  while (const auto size = transport_->receive_stream(stream_buffer_)) {
    if (assembler_) assembler_->push(Bytes(stream_buffer_).first(size), now);
  }
  if (!assembler_) return false;
  for (const auto& c : assembler_->resends(now))
    transport_->send_from_stream(encode_packet_resend_cmd(next_id(), c));
  return assembler_->take(now, out);
}

GvspAssemblerCounters GigeClient::counters() const {
  return assembler_ ? assembler_->counters() : GvspAssemblerCounters{};
}

}  // namespace rigor::gige

#include "drivers/aravis/gige_device_model.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <utility>

#include "drivers/aravis/gige_genicam_xml.h"

namespace rigor::gige {
namespace {

constexpr std::uint64_t kTickFrequency = 1'000'000'000;
// Capabilities: register concatenation, WRITEMEM, packet resend, user name, serial number, controller's
// socket readable, action commands.
constexpr std::uint32_t kCapability = 0x1 | 0x2 | 0x4 | 0x08000000 | 0x40000000 | 0x80000000 |
                                      reg::kActionCapability | reg::kUnconditionalCapability |
                                      reg::kExtendedStatus;

Status check(const GigeCameraConfig& c) {
  const auto bad = [](std::string what) {
    return fail(ErrorCode::bad_input, "gige camera", std::move(what));
  };
  const auto too_long = [](const std::string& s, std::size_t field) { return s.size() >= field; };
  if (c.formats.empty()) return bad("formats: expected at least one pixel format, got none");
  for (const auto f : c.formats) {
    if (!is_known(f)) return bad("formats: got a value that is no supported PFNC format");
  }
  if (too_long(c.vendor, 32) || too_long(c.model, 32) || too_long(c.version, 32) ||
      too_long(c.manufacturer_info, 48) || too_long(c.serial, 16) || too_long(c.user_name, 16)) {
    return bad(
        "vendor, model and version take 31 bytes, manufacturer_info 47, serial and user_name 15: one is "
        "longer");
  }
  if (c.sensor_width_px == 0 || c.sensor_height_px == 0 || c.sensor_width_px > 32768 ||
      c.sensor_height_px > 32768) {
    return bad("sensor size: expected 1 … 32768 pixels, got " + std::to_string(c.sensor_width_px) + " x " +
               std::to_string(c.sensor_height_px));
  }
  if (c.width_step_px == 0 || c.height_step_px == 0 || c.offset_step_px == 0 ||
      c.sensor_width_px % c.width_step_px != 0 || c.sensor_height_px % c.height_step_px != 0 ||
      c.min_width_px % c.width_step_px != 0 || c.min_height_px % c.height_step_px != 0 ||
      c.min_width_px > c.sensor_width_px || c.min_height_px > c.sensor_height_px || c.min_width_px == 0 ||
      c.min_height_px == 0) {
    return bad(
        "region: the sensor size and the least region must be multiples of the steps, and the least region "
        "must fit the sensor");
  }
  const auto range = [](double lo, double v, double hi) {
    return std::isfinite(lo) && std::isfinite(hi) && lo <= v && v <= hi;
  };
  if (!(c.min_frame_rate_hz > 1e-3) || c.max_frame_rate_hz > 1e5 ||
      !range(c.min_frame_rate_hz, c.frame_rate_hz, c.max_frame_rate_hz)) {
    return bad("frame_rate_hz: expected 0.001 < min <= default <= max <= 100000");
  }
  if (!(c.min_exposure_us > 0) || c.max_exposure_us > 1e9 ||
      !range(c.min_exposure_us, c.exposure_us, c.max_exposure_us)) {
    return bad("exposure_us: expected 0 < min <= default <= max <= 1e9");
  }
  if (!range(c.min_gain_db, c.gain_db, c.max_gain_db)) return bad("gain_db: expected min <= default <= max");
  if (c.min_packet_size < 128 || c.min_packet_size > c.packet_size || c.packet_size > c.max_packet_size ||
      c.max_packet_size > 65000 || c.packet_size % 4 != 0 || c.max_packet_size % 4 != 0 ||
      c.min_packet_size % 4 != 0) {
    return bad("packet_size: expected multiples of 4, 128 <= min <= default <= max <= 65000");
  }
  if (c.retained_frames == 0 || c.trigger_queue == 0)
    return bad("retained_frames and trigger_queue: expected >= 1");
  if (c.line_period.ns() < 0 || (c.line_period.ns() > 0 && c.line_period < microseconds(10)))
    return bad("trigger_line: expected at most 100000 pulses a second");
  if (c.range.present && (c.formats != std::vector{PixelFormat::coord3d_c16} || !(c.range.scale_mm > 0)))
    return bad("range: expected Coord3D_C16 as the one format and a scale above 0");
  if (c.readout.ns() < 0) return bad("readout: expected no negative time");
  return {};
}

}  // namespace

std::optional<std::uint32_t> parse_ipv4(const std::string& text) {
  unsigned a = 0, b = 0, c = 0, d = 0;
  int used = 0;
  if (std::sscanf(text.c_str(), "%3u.%3u.%3u.%3u%n", &a, &b, &c, &d, &used) != 4 ||
      static_cast<std::size_t>(used) != text.size() || a > 255 || b > 255 || c > 255 || d > 255 ||
      text.find_first_not_of("0123456789.") != std::string::npos) {
    return std::nullopt;
  }
  return (a << 24) | (b << 16) | (c << 8) | d;
}

std::string ipv4_text(std::uint32_t ip) {
  return std::to_string(ip >> 24) + "." + std::to_string((ip >> 16) & 255) + "." +
         std::to_string((ip >> 8) & 255) + "." + std::to_string(ip & 255);
}

Result<GigeDeviceModel> GigeDeviceModel::create(const GigeCameraConfig& config) {
  if (auto ok = check(config); !ok) return tl::unexpected<Error>(ok.error());
  return GigeDeviceModel(config);
}

GigeDeviceModel::GigeDeviceModel(const GigeCameraConfig& config) : config_(config) {
  if (std::all_of(config_.mac.begin() + 1, config_.mac.end(), [](auto b) { return b == 0; })) {
    store_be(MutableBytes(config_.mac), 2, config_.ip);
  }
  registers_ = registers(config_);
  xml_ = make_genicam_xml(config_, registers_);
  region_ = {0, 0, config_.sensor_width_px, config_.sensor_height_px};
  format_ = config_.formats.front();
  frame_rate_hz_ = config_.frame_rate_hz;
  exposure_us_ = config_.exposure_us;
  gain_db_ = config_.gain_db;
  packet_size_ = config_.packet_size;
  build_bootstrap();
}

DiscoveryAck GigeDeviceModel::identity() const {
  DiscoveryAck d;
  d.version_major = 1;
  d.version_minor = 2;
  d.device_mode = 0x80000001;  // big-endian, UTF-8
  d.mac = config_.mac;
  d.supported_ip_configuration = d.current_ip_configuration =
      0x4;  // its address is given by the host, as link-local
  d.ip = config_.ip;
  d.mask = config_.mask;
  d.gateway = config_.gateway;
  d.manufacturer = config_.vendor;
  d.model = config_.model;
  d.version = config_.version;
  d.manufacturer_info = config_.manufacturer_info;
  d.serial = config_.serial;
  d.user_name = config_.user_name;
  return d;
}

void GigeDeviceModel::build_bootstrap() {
  // The discovery acknowledge is a copy of the first registers, so these are made from one.
  const auto ack = encode_discovery_ack(1, identity());
  std::copy_n(ack.begin() + kGvcpHeaderSize, kDiscoveryAckSize, bootstrap_.begin());
  char url[64];
  std::snprintf(url, sizeof url, "Local:rigor_gige.xml;%X;%X", reg::kXml, static_cast<unsigned>(xml_.size()));
  std::memcpy(bootstrap_.data() + reg::kFirstUrl, url, std::strlen(url));
  const MutableBytes b(bootstrap_);
  store_be(b, reg::kInterfaceCount, std::uint32_t{1});
  store_be(b, reg::kStreamChannelCount, std::uint32_t{1});
  store_be(b, reg::kActionSignalCount, std::uint32_t{1});
  // Times of actions are those of a PTP clock.
  store_be(b, reg::kGvcpCapability,
           kCapability | (config_.ptp.present ? reg::kIeee1588 | reg::kScheduledAction : 0));
  store_be(b, reg::kTickFrequencyHigh, static_cast<std::uint32_t>(kTickFrequency >> 32));
  store_be(b, reg::kTickFrequencyLow, static_cast<std::uint32_t>(kTickFrequency));
}

// ---- Control protocol
// ------------------------------------------------------------------------------------------

GvcpAnswer GigeDeviceModel::handle_gvcp(Endpoint from, Bytes datagram, DeviceTime now) {
  GvcpAnswer answer;
  GvcpRequest q;
  const auto status = decode_gvcp_request(datagram, q);
  if (status == DecodeStatus::not_gvcp) {
    ++counters_.malformed;
    return answer;
  }
  ++counters_.gvcp_requests;
  now_ = now;
  expire_heartbeat(now);
  if (is_owner(from)) last_heartbeat_ = now;
  if (status != DecodeStatus::ok) {
    ++counters_.malformed;
    const auto why =
        status == DecodeStatus::bad_alignment ? GvStatus::bad_alignment : GvStatus::invalid_header;
    if (q.ack_required())
      answer.ack = encode_ack(why, static_cast<std::uint16_t>(q.command + 1), q.request_id, {});
    return answer;
  }
  if (std::holds_alternative<PacketResendCmd>(q.body)) {
    resend(std::get<PacketResendCmd>(q.body), from, answer);
    return answer;
  }
  run_actions(now);
  // Reads may be repeated; writes and actions must not.
  const bool action = std::holds_alternative<ActionCmd>(q.body);
  const bool write =
      std::holds_alternative<WriteRegisterCmd>(q.body) || std::holds_alternative<WriteMemoryCmd>(q.body);
  LastAck& last = action ? last_action_ : last_ack_;
  if ((action || write) && last.from == from &&
      std::equal(datagram.begin(), datagram.end(), last.request.begin(), last.request.end())) {
    if (q.ack_required()) answer.ack = last.ack;
    return answer;
  }
  dispatch(q, from, now, answer);
  if (action || write) {
    last.from = from;
    last.request.assign(datagram.begin(), datagram.end());
    last.ack = answer.ack;
  }
  if (!q.ack_required()) answer.ack.clear();
  return answer;
}

void GigeDeviceModel::dispatch(const GvcpRequest& q, Endpoint from, DeviceTime now, GvcpAnswer& answer) {
  const auto refuse = [&](GvStatus s) {
    ++counters_.refused;
    answer.ack = encode_ack(s, static_cast<std::uint16_t>(q.command + 1), q.request_id, {});
  };
  if (std::holds_alternative<DiscoveryCmd>(q.body)) {
    answer.ack = encode_ack(GvStatus::success, static_cast<std::uint16_t>(GvcpCommand::discovery_ack),
                            q.request_id, Bytes(bootstrap_).first(kDiscoveryAckSize));
  } else if (const auto* r = std::get_if<ReadRegisterCmd>(&q.body)) {
    BoundedList<std::uint32_t, kGvcpMaxPayload / 4> values;
    for (const auto address : r->addresses.view()) {
      const auto s = read_u32(address, from, values.items[values.count]);
      if (s != GvStatus::success) return refuse(s);
      ++values.count;
    }
    answer.ack = encode_read_register_ack(q.request_id, values.view());
  } else if (const auto* m = std::get_if<ReadMemoryCmd>(&q.body)) {
    std::array<std::uint8_t, kGvcpMaxReadMemory> data{};
    if (m->address >= reg::kXml) {
      const std::uint64_t at = m->address - reg::kXml;
      if (at + m->count > xml_.size()) return refuse(GvStatus::invalid_address);
      std::memcpy(data.data(), xml_.data() + at, m->count);
    } else {
      for (std::uint32_t i = 0; i < m->count; i += 4) {
        std::uint32_t v = 0;
        const auto s = read_u32(m->address + i, from, v);
        if (s != GvStatus::success) return refuse(s);
        store_be(MutableBytes(data), i, v);
      }
    }
    answer.ack = encode_read_memory_ack(q.request_id, m->address, Bytes(data).first(m->count));
  } else if (const auto* w = std::get_if<WriteRegisterCmd>(&q.body)) {
    std::uint16_t done = 0;
    auto s = GvStatus::success;
    for (const auto& one : w->writes.view()) {
      std::array<std::uint8_t, 4> value{};
      store_be(value, 0, one.value);
      s = write_registers(one.address, value, from, now, answer);
      if (s != GvStatus::success) break;
      ++done;
    }
    if (s != GvStatus::success) ++counters_.refused;
    answer.ack = encode_write_ack(s, GvcpCommand::write_register_ack, q.request_id, done);
  } else if (const auto* wm = std::get_if<WriteMemoryCmd>(&q.body)) {
    const auto s = write_registers(wm->address, wm->data, from, now, answer);
    if (s != GvStatus::success) ++counters_.refused;
    const auto done = s == GvStatus::success ? static_cast<std::uint16_t>(wm->data.size()) : std::uint16_t{0};
    answer.ack = encode_write_ack(s, GvcpCommand::write_memory_ack, q.request_id, done);
  } else if (const auto* a = std::get_if<ActionCmd>(&q.body)) {
    if (const auto s = act(*a, now)) {
      // Codes that version 2.0 added are for clients that know them.
      const bool plain = *s > GvStatus::invalid_header && (gvcp_configuration_ & reg::kExtendedStatus) == 0;
      answer.ack = encode_ack(plain ? GvStatus::error : *s,
                              static_cast<std::uint16_t>(GvcpCommand::action_ack), q.request_id, {});
      answer.schedule_changed = true;
    }
  } else {
    refuse(GvStatus::not_implemented);
  }
}

void GigeDeviceModel::resend(const PacketResendCmd& c, Endpoint from, GvcpAnswer& answer) {
  ++counters_.resend_requests;
  // The receiver of the stream asks from its own socket; nobody else may make us send.
  const bool ours = stream_port_ != 0 && (from.ip == stream_ip_ || (privilege_ != 0 && from.ip == owner_.ip));
  if (!ours || c.stream_channel != 0 || c.extended_ids != multipart_) {
    ++counters_.refused;
    return;
  }
  ResendJob job;
  job.to = stream_destination();
  job.block_id = c.block_id;
  job.extended_ids = c.extended_ids;
  job.first = c.first_packet;
  const auto at = std::find_if(retained_.begin(), retained_.end(),
                               [&](const auto& b) { return b->block_id == c.block_id; });
  if (at == retained_.end() || c.first_packet >= (*at)->packet_count()) {
    ++counters_.resend_unavailable;
    job.last = job.first;
  } else {
    job.block = *at;
    job.last = std::min(c.last_packet, (*at)->packet_count() - 1);
    counters_.resend_packets += job.last - job.first + 1;
  }
  answer.resend = std::move(job);
}

bool GigeDeviceModel::expire_heartbeat(DeviceTime now) {
  if (privilege_ == 0 || now - last_heartbeat_ <= milliseconds(heartbeat_timeout_ms_)) return false;
  ++counters_.heartbeat_expired;
  release_control();
  return true;
}

void GigeDeviceModel::release_control() {
  privilege_ = 0;
  owner_ = {};
  stop_acquisition();
  open_stream(0);
  tl_params_locked_ = 0;
  actions_.clear();
}

}  // namespace rigor::gige

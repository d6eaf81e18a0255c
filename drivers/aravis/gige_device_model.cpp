#include "drivers/aravis/gige_device_model.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <utility>

#include "drivers/aravis/gige_genicam_xml.h"

namespace rigor::gige {
namespace {

constexpr std::uint32_t kMinHeartbeatMs = 500;
constexpr std::uint32_t kMaxHeartbeatMs = 3'600'000;
constexpr std::uint32_t kMaxPacketDelayTicks = 10'000'000;
constexpr std::uint64_t kTickFrequency = 1'000'000'000;
constexpr std::size_t kUserNameSize = 16;

// Capabilities: register concatenation, WRITEMEM, packet resend, user name, serial number, controller's
// socket readable.
constexpr std::uint32_t kCapability = 0x1 | 0x2 | 0x4 | 0x08000000 | 0x40000000 | 0x80000000;

constexpr bool in(std::uint32_t a, std::uint32_t from, std::uint32_t end) { return a >= from && a < end; }

/// Registers that exist in bootstrap space; what is reserved between them reads as 0.
constexpr bool bootstrap_exists(std::uint32_t a) {
  return in(a, 0, 0xF8) || in(a, reg::kFirstUrl, 0x670) || in(a, 0x900, 0x960) || in(a, 0xA00, 0xA18) ||
         in(a, 0xD00, 0xD28);
}

bool is_double(std::uint32_t a) {
  return a == reg::kFrameRate || a == reg::kResultingFrameRate || a == reg::kExposureTime || a == reg::kGain;
}

bool read_only(std::uint32_t a) {
  if (a < reg::kBootstrapEnd) {
    return !in(a, reg::kUserName, reg::kUserName + kUserNameSize) && a != reg::kHeartbeatTimeout &&
           a != reg::kTimestampControl && a != reg::kControlPrivilege && a != reg::kStreamPort &&
           a != reg::kStreamPacketSize && a != reg::kStreamPacketDelay && a != reg::kStreamDestination;
  }
  return a == reg::kWidthMax || a == reg::kHeightMax || a == reg::kPayloadSize ||
         a == reg::kResultingFrameRate || a == reg::kResultingFrameRate + 4 || a == reg::kAcquisitionActive;
}

DeviceTime max_of(DeviceTime a, DeviceTime b) { return a < b ? b : a; }

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
      c.min_width_px > c.sensor_width_px || c.min_height_px > c.sensor_height_px || c.min_width_px == 0 ||
      c.min_height_px == 0) {
    return bad("region: the sensor size must be a multiple of the steps, and the least region must fit it");
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
  xml_ = make_genicam_xml(config_);
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
  store_be(b, reg::kGvcpCapability, kCapability);
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
  if (last_ack_.from == from &&
      std::equal(datagram.begin(), datagram.end(), last_ack_.request.begin(), last_ack_.request.end())) {
    if (q.ack_required()) answer.ack = last_ack_.ack;
    return answer;
  }
  dispatch(q, from, now, answer);
  // Reads may be repeated; writes must not.
  if (std::holds_alternative<WriteRegisterCmd>(q.body) || std::holds_alternative<WriteMemoryCmd>(q.body)) {
    last_ack_.from = from;
    last_ack_.request.assign(datagram.begin(), datagram.end());
    last_ack_.ack = answer.ack;
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
      s = write_u32(one.address, one.value, from, now, answer);
      if (s != GvStatus::success) break;
      ++done;
    }
    if (s != GvStatus::success) ++counters_.refused;
    answer.ack = encode_write_ack(s, GvcpCommand::write_register_ack, q.request_id, done);
  } else if (const auto* wm = std::get_if<WriteMemoryCmd>(&q.body)) {
    const auto s = write_memory(*wm, from, now, answer);
    if (s != GvStatus::success) ++counters_.refused;
    const auto done = s == GvStatus::success ? static_cast<std::uint16_t>(wm->data.size()) : std::uint16_t{0};
    answer.ack = encode_write_ack(s, GvcpCommand::write_memory_ack, q.request_id, done);
  } else {
    refuse(GvStatus::not_implemented);
  }
}

void GigeDeviceModel::resend(const PacketResendCmd& c, Endpoint from, GvcpAnswer& answer) {
  ++counters_.resend_requests;
  // The receiver of the stream asks from its own socket; nobody else may make us send.
  const bool ours = stream_port_ != 0 && (from.ip == stream_ip_ || (privilege_ != 0 && from.ip == owner_.ip));
  if (!ours || c.stream_channel != 0 || c.extended_ids) {
    ++counters_.refused;
    return;
  }
  ResendJob job;
  job.to = stream_destination();
  job.block_id = c.block_id;
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
}

// ---- Registers
// -------------------------------------------------------------------------------------------------

GvStatus GigeDeviceModel::read_u32(std::uint32_t address, Endpoint from, std::uint32_t& value) const {
  const bool exclusive = (privilege_ & reg::kPrivilegeExclusive) != 0;
  if (exclusive && !is_owner(from) && address != reg::kControlPrivilege) return GvStatus::access_denied;
  value = 0;
  const auto half_double = [address](double v) {
    const auto bits = std::bit_cast<std::uint64_t>(v);
    return static_cast<std::uint32_t>((address & 4) != 0 ? bits : bits >> 32);
  };
  switch (address) {
    case reg::kHeartbeatTimeout:
      value = heartbeat_timeout_ms_;
      return GvStatus::success;
    case reg::kTimestampControl:
      return GvStatus::success;
    case reg::kTimestampHigh:
      value = static_cast<std::uint32_t>(latched_ticks_ >> 32);
      return GvStatus::success;
    case reg::kTimestampLow:
      value = static_cast<std::uint32_t>(latched_ticks_);
      return GvStatus::success;
    case reg::kControlPrivilege:
      value = privilege_;
      return GvStatus::success;
    case reg::kPrimaryPort:
      value = owner_.port;
      return GvStatus::success;
    case reg::kPrimaryIp:
      value = owner_.ip;
      return GvStatus::success;
    case reg::kStreamPort:
      value = stream_port_;
      return GvStatus::success;
    case reg::kStreamPacketSize:
      value = packet_size_ | (do_not_fragment_ ? reg::kDoNotFragment : 0);
      return GvStatus::success;
    case reg::kStreamPacketDelay:
      value = packet_delay_ticks_;
      return GvStatus::success;
    case reg::kStreamDestination:
      value = stream_ip_;
      return GvStatus::success;
    case reg::kStreamSourcePort:
      value = stream_source_port_;
      return GvStatus::success;
    case reg::kWidthMax:
      value = config_.sensor_width_px;
      return GvStatus::success;
    case reg::kHeightMax:
      value = config_.sensor_height_px;
      return GvStatus::success;
    case reg::kWidth:
      value = region_.width_px;
      return GvStatus::success;
    case reg::kHeight:
      value = region_.height_px;
      return GvStatus::success;
    case reg::kOffsetX:
      value = region_.x_px;
      return GvStatus::success;
    case reg::kOffsetY:
      value = region_.y_px;
      return GvStatus::success;
    case reg::kPixelFormat:
      value = static_cast<std::uint32_t>(format_);
      return GvStatus::success;
    case reg::kPayloadSize:
      value = static_cast<std::uint32_t>(payload_bytes(region_, format_));
      return GvStatus::success;
    case reg::kAcquisitionMode:
      value = mode_;
      return GvStatus::success;
    case reg::kAcquisitionFrameCount:
      value = frame_count_;
      return GvStatus::success;
    case reg::kAcquisitionStart:
    case reg::kAcquisitionStop:
    case reg::kAcquisitionAbort:
    case reg::kTriggerSoftware:
      return GvStatus::success;  // a command that reads 0 is done
    case reg::kFrameRateEnable:
      value = frame_rate_enable_;
      return GvStatus::success;
    case reg::kFrameRate:
    case reg::kFrameRate + 4:
      value = half_double(frame_rate_hz_);
      return GvStatus::success;
    case reg::kResultingFrameRate:
    case reg::kResultingFrameRate + 4:
      value = half_double(1.0 / period().seconds());
      return GvStatus::success;
    case reg::kAcquisitionActive:
      value = acquiring_ ? 1 : 0;
      return GvStatus::success;
    case reg::kTlParamsLocked:
      value = params_locked() ? 1 : 0;
      return GvStatus::success;
    case reg::kExposureTime:
    case reg::kExposureTime + 4:
      value = half_double(exposure_us_);
      return GvStatus::success;
    case reg::kGain:
    case reg::kGain + 4:
      value = half_double(gain_db_);
      return GvStatus::success;
    case reg::kTriggerMode:
      value = trigger_mode_;
      return GvStatus::success;
    case reg::kTriggerSource:
      value = reg::kTriggerSourceSoftware;
      return GvStatus::success;
    default:
      if (!bootstrap_exists(address)) return GvStatus::invalid_address;
      value = load_be<std::uint32_t>(bootstrap_, address);
      return GvStatus::success;
  }
}

GvStatus GigeDeviceModel::write_u32(std::uint32_t address, std::uint32_t value, Endpoint from, DeviceTime now,
                                    GvcpAnswer& answer) {
  std::uint32_t ignored = 0;
  if (read_u32(address, from, ignored) == GvStatus::invalid_address) return GvStatus::invalid_address;
  if (address == reg::kControlPrivilege) return write_privilege(value, from, now, answer);
  if (!is_owner(from)) return GvStatus::access_denied;
  if (read_only(address)) return GvStatus::write_protect;
  if (is_double(address) || is_double(address - 4))
    return GvStatus::invalid_parameter;  // half a number is none
  return address < reg::kBootstrapEnd ? write_bootstrap(address, value, now, answer)
                                      : write_feature(address, value, now, answer);
}

GvStatus GigeDeviceModel::write_privilege(std::uint32_t value, Endpoint from, DeviceTime now,
                                          GvcpAnswer& answer) {
  if (privilege_ != 0 && !is_owner(from)) return GvStatus::access_denied;
  const std::uint32_t wanted = value & (reg::kPrivilegeControl | reg::kPrivilegeExclusive);
  answer.schedule_changed = true;
  if (wanted == 0) {
    release_control();
    return GvStatus::success;
  }
  if (privilege_ == 0) ++counters_.control_taken;
  privilege_ = wanted;
  owner_ = from;
  last_heartbeat_ = now;
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_packet_size(std::uint32_t value, GvcpAnswer& answer) {
  if (params_locked()) return GvStatus::access_denied;
  // A size that we cannot do becomes the nearest that we can; the client reads back which.
  packet_size_ = std::clamp(value & 0xFFFC, config_.min_packet_size, config_.max_packet_size);
  do_not_fragment_ = (value & reg::kDoNotFragment) != 0;
  if ((value & reg::kFireTestPacket) != 0 && stream_port_ != 0) {
    answer.test_packet = TestPacket{stream_destination(), packet_size_, do_not_fragment_};
  }
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_bootstrap(std::uint32_t address, std::uint32_t value, DeviceTime now,
                                          GvcpAnswer& answer) {
  switch (address) {
    case reg::kHeartbeatTimeout:
      heartbeat_timeout_ms_ = std::clamp(value, kMinHeartbeatMs, kMaxHeartbeatMs);
      return GvStatus::success;
    case reg::kTimestampControl:
      if ((value & reg::kTimestampLatch) != 0) latched_ticks_ = ticks(now);
      if ((value & reg::kTimestampReset) != 0) timestamp_zero_ = now;
      return GvStatus::success;
    case reg::kStreamPort:
      if ((value >> 28) != 0) return GvStatus::invalid_parameter;  // there is one interface, number 0
      open_stream(static_cast<std::uint16_t>(value));
      return GvStatus::success;
    case reg::kStreamPacketSize:
      return write_packet_size(value, answer);
    case reg::kStreamPacketDelay:
      if (value > kMaxPacketDelayTicks) return GvStatus::invalid_parameter;
      packet_delay_ticks_ = value;
      return GvStatus::success;
    case reg::kStreamDestination:
      if (acquiring_) return GvStatus::access_denied;
      stream_ip_ = value;
      return GvStatus::success;
    default:
      if (in(address, reg::kUserName, reg::kUserName + kUserNameSize)) {
        store_be(MutableBytes(bootstrap_), address, value);
        return GvStatus::success;
      }
      return GvStatus::write_protect;
  }
}

void GigeDeviceModel::open_stream(std::uint16_t port) {
  if (port == stream_port_) return;
  stream_port_ = port;
  // A receiver counts blocks from the opening of its stream; an old block must not answer for a new one. They
  // are not counted from AcquisitionStart: a receiver that stays open would take the second acquisition for
  // late packets.
  next_block_id_ = 1;
  retained_.clear();
  ++epoch_;
}

GvStatus GigeDeviceModel::write_region(std::uint32_t address, std::uint32_t value) {
  if (params_locked()) return GvStatus::access_denied;
  Region r = region_;
  std::uint32_t step = config_.offset_step_px;
  std::uint32_t least = 0;
  switch (address) {
    case reg::kWidth:
      r.width_px = value, step = config_.width_step_px, least = config_.min_width_px;
      break;
    case reg::kHeight:
      r.height_px = value, step = config_.height_step_px, least = config_.min_height_px;
      break;
    case reg::kOffsetX:
      r.x_px = value;
      break;
    default:
      r.y_px = value;
      break;
  }
  const auto fits = [](std::uint64_t offset, std::uint64_t size, std::uint64_t whole) {
    return offset + size <= whole;
  };
  if (value < least || value % step != 0 || !fits(r.x_px, r.width_px, config_.sensor_width_px) ||
      !fits(r.y_px, r.height_px, config_.sensor_height_px)) {
    return GvStatus::invalid_parameter;
  }
  region_ = r;
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_feature(std::uint32_t address, std::uint32_t value, DeviceTime now,
                                        GvcpAnswer& answer) {
  answer.schedule_changed = true;
  switch (address) {
    case reg::kWidth:
    case reg::kHeight:
    case reg::kOffsetX:
    case reg::kOffsetY:
      return write_region(address, value);
    case reg::kPixelFormat: {
      if (params_locked()) return GvStatus::access_denied;
      const auto f = static_cast<PixelFormat>(value);
      if (std::find(config_.formats.begin(), config_.formats.end(), f) == config_.formats.end()) {
        return GvStatus::invalid_parameter;
      }
      format_ = f;
      return GvStatus::success;
    }
    case reg::kAcquisitionMode:
      if (params_locked()) return GvStatus::access_denied;
      if (value > reg::kModeMultiFrame) return GvStatus::invalid_parameter;
      mode_ = value;
      return GvStatus::success;
    case reg::kAcquisitionFrameCount:
      if (params_locked()) return GvStatus::access_denied;
      if (value < 1 || value > 65535) return GvStatus::invalid_parameter;
      frame_count_ = value;
      return GvStatus::success;
    case reg::kAcquisitionStart:
      if (!acquiring_ && value != 0) start_acquisition(now);
      return GvStatus::success;
    case reg::kAcquisitionStop:
    case reg::kAcquisitionAbort:
      if (value != 0) stop_acquisition();
      return GvStatus::success;
    case reg::kFrameRateEnable:
      if (value > 1) return GvStatus::invalid_parameter;
      frame_rate_enable_ = value;
      return GvStatus::success;
    case reg::kTlParamsLocked:
      if (value > 1) return GvStatus::invalid_parameter;
      tl_params_locked_ = value;
      return GvStatus::success;
    case reg::kTriggerMode:
      if (value > 1) return GvStatus::invalid_parameter;
      if (trigger_mode_ != value) triggers_.clear();
      trigger_mode_ = value;
      if (value == 0) next_free_run_ = on_grid(max_of(next_free_run_, max_of(now, sensor_free_)));
      return GvStatus::success;
    case reg::kTriggerSource:
      return value == reg::kTriggerSourceSoftware ? GvStatus::success : GvStatus::invalid_parameter;
    case reg::kTriggerSoftware:
      return value == 0 ? GvStatus::success : software_trigger(now);
    default:
      return GvStatus::write_protect;
  }
}

GvStatus GigeDeviceModel::write_double(std::uint32_t address, double value, DeviceTime now,
                                       GvcpAnswer& answer) {
  const auto set = [value](double lo, double hi, double& target) {
    if (!(value >= lo && value <= hi)) return GvStatus::invalid_parameter;
    target = value;
    return GvStatus::success;
  };
  answer.schedule_changed = true;
  const Duration before = period();
  GvStatus s = GvStatus::write_protect;
  if (address == reg::kFrameRate)
    s = set(config_.min_frame_rate_hz, config_.max_frame_rate_hz, frame_rate_hz_);
  if (address == reg::kExposureTime) s = set(config_.min_exposure_us, config_.max_exposure_us, exposure_us_);
  if (address == reg::kGain) s = set(config_.min_gain_db, config_.max_gain_db, gain_db_);
  if (acquiring_ && index_ > 0 && period() != before) {
    // The frame in progress keeps its place and is exposed to its end; the next one comes a new period behind
    // it.
    next_free_run_ = on_grid(max_of(max_of(next_free_run_ - before + period(), sensor_free_), now));
  }
  return s;
}

GvStatus GigeDeviceModel::write_memory(const WriteMemoryCmd& c, Endpoint from, DeviceTime now,
                                       GvcpAnswer& answer) {
  if (c.data.size() == 8 && is_double(c.address)) {
    if (!is_owner(from)) return GvStatus::access_denied;
    if (read_only(c.address)) return GvStatus::write_protect;
    return write_double(c.address, load_be_double(c.data, 0), now, answer);
  }
  const std::uint64_t end = std::uint64_t{c.address} + c.data.size();
  if (end > 0xFFFFFFFF) return GvStatus::invalid_address;
  // Everything is checked before anything is written, except where a value itself is refused.
  for (std::uint32_t i = 0; i < c.data.size(); i += 4) {
    std::uint32_t ignored = 0;
    if (c.address + i >= reg::kXml && c.address + i < reg::kXml + xml_.size()) {
      return is_owner(from) ? GvStatus::write_protect : GvStatus::access_denied;
    }
    if (read_u32(c.address + i, from, ignored) == GvStatus::invalid_address) return GvStatus::invalid_address;
    if (!is_owner(from)) return GvStatus::access_denied;
    if (read_only(c.address + i)) return GvStatus::write_protect;
  }
  for (std::uint32_t i = 0; i < c.data.size(); i += 4) {
    const auto s = write_u32(c.address + i, load_be<std::uint32_t>(c.data, i), from, now, answer);
    if (s != GvStatus::success) return s;
  }
  return GvStatus::success;
}

// ---- Acquisition
// -----------------------------------------------------------------------------------------------

std::uint64_t GigeDeviceModel::ticks(DeviceTime t) const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, (t - timestamp_zero_).ns()));
}

Duration GigeDeviceModel::period() const {
  // Exposure and readout overlap, as in a global-shutter sensor: the longer of the two times sets the rate.
  const double rate = frame_rate_enable_ != 0 ? frame_rate_hz_ : config_.max_frame_rate_hz;
  return seconds_from(std::max(1.0 / rate, exposure_us_ * 1e-6));
}

void GigeDeviceModel::start_acquisition(DeviceTime now) {
  acquiring_ = true;
  ++epoch_;
  index_ = 0;
  triggers_.clear();
  frames_left_.reset();
  if (mode_ == reg::kModeSingleFrame) frames_left_ = 1;
  if (mode_ == reg::kModeMultiFrame) frames_left_ = frame_count_;
  sensor_free_ = now;
  next_free_run_ = on_grid(now);
}

DeviceTime GigeDeviceModel::on_grid(DeviceTime t) const {
  if (!config_.align_to_clock) return t;
  const std::int64_t p = period().ns();
  const std::int64_t k = t.ns() / p;
  return DeviceTime((k * p < t.ns() ? k + 1 : k) * p);
}

void GigeDeviceModel::stop_acquisition() {
  acquiring_ = false;
  ++epoch_;
  triggers_.clear();
}

GvStatus GigeDeviceModel::software_trigger(DeviceTime now) {
  if (!acquiring_ || trigger_mode_ == 0) {
    ++counters_.triggers_refused;
    return GvStatus::access_denied;
  }
  if (triggers_.size() >= config_.trigger_queue) {
    ++counters_.triggers_refused;
    return GvStatus::busy;
  }
  ++counters_.triggers;
  triggers_.push_back(now);
  return GvStatus::success;
}

DeviceTime GigeDeviceModel::next_exposure() const {
  if (!acquiring_) return DeviceTime::never();
  if (trigger_mode_ == 0) return next_free_run_;
  return triggers_.empty() ? DeviceTime::never() : max_of(triggers_.front(), sensor_free_);
}

std::shared_ptr<GvspBlock> GigeDeviceModel::new_block() {
  for (auto& b : pool_) {
    if (b.use_count() == 1) return b;
  }
  pool_.push_back(std::make_shared<GvspBlock>());
  return pool_.back();
}

bool GigeDeviceModel::begin_frame(DeviceTime now, FrameJob& job) {
  DeviceTime start = next_exposure();
  if (start > now) return false;
  const Duration p = period();
  if (trigger_mode_ == 0) {
    const std::int64_t behind = (now - start) / p;
    if (behind > 0) {
      counters_.exposures_skipped += static_cast<std::uint64_t>(behind);
      index_ += static_cast<std::uint64_t>(behind);
      start = start + p * behind;
    }
    next_free_run_ = start + p;
  } else {
    triggers_.pop_front();
  }
  const Duration exposure = seconds_from(exposure_us_ * 1e-6);
  sensor_free_ = start + exposure;
  job.request = {index_++, start, ticks(start), exposure, gain_db_, region_, format_};
  job.t_send = start + exposure + config_.readout;
  job.epoch = epoch_;
  job.block = new_block();
  job.block->data.resize(payload_bytes(region_, format_));
  job.block->packet_size = packet_size_;
  job.block->leader = {1, job.request.timestamp_ticks, format_, region_, 0, 0};
  return true;
}

std::optional<OutgoingBlock> GigeDeviceModel::finish_frame(FrameJob&& job, bool filled) {
  const auto block = std::move(job.block);
  if (!acquiring_ || job.epoch != epoch_ || block == nullptr) return std::nullopt;
  if (!filled) {
    ++counters_.pictures_missing;
    return std::nullopt;
  }
  if (frames_left_ && --*frames_left_ == 0) {
    acquiring_ = false;
    triggers_.clear();
  }
  if (stream_port_ == 0) return std::nullopt;
  ++counters_.frames;
  block->block_id = next_block_id_;
  next_block_id_ =
      next_block_id_ == 0xFFFF ? std::uint16_t{1} : static_cast<std::uint16_t>(next_block_id_ + 1);
  retained_.push_back(block);
  while (retained_.size() > config_.retained_frames) retained_.pop_front();
  return OutgoingBlock{block, job.t_send, stream_destination(), nanoseconds(packet_delay_ticks_)};
}

}  // namespace rigor::gige

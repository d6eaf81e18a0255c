#include "drivers/aravis/u3v_camera.h"

#include <algorithm>
#include <utility>

#include "drivers/aravis/u3v_genicam_xml.h"
#include "rt-core/byte_order.h"

namespace rigor::u3v {
namespace {

// Capabilities (GenCP 1.2, device capability): user name, timestamp, family name, SBRM, endianness registers,
// the written length in the acknowledge of WRITEMEM.
constexpr std::uint64_t kCapability = 0x1 | 0x8 | 0x100 | 0x200 | 0x400 | 0x800;
constexpr std::uint32_t kSchemaVersion = 0x01010000;  // GenApi 1.1; a device's description, not compressed
constexpr std::uint32_t kFileVersion = 0x01000000;
constexpr std::size_t kMostEvents = 64;

std::vector<std::uint8_t> manifest_of(const std::string& xml) {
  std::vector<std::uint8_t> m;
  append_le(m, std::uint64_t{1});
  append_le(m, kFileVersion);
  append_le(m, kSchemaVersion);
  append_le(m, reg::kXml);
  append_le(m, std::uint64_t{xml.size()});
  m.resize(reg::kManifestBytes);
  return m;
}

}  // namespace

Result<Camera> Camera::create(const CameraOptions& options) {
  const auto bad = [](const char* what) { return fail(ErrorCode::bad_input, "usb3vision camera", what); };
  if (options.camera.range.present)
    return bad(
        "expected the sensor of a camera that gives pictures: a 3D camera sends several parts, and Aravis "
        "takes the first alone over USB; leave `as` out");
  if (options.camera.ptp.present) return bad("expected no `ptp`: USB has no PTP clock; leave this key out");
  if (options.response_ms < 1 || options.response_ms > 60'000 || options.start_delay.ns() < 0 ||
      options.start_delay > seconds(60))
    return bad("expected a response time of 1 ms to 60 s, and a start of at most 60 s");
  // Sensor, region, formats and limits are checked where a GigE Vision camera's are.
  if (auto same = gige::GigeDeviceModel::create(options.camera); !same)
    return tl::unexpected<Error>(same.error());
  return Camera(options);
}

Camera::Camera(const CameraOptions& options)
    : options_(options),
      xml_(std::make_shared<const std::string>(make_genicam_xml(options.camera))),
      manifest_(std::make_shared<const std::vector<std::uint8_t>>(manifest_of(*xml_))),
      schedule_(options.camera.align_to_clock, {options.camera.line_period, options.camera.line_phase}) {
  power_on();
}

void Camera::power_on() {
  const gige::GigeCameraConfig& c = options_.camera;
  state_ = {};
  state_.vendor = c.vendor, state_.model = c.model, state_.version = c.version;
  state_.info = c.manufacturer_info, state_.serial = c.serial, state_.user_name = c.user_name;
  state_.capability = kCapability;
  state_.response_ms = options_.response_ms;
  state_.sensor_width = state_.width = c.sensor_width_px;
  state_.sensor_height = state_.height = c.sensor_height_px;
  state_.pixel_format = static_cast<std::uint32_t>(c.formats.front());
  state_.rate_hz = c.frame_rate_hz, state_.exposure_us = c.exposure_us, state_.gain_db = c.gain_db;
  ++epoch_;
  next_block_ = 0;
  frames_left_.reset();
  events_.clear();
  schedule_.stop();
  set_schedule(DeviceTime(0));
}

void Camera::handle(Bytes command, DeviceTime now, std::vector<TimedAck>& acks) {
  Request q;
  const Decoded decoded = decode_request(command, q);
  if (decoded == Decoded::not_u3v) {
    ++counters_.malformed;
    return;
  }
  ++counters_.commands;
  // An acknowledge's command is the one behind the command's.
  Ack ack{Status::success, static_cast<std::uint16_t>(q.command | 1), q.request_id, {}};
  DeviceTime due = now;
  if (decoded != Decoded::ok) {
    if (decoded == Decoded::bad_length) ++counters_.malformed;
    ack.status = decoded == Decoded::bad_length ? Status::invalid_header : Status::not_implemented;
  } else if (command.size() > state_.max_command ||
             (q.data.empty() && q.count > state_.max_ack - kHeaderBytes)) {
    ack.status = Status::invalid_parameter;
  } else if (q.data.empty()) {
    ack.data.resize(q.count);
    ack.status = read(q.address, ack.data, now);
    if (ack.status != Status::success) ack.data.clear();
  } else {
    const bool was_acquiring = state_.acquiring != 0;
    ack.status = write(q.address, q.data, now);
    if (ack.status == Status::success) ack.data = reserved_and(static_cast<std::uint16_t>(q.data.size()));
    if (!was_acquiring && state_.acquiring != 0) due = now + options_.start_delay;
  }
  if (ack.status != Status::success) ++counters_.refused;
  if (!q.ack_wanted) return;
  if (due - now > milliseconds(options_.response_ms)) {
    const auto wait_ms = (due - now).ns() / 1'000'000 + options_.response_ms;
    acks.push_back(
        {now,
         encode_ack({Status::success, static_cast<std::uint16_t>(Command::pending_ack), q.request_id,
                     reserved_and(static_cast<std::uint16_t>(std::min<std::int64_t>(wait_ms, 0xFFFF)))})});
  }
  acks.push_back({due, encode_ack(ack)});
}

Period Camera::period() const {
  // Exposure and readout overlap, as in a global-shutter sensor: the longer of the two times sets the rate.
  const double rate = state_.rate_enable != 0 ? state_.rate_hz : options_.camera.max_frame_rate_hz;
  const Period frame = Period::of_hz(rate), exposure = seconds_from(state_.exposure_us * 1e-6);
  return exposure > frame ? exposure : frame;
}

void Camera::set_schedule(DeviceTime now) {
  using Trigger = ExposureSchedule::Trigger;
  ExposureSchedule::Settings s;
  s.trigger = state_.trigger_mode == 0                               ? Trigger::free_run
              : state_.trigger_source == reg::kTriggerSourceSoftware ? Trigger::software
                                                                     : Trigger::line;
  s.period = period();
  s.delay = seconds_from(state_.trigger_delay_us * 1e-6);
  s.falling_edge = state_.trigger_activation == reg::kFallingEdge;
  schedule_.set(s, now);
}

void Camera::start_acquisition(DeviceTime now) {
  state_.acquiring = 1;
  ++epoch_;
  next_block_ = 0;
  frames_left_.reset();
  if (state_.acquisition_mode == reg::kModeSingleFrame) frames_left_ = 1;
  if (state_.acquisition_mode == reg::kModeMultiFrame) frames_left_ = state_.frame_count;
  schedule_.start(now + options_.start_delay);
}

void Camera::stop_acquisition() {
  state_.acquiring = 0;
  ++epoch_;
  schedule_.stop();
}

void Camera::raise_event(std::uint16_t id, DeviceTime t) {
  if ((state_.event_control & reg::kEventEnable) == 0 || events_.size() >= kMostEvents) return;
  events_.push_back(
      encode_event({id, next_event_++, static_cast<std::uint64_t>(std::max<std::int64_t>(0, t.ns()))}));
}

std::vector<std::vector<std::uint8_t>> Camera::take_events() { return std::exchange(events_, {}); }

std::shared_ptr<std::vector<std::uint8_t>> Camera::new_payload() {
  for (auto& p : pool_)
    if (p.use_count() == 1) return p;
  return pool_.emplace_back(std::make_shared<std::vector<std::uint8_t>>());
}

bool Camera::begin_frame(DeviceTime now, FrameJob& job) {
  const Duration exposure = seconds_from(state_.exposure_us * 1e-6);
  const auto e = schedule_.begin(now, exposure);
  if (!e) return false;
  const auto format = static_cast<PixelFormat>(state_.pixel_format);
  job.request = {};
  job.request.index = e->index;
  job.request.t_exposure_start = e->start;
  job.request.timestamp_ticks = static_cast<std::uint64_t>(std::max<std::int64_t>(0, e->start.ns()));
  job.request.exposure = exposure;
  job.request.gain_db = state_.gain_db;
  job.request.region = region();
  job.request.format = format;
  job.t_send = e->start + exposure + options_.camera.readout;
  job.epoch = epoch_;
  job.payload = new_payload();
  job.payload->resize(static_cast<std::size_t>(gige::payload_bytes(region(), format)));
  if (state_.event_notification != 0) raise_event(kExposureStartEvent, e->start);
  return true;
}

std::optional<Frame> Camera::finish_frame(FrameJob&& job, bool filled) {
  const auto payload = std::move(job.payload);
  if (state_.acquiring == 0 || job.epoch != epoch_ || payload == nullptr) return std::nullopt;
  if (!filled) {
    ++counters_.pictures_missing;
    return std::nullopt;
  }
  Frame f;
  f.block_id = next_block_++;
  f.t_send = job.t_send;
  if (frames_left_ && --*frames_left_ == 0) {
    state_.acquiring = 0;
    schedule_.stop();
  }
  f.epoch = epoch_;
  if (!streaming()) return std::nullopt;
  std::size_t at = 0;
  const auto transfer = [&](std::uint32_t bytes) {
    const std::size_t n = std::min<std::size_t>(bytes, payload->size() - at);
    if (n > 0) f.transfers.push_back({at, n});
    at += n;
  };
  for (std::uint32_t i = 0; i < state_.transfer_count && state_.transfer_size > 0 && at < payload->size();
       ++i)
    transfer(state_.transfer_size);
  transfer(state_.final_transfer1);
  transfer(state_.final_transfer2);
  const bool whole = at == payload->size();
  if (!whole) ++counters_.truncated;
  f.leader = encode_leader({f.block_id, job.request.timestamp_ticks, job.request.format, job.request.region});
  f.trailer = encode_trailer(
      {f.block_id, at, whole ? Status::success : Status::data_discarded, job.request.region.height_px});
  f.payload = payload;
  ++counters_.frames;
  return f;
}

}  // namespace rigor::u3v

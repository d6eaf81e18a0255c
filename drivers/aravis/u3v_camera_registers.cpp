// Registers of the emulated USB3 Vision camera: where each is, what it reads, and what a write changes.
#include <algorithm>
#include <array>
#include <cstring>
#include <variant>

#include "drivers/aravis/u3v_camera.h"
#include "rt-core/byte_order.h"

namespace rigor::u3v {
namespace {

enum class Access : std::uint8_t { ro, rw, wo };
using Slot = std::variant<std::uint32_t CameraState::*, std::uint64_t CameraState::*, double CameraState::*,
                          std::string CameraState::*>;

struct Register {
  reg::Address address;
  Access access;
  Slot slot;

  [[nodiscard]] constexpr std::size_t bytes() const {
    constexpr std::array<std::size_t, 4> kBytes{4, 8, 8, reg::kTextBytes};
    return kBytes[slot.index()];
  }
  [[nodiscard]] constexpr reg::Address end() const { return address + bytes(); }
};

using S = CameraState;
/// By address. What lies between two registers of a block reads as 0.
constexpr std::array kRegisters = {
    Register{reg::kGenCpVersion, Access::ro, &S::gencp_version},
    Register{reg::kManufacturerName, Access::ro, &S::vendor},
    Register{reg::kModelName, Access::ro, &S::model},
    Register{reg::kFamilyName, Access::ro, &S::family},
    Register{reg::kDeviceVersion, Access::ro, &S::version},
    Register{reg::kManufacturerInfo, Access::ro, &S::info},
    Register{reg::kSerialNumber, Access::ro, &S::serial},
    Register{reg::kUserName, Access::rw, &S::user_name},
    Register{reg::kDeviceCapability, Access::ro, &S::capability},
    Register{reg::kMaxResponseTime, Access::ro, &S::response_ms},
    Register{reg::kManifestAddress, Access::ro, &S::manifest_address},
    Register{reg::kSbrmAddress, Access::ro, &S::sbrm_address},
    Register{reg::kDeviceConfiguration, Access::rw, &S::configuration},
    Register{reg::kHeartbeatTimeout, Access::ro, &S::heartbeat_ms},
    Register{reg::kMessageChannel, Access::ro, &S::message_channel},
    Register{reg::kTimestamp, Access::ro, &S::timestamp_ns},
    Register{reg::kTimestampLatch, Access::wo, &S::command},
    Register{reg::kTimestampIncrement, Access::ro, &S::timestamp_increment_ns},
    Register{reg::kAccessPrivilege, Access::ro, &S::privilege},
    Register{reg::kProtocolEndianness, Access::ro, &S::protocol_endianness},
    Register{reg::kImplementationEndianness, Access::ro, &S::implementation_endianness},

    Register{reg::kU3vVersion, Access::ro, &S::u3v_version},
    Register{reg::kU3vCapability, Access::ro, &S::u3v_capability},
    Register{reg::kU3vConfiguration, Access::rw, &S::u3v_configuration},
    Register{reg::kMaxCommandTransfer, Access::ro, &S::max_command},
    Register{reg::kMaxAckTransfer, Access::ro, &S::max_ack},
    Register{reg::kStreamChannelCount, Access::ro, &S::stream_channels},
    Register{reg::kSirmAddress, Access::ro, &S::sirm_address},
    Register{reg::kSirmLength, Access::ro, &S::sirm_length},
    Register{reg::kEirmAddress, Access::ro, &S::eirm_address},
    Register{reg::kEirmLength, Access::ro, &S::eirm_length},
    Register{reg::kIidc2Address, Access::ro, &S::iidc2_address},
    Register{reg::kCurrentSpeed, Access::ro, &S::speed},

    Register{reg::kStreamInfo, Access::ro, &S::stream_info},
    Register{reg::kStreamControl, Access::rw, &S::stream_control},
    Register{reg::kRequiredPayload, Access::ro, &S::required_payload},
    Register{reg::kRequiredLeader, Access::ro, &S::required_leader},
    Register{reg::kRequiredTrailer, Access::ro, &S::required_trailer},
    Register{reg::kMaxLeader, Access::rw, &S::max_leader},
    Register{reg::kTransferSize, Access::rw, &S::transfer_size},
    Register{reg::kTransferCount, Access::rw, &S::transfer_count},
    Register{reg::kFinalTransfer1, Access::rw, &S::final_transfer1},
    Register{reg::kFinalTransfer2, Access::rw, &S::final_transfer2},
    Register{reg::kMaxTrailer, Access::rw, &S::max_trailer},

    Register{reg::kEventControl, Access::rw, &S::event_control},
    Register{reg::kMaxEventTransfer, Access::ro, &S::max_event},
    Register{reg::kEventTest, Access::wo, &S::command},

    Register{reg::kSensorWidth, Access::ro, &S::sensor_width},
    Register{reg::kSensorHeight, Access::ro, &S::sensor_height},
    Register{reg::kWidth, Access::rw, &S::width},
    Register{reg::kHeight, Access::rw, &S::height},
    Register{reg::kOffsetX, Access::rw, &S::offset_x},
    Register{reg::kOffsetY, Access::rw, &S::offset_y},
    Register{reg::kPixelFormat, Access::rw, &S::pixel_format},
    Register{reg::kPayloadSize, Access::ro, &S::payload_size},
    Register{reg::kTlParamsLocked, Access::rw, &S::locked},
    Register{reg::kAcquisitionMode, Access::rw, &S::acquisition_mode},
    Register{reg::kAcquisitionFrameCount, Access::rw, &S::frame_count},
    Register{reg::kAcquisitionStart, Access::rw, &S::command},
    Register{reg::kAcquisitionStop, Access::rw, &S::command},
    Register{reg::kAcquisitionStatus, Access::ro, &S::acquiring},
    Register{reg::kFrameRateEnable, Access::rw, &S::rate_enable},
    Register{reg::kFrameRate, Access::rw, &S::rate_hz},
    Register{reg::kResultingFrameRate, Access::ro, &S::resulting_rate_hz},
    Register{reg::kExposureTime, Access::rw, &S::exposure_us},
    Register{reg::kGain, Access::rw, &S::gain_db},
    Register{reg::kTriggerMode, Access::rw, &S::trigger_mode},
    Register{reg::kTriggerSource, Access::rw, &S::trigger_source},
    Register{reg::kTriggerActivation, Access::rw, &S::trigger_activation},
    Register{reg::kTriggerSoftware, Access::rw, &S::command},
    Register{reg::kTriggerDelay, Access::rw, &S::trigger_delay_us},
    Register{reg::kLineStatus, Access::ro, &S::line_status},
    Register{reg::kEventNotification, Access::rw, &S::event_notification},
};

constexpr bool in_order() {
  for (std::size_t i = 1; i < kRegisters.size(); ++i)
    if (kRegisters[i].address < kRegisters[i - 1].end()) return false;
  return true;
}
static_assert(in_order(), "registers overlap, or are not in the order of their addresses");

/// Where registers are; a read stays within one.
struct Block {
  reg::Address begin, end;
};
constexpr std::array kBlocks = {
    Block{0, reg::kImplementationEndianness + 4},
    Block{reg::kSbrm, reg::kCurrentSpeed + 4},
    Block{reg::kSirm, reg::kSirmEnd},
    Block{reg::kEirm, reg::kEirmEnd},
    Block{reg::kFeatures, reg::kFeaturesEnd},
};

const Register* first_ending_behind(reg::Address address) {
  return std::upper_bound(kRegisters.begin(), kRegisters.end(), address,
                          [](reg::Address a, const Register& r) { return a < r.end(); });
}

/// The register's bytes as they stand on the wire.
void encode(const Register& r, const CameraState& state, std::span<std::uint8_t> out) {
  std::visit(
      [&](auto slot) {
        const auto& v = state.*slot;
        if constexpr (std::is_same_v<std::remove_cvref_t<decltype(v)>, std::string>)
          std::memcpy(out.data(), v.data(), std::min(v.size(), out.size()));
        else
          store_le(out, 0, v);
      },
      r.slot);
}

bool inside(std::uint64_t address, std::size_t bytes, reg::Address begin, reg::Address end) {
  return address >= begin && address <= end && bytes <= end - address;
}

}  // namespace

void Camera::refresh(DeviceTime now) {
  const auto payload = gige::payload_bytes(region(), static_cast<PixelFormat>(state_.pixel_format));
  state_.payload_size = static_cast<std::uint32_t>(payload);
  state_.required_payload = payload;
  state_.resulting_rate_hz = period().hz();
  state_.line_status = schedule_.line_is_high(now) ? 1 : 0;
}

Status Camera::read(std::uint64_t address, std::span<std::uint8_t> out, DeviceTime now) {
  if (out.empty()) return Status::invalid_parameter;
  if (inside(address, out.size(), reg::kXml, reg::kXml + xml_->size())) {
    std::memcpy(out.data(), xml_->data() + (address - reg::kXml), out.size());
    return Status::success;
  }
  if (inside(address, out.size(), reg::kManifest, reg::kManifest + manifest_->size())) {
    std::memcpy(out.data(), manifest_->data() + (address - reg::kManifest), out.size());
    return Status::success;
  }
  if (std::none_of(kBlocks.begin(), kBlocks.end(),
                   [&](const Block& b) { return inside(address, out.size(), b.begin, b.end); }))
    return Status::invalid_address;
  refresh(now);
  const reg::Address end = address + out.size();
  for (const Register* r = first_ending_behind(address); r != kRegisters.end() && r->address < end; ++r) {
    std::array<std::uint8_t, reg::kTextBytes> bytes{};
    if (r->access != Access::wo) encode(*r, state_, std::span(bytes).first(r->bytes()));
    const reg::Address from = std::max(address, r->address), to = std::min(end, r->end());
    std::memcpy(out.data() + (from - address), bytes.data() + (from - r->address), to - from);
  }
  return Status::success;
}

/// Whole registers, one or several; a text may be shorter than its register.
Status Camera::write(std::uint64_t address, Bytes data, DeviceTime now) {
  if (inside(address, data.size(), reg::kXml, reg::kXml + xml_->size()) ||
      inside(address, data.size(), reg::kManifest, reg::kManifest + manifest_->size()))
    return Status::write_protect;
  const Register* first = first_ending_behind(address);
  // Everything is checked before anything is written, except where a value itself is refused.
  const Register* r = first;
  for (std::size_t at = 0; at < data.size(); at += (r++)->bytes()) {
    if (r == kRegisters.end() || r->address != address + at) return Status::invalid_address;
    if (r->access == Access::ro) return Status::write_protect;
    const bool text = std::holds_alternative<std::string CameraState::*>(r->slot);
    if (!text && data.size() - at < r->bytes()) return Status::invalid_parameter;
  }
  r = first;
  for (std::size_t at = 0; at < data.size(); at += (r++)->bytes())
    if (const Status s = set(r->address, data.subspan(at, std::min(r->bytes(), data.size() - at)), now);
        s != Status::success)
      return s;
  return Status::success;
}

Status Camera::set(std::uint64_t address, Bytes value, DeviceTime now) {
  const Register& r = *first_ending_behind(address);
  if (const auto* text = std::get_if<std::string CameraState::*>(&r.slot)) {
    const auto end = std::find(value.begin(), value.end(), std::uint8_t{0});
    if (end - value.begin() >= static_cast<std::ptrdiff_t>(reg::kTextBytes)) return Status::invalid_parameter;
    (state_.**text).assign(value.begin(), end);
    return Status::success;
  }
  if (const auto* wide = std::get_if<std::uint64_t CameraState::*>(&r.slot)) {
    state_.** wide =
        load_le<std::uint64_t>(value, 0);  // configurations without a bit that means something here
    return Status::success;
  }
  if (std::holds_alternative<double CameraState::*>(r.slot))
    return set_real(address, load_le<double>(value, 0), now);
  const auto number = load_le<std::uint32_t>(value, 0);
  const auto slot = std::get<std::uint32_t CameraState::*>(r.slot);
  if (address < reg::kFeatures) {
    switch (address) {
      case reg::kStreamControl:
        return enable_stream(number);
      case reg::kTimestampLatch:
        state_.timestamp_ns = static_cast<std::uint64_t>(std::max<std::int64_t>(0, now.ns()));
        return Status::success;
      case reg::kEventTest:
        if (number != 0) raise_event(kTestEvent, now);
        return Status::success;
      case reg::kEventControl:
        break;
      default:
        // Transfers of the stream; a frame that is exposed has its own.
        if (state_.acquiring != 0) return Status::access_denied;
    }
    state_.*slot = number;
    return Status::success;
  }
  const Status s = set_feature(address, number, now);
  if (s == Status::success && slot != &CameraState::command) state_.*slot = number;
  if (s == Status::success) set_schedule(now);
  return s;
}

/// Whether a feature takes this value; commands are carried out.
Status Camera::set_feature(std::uint64_t address, std::uint32_t value, DeviceTime now) {
  const auto up_to = [&](std::uint32_t most) {
    return value <= most ? Status::success : Status::invalid_parameter;
  };
  switch (address) {
    case reg::kWidth:
    case reg::kHeight:
    case reg::kOffsetX:
    case reg::kOffsetY:
      return set_region(address, value);
    case reg::kPixelFormat: {
      if (locked()) return Status::access_denied;
      const auto& all = options_.camera.formats;
      const bool has = std::find(all.begin(), all.end(), static_cast<PixelFormat>(value)) != all.end();
      return has ? Status::success : Status::invalid_parameter;
    }
    case reg::kAcquisitionMode:
      return locked() ? Status::access_denied : up_to(reg::kModeMultiFrame);
    case reg::kAcquisitionFrameCount:
      if (locked()) return Status::access_denied;
      return value == 0 ? Status::invalid_parameter : up_to(65535);
    case reg::kAcquisitionStart:
      if (value != 0 && state_.acquiring == 0) start_acquisition(now);
      return Status::success;
    case reg::kAcquisitionStop:
      if (value != 0) stop_acquisition();
      return Status::success;
    case reg::kTriggerSoftware:
      if (value == 0 || schedule_.software_trigger(now)) return Status::success;
      return state_.acquiring != 0 && schedule_.settings().trigger == ExposureSchedule::Trigger::software
                 ? Status::busy
                 : Status::access_denied;
    default:
      return up_to(1);  // switches and choices of two
  }
}

Status Camera::set_region(std::uint64_t address, std::uint32_t value) {
  if (locked()) return Status::access_denied;
  const gige::GigeCameraConfig& c = options_.camera;
  Region r = region();
  std::uint32_t step = c.offset_step_px, least = 0;
  switch (address) {
    case reg::kWidth:
      r.width_px = value, step = c.width_step_px, least = c.min_width_px;
      break;
    case reg::kHeight:
      r.height_px = value, step = c.height_step_px, least = c.min_height_px;
      break;
    case reg::kOffsetX:
      r.x_px = value;
      break;
    default:
      r.y_px = value;
      break;
  }
  const bool fits = std::uint64_t{r.x_px} + r.width_px <= c.sensor_width_px &&
                    std::uint64_t{r.y_px} + r.height_px <= c.sensor_height_px;
  return value >= least && value % step == 0 && fits ? Status::success : Status::invalid_parameter;
}

Status Camera::set_real(std::uint64_t address, double value, DeviceTime now) {
  const gige::GigeCameraConfig& c = options_.camera;
  const auto set = [value](double lo, double hi, double& target) {
    if (!(value >= lo && value <= hi)) return Status::invalid_parameter;
    target = value;
    return Status::success;
  };
  Status s = Status::write_protect;
  if (address == reg::kFrameRate) s = set(c.min_frame_rate_hz, c.max_frame_rate_hz, state_.rate_hz);
  if (address == reg::kExposureTime) s = set(c.min_exposure_us, c.max_exposure_us, state_.exposure_us);
  if (address == reg::kGain) s = set(c.min_gain_db, c.max_gain_db, state_.gain_db);
  if (address == reg::kTriggerDelay) s = set(0, 1e6, state_.trigger_delay_us);
  if (s == Status::success) set_schedule(now);
  return s;
}

Status Camera::enable_stream(std::uint32_t value) {
  if ((value & reg::kStreamEnable) != 0) {
    for (const std::uint32_t size : {state_.transfer_size, state_.final_transfer1, state_.final_transfer2})
      if (size % reg::kAlignment != 0) return Status::stream_not_aligned;
    if (state_.max_leader < kLeaderBytes || state_.max_trailer < kTrailerBytes)
      return Status::stream_inconsistent;
  } else {
    ++epoch_;  // a frame that is being sent is given up
  }
  state_.stream_control = value & reg::kStreamEnable;
  return Status::success;
}

}  // namespace rigor::u3v

// Registers of the emulated camera: what they read, and what a write changes.
#include <algorithm>
#include <bit>
#include <utility>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {
namespace {

constexpr double kMaxTriggerDelayUs = 1e6;
constexpr std::uint32_t kMinHeartbeatMs = 500;
constexpr std::uint32_t kMaxHeartbeatMs = 3'600'000;
constexpr std::uint32_t kMaxPacketDelayTicks = 10'000'000;
constexpr std::size_t kUserNameSize = 16;

constexpr bool in(std::uint32_t a, std::uint32_t from, std::uint32_t end) { return a >= from && a < end; }

/// Registers that exist in bootstrap space; what is reserved between them reads as 0.
constexpr bool bootstrap_exists(std::uint32_t a) {
  return in(a, 0, 0xF8) || in(a, reg::kFirstUrl, 0x670) || in(a, 0x900, 0x960) || in(a, 0xA00, 0xA18) ||
         in(a, 0xD00, 0xD28);
}

bool is_double(std::uint32_t a) {
  return a == reg::kFrameRate || a == reg::kResultingFrameRate || a == reg::kExposureTime ||
         a == reg::kGain || a == reg::kTriggerDelay || a == reg::kScan3dScale || a == reg::kScan3dOffset ||
         a == reg::kScan3dInvalidValue;
}

bool read_only(std::uint32_t a) {
  if (a < reg::kBootstrapEnd) {
    return !in(a, reg::kUserName, reg::kUserName + kUserNameSize) && a != reg::kHeartbeatTimeout &&
           a != reg::kTimestampControl && a != reg::kControlPrivilege && a != reg::kStreamPort &&
           a != reg::kStreamPacketSize && a != reg::kStreamPacketDelay && a != reg::kStreamDestination &&
           a != reg::kStreamConfiguration;
  }
  return a == reg::kWidthMax || a == reg::kHeightMax || a == reg::kPayloadSize ||
         a == reg::kResultingFrameRate || a == reg::kResultingFrameRate + 4 || a == reg::kAcquisitionActive ||
         in(a, reg::kScan3dScale, reg::kFeatureEnd) || a == reg::kLineStatus || a == reg::kPtpStatus ||
         a == reg::kPtpOffsetHigh || a == reg::kPtpOffsetLow;
}

}  // namespace

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
      value = static_cast<std::uint32_t>(frame_bytes() + chunk_bytes());
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
      value = half_double(period().hz());
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
      value = trigger_source_;
      return GvStatus::success;
    case reg::kTriggerActivation:
      value = trigger_activation_;
      return GvStatus::success;
    case reg::kTriggerDelay:
    case reg::kTriggerDelay + 4:
      value = half_double(trigger_delay_us_);
      return GvStatus::success;
    case reg::kLineStatus:
      value = line_high(now_) ? 1 : 0;
      return GvStatus::success;
    case reg::kChunkModeActive:
      value = chunk_mode_;
      return GvStatus::success;
    case reg::kChunkSelector:
      value = chunk_selector_;
      return GvStatus::success;
    case reg::kChunkEnable:
      value = (chunks_ >> chunk_selector_) & 1;
      return GvStatus::success;
    case reg::kStreamCapability:
      value = config_.range.present ? reg::kMultipart : 0;
      return GvStatus::success;
    case reg::kStreamConfiguration:
      value = multipart_ ? reg::kMultipart : 0;
      return GvStatus::success;
    case reg::kComponentSelector:
    case reg::kComponentEnable:
    case reg::kScan3dScale:
    case reg::kScan3dScale + 4:
    case reg::kScan3dOffset:
    case reg::kScan3dOffset + 4:
    case reg::kScan3dInvalidValue:
    case reg::kScan3dInvalidValue + 4:
      if (!config_.range.present) return GvStatus::invalid_address;
      value = address == reg::kComponentSelector ? component_selector_
              : address == reg::kComponentEnable ? (components_ >> component_selector_) & 1
              : address - reg::kScan3dScale < 8  ? half_double(config_.range.scale_mm)
                                                 : 0u;
      return GvStatus::success;
    case reg::kPtpEnable:
    case reg::kPtpStatus:
    case reg::kPtpOffsetHigh:
    case reg::kPtpOffsetLow:
    case reg::kPtpLatch:
      if (!config_.ptp.present) return GvStatus::invalid_address;
      value = address == reg::kPtpEnable   ? (ptp_enabled_ ? 1u : 0u)
              : address == reg::kPtpStatus ? ptp_status(now_)
              : address == reg::kPtpOffsetHigh
                  ? static_cast<std::uint32_t>(static_cast<std::uint64_t>(latched_ptp_offset_ns_) >> 32)
              : address == reg::kPtpOffsetLow ? static_cast<std::uint32_t>(latched_ptp_offset_ns_)
                                              : 0u;
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
    case reg::kStreamConfiguration: {
      if (params_locked()) return GvStatus::access_denied;
      const bool wanted = (value & reg::kMultipart) != 0;
      if (wanted && !config_.range.present) return GvStatus::invalid_parameter;
      if (wanted != multipart_) next_block_id_ = 1, retained_.clear(), ++epoch_;
      multipart_ = wanted;
      return GvStatus::success;
    }
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
      rewire(now);
      if (value == 0) run_freely_from(on_grid(std::max(next_free_run_, std::max(now, sensor_free_))));
      return GvStatus::success;
    case reg::kTriggerSource:
      if (value > reg::kTriggerSourceLine1) return GvStatus::invalid_parameter;
      if (trigger_source_ != value) triggers_.clear();
      trigger_source_ = value;
      rewire(now);
      return GvStatus::success;
    case reg::kTriggerActivation:
      if (value > reg::kFallingEdge) return GvStatus::invalid_parameter;
      trigger_activation_ = value;
      rewire(now);
      return GvStatus::success;
    case reg::kChunkModeActive:
      if (params_locked()) return GvStatus::access_denied;
      if (value > 1) return GvStatus::invalid_parameter;
      chunk_mode_ = value;
      return GvStatus::success;
    case reg::kChunkSelector:
      if (value < reg::kChunkImage || value > reg::kChunkLast) return GvStatus::invalid_parameter;
      chunk_selector_ = value;
      return GvStatus::success;
    case reg::kChunkEnable:
      if (params_locked()) return GvStatus::access_denied;
      if (value > 1) return GvStatus::invalid_parameter;
      // The picture is always there; clients that switch every chunk off first do not mean it.
      if (chunk_selector_ == reg::kChunkImage) return GvStatus::success;
      chunks_ = (chunks_ & ~(1u << chunk_selector_)) | value << chunk_selector_;
      return GvStatus::success;
    case reg::kComponentSelector:
      if (value != kRange && value != kIntensity) return GvStatus::invalid_parameter;
      component_selector_ = value;
      return GvStatus::success;
    case reg::kComponentEnable: {
      if (params_locked()) return GvStatus::access_denied;
      const std::uint32_t with = (components_ & ~(1u << component_selector_)) | value << component_selector_;
      if (value > 1 || with == 0) return GvStatus::invalid_parameter;  // a frame of nothing is none
      components_ = with;
      return GvStatus::success;
    }
    case reg::kPtpEnable:
      if (value > 1) return GvStatus::invalid_parameter;
      if (value != 0 && !ptp_enabled_) ptp_since_ = now;
      ptp_enabled_ = value != 0;
      return GvStatus::success;
    case reg::kPtpLatch:
      if (value != 0) latched_ptp_offset_ns_ = ptp_offset_ns(now);
      return GvStatus::success;
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
  const Period before = period();
  GvStatus s = GvStatus::write_protect;
  if (address == reg::kFrameRate)
    s = set(config_.min_frame_rate_hz, config_.max_frame_rate_hz, frame_rate_hz_);
  if (address == reg::kExposureTime) s = set(config_.min_exposure_us, config_.max_exposure_us, exposure_us_);
  if (address == reg::kGain) s = set(config_.min_gain_db, config_.max_gain_db, gain_db_);
  if (address == reg::kTriggerDelay) s = set(0, kMaxTriggerDelayUs, trigger_delay_us_);
  if (acquiring_ && index_ > 0 && !period().same_as(before)) {
    // The frame in progress keeps its place and is exposed to its end; the next one comes a new period behind
    // it.
    run_freely_from(on_grid(std::max(std::max(next_free_run_ - before + period(), sensor_free_), now)));
  }
  return s;
}

GvStatus GigeDeviceModel::write_memory(const WriteMemoryCmd& c, Endpoint from, DeviceTime now,
                                       GvcpAnswer& answer) {
  if (c.data.size() == 8 && is_double(c.address)) {
    if (!is_owner(from)) return GvStatus::access_denied;
    if (read_only(c.address)) return GvStatus::write_protect;
    return write_double(c.address, load_be<double>(c.data, 0), now, answer);
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

}  // namespace rigor::gige

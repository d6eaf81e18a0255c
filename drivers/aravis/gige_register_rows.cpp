// The rows of the register table: every register of the emulated camera, with its features, limits and
// effects.
#include <algorithm>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {
namespace {

constexpr double kMaxTriggerDelayUs = 1e6;
constexpr double kMaxPacketDelayTicks = 10'000'000;
constexpr double kMinHeartbeatMs = 500, kMaxHeartbeatMs = 3'600'000;

const std::vector<Choice> kOffOn{{"Off", 0}, {"On", 1}};

void set_bit(std::uint32_t& bits, std::uint32_t at, bool on) {
  bits = (bits & ~(1u << at)) | std::uint32_t{on} << at;
}

}  // namespace

std::span<const Chunk> chunk_table() {
  using R = const FrameRequest&;
  using K = Feature::Kind;
  static const Chunk all[] = {
      {reg::kChunkImage, "Image", "The picture", K::integer, nullptr},
      {reg::kChunkTimestamp, "Timestamp", "Start of the exposure in ticks", K::integer,
       [](R r) { return r.timestamp_ticks; }},
      {reg::kChunkExposureTime, "ExposureTime", "Exposure time of this picture in microseconds", K::real,
       [](R r) { return std::bit_cast<std::uint64_t>(static_cast<double>(r.exposure.ns()) / 1e3); }},
      {reg::kChunkGain, "Gain", "Gain of this picture in dB", K::real,
       [](R r) { return std::bit_cast<std::uint64_t>(r.gain_db); }},
      {reg::kChunkFrameId, "FrameID", "Exposures since the start of the acquisition", K::integer,
       [](R r) { return r.index; }},
      {reg::kChunkOffsetX, "OffsetX", "Left edge of this picture's region", K::integer,
       [](R r) { return std::uint64_t{r.region.x_px}; }},
      {reg::kChunkOffsetY, "OffsetY", "Top edge of this picture's region", K::integer,
       [](R r) { return std::uint64_t{r.region.y_px}; }},
      {reg::kChunkWidth, "Width", "Width of this picture", K::integer,
       [](R r) { return std::uint64_t{r.region.width_px}; }},
      {reg::kChunkHeight, "Height", "Height of this picture", K::integer,
       [](R r) { return std::uint64_t{r.region.height_px}; }},
      {reg::kChunkPixelFormat, "PixelFormat", "Format of this picture's pixels", K::choice,
       [](R r) { return static_cast<std::uint64_t>(r.format); }},
  };
  static_assert(std::size(all) == reg::kChunkLast);
  return all;
}

RegisterTable GigeDeviceModel::registers(const GigeCameraConfig& c) {
  using K = Feature::Kind;
  using M = GigeDeviceModel;
  using Config = GigeCameraConfig;
  RegisterTable t;

  t.category("DeviceControl");
  t.add(reg::kManufacturerName, K::text, "DeviceVendorName", "Vendor").size = 32;
  t.add(reg::kModelName, K::text, "DeviceModelName", "Model").size = 32;
  t.add(reg::kManufacturerInfo, K::text, "DeviceManufacturerInfo", "What the vendor adds").size = 48;
  t.add(reg::kDeviceVersion, K::text, "DeviceVersion", "Version").size = 32;
  t.add(reg::kSerialNumber, K::text, "DeviceID", "Serial number").size = 16;
  t.add(reg::kUserName, K::text, "DeviceUserID", "Name that the user gives").writable().size = 16;

  t.category("ImageFormatControl");
  t.add(reg::kWidthMax, K::integer, "SensorWidth", "Width of the sensor")
      .shows<&M::config_, &Config::sensor_width_px>()
      .also(K::integer, "WidthMax", "Largest width of the region");
  t.add(reg::kHeightMax, K::integer, "SensorHeight", "Height of the sensor")
      .shows<&M::config_, &Config::sensor_height_px>()
      .also(K::integer, "HeightMax", "Largest height of the region");
  const auto region = [&](Register& row, double min, std::uint32_t step, reg::Address whole,
                          reg::Address used) {
    row.unit("px").beginner().lock().within(min, 0, step);
    row.whole = whole, row.used = used;
  };
  region(
      t.add(reg::kWidth, K::integer, "Width", "Width of the region").value<&M::region_, &Region::width_px>(),
      c.min_width_px, c.width_step_px, reg::kWidthMax, reg::kOffsetX);
  region(t.add(reg::kHeight, K::integer, "Height", "Height of the region")
             .value<&M::region_, &Region::height_px>(),
         c.min_height_px, c.height_step_px, reg::kHeightMax, reg::kOffsetY);
  region(t.add(reg::kOffsetX, K::integer, "OffsetX", "Left edge of the region")
             .value<&M::region_, &Region::x_px>(),
         0, c.offset_step_px, reg::kWidthMax, reg::kWidth);
  region(t.add(reg::kOffsetY, K::integer, "OffsetY", "Top edge of the region")
             .value<&M::region_, &Region::y_px>(),
         0, c.offset_step_px, reg::kHeightMax, reg::kHeight);
  std::vector<Choice> formats;
  for (const auto f : c.formats) formats.push_back({to_string(f), static_cast<std::uint32_t>(f)});
  t.add(reg::kPixelFormat, K::choice, "PixelFormat", "Format of the pixels")
      .beginner()
      .choices(std::move(formats))
      .lock()
      .value<&M::format_>();

  t.category("AcquisitionControl");
  t.add(reg::kAcquisitionMode, K::choice, "AcquisitionMode", "How many frames an acquisition has")
      .beginner()
      .choices({{"Continuous", reg::kModeContinuous},
                {"SingleFrame", reg::kModeSingleFrame},
                {"MultiFrame", reg::kModeMultiFrame}})
      .lock()
      .value<&M::mode_>();
  t.add(reg::kAcquisitionStart, K::command, "AcquisitionStart", "Starts the acquisition")
      .does([](M& m, std::uint64_t v, const Change& w) {
        if (v != 0 && !m.acquiring_) m.start_acquisition(w.now);
        return GvStatus::success;
      });
  const auto stop = [](M& m, std::uint64_t v, const Change&) {
    if (v != 0) m.stop_acquisition();
    return GvStatus::success;
  };
  t.add(reg::kAcquisitionStop, K::command, "AcquisitionStop",
        "Ends the acquisition; an exposure in progress is dropped")
      .does(stop);
  t.add(reg::kAcquisitionAbort, K::command, "AcquisitionAbort", "Ends the acquisition at once").does(stop);
  t.add(reg::kAcquisitionActive).shows<&M::acquiring_>();
  t.add(reg::kAcquisitionFrameCount, K::integer, "AcquisitionFrameCount",
        "Frames of a MultiFrame acquisition")
      .beginner()
      .within(1, 65535)
      .lock()
      .value<&M::frame_count_>();
  t.add(reg::kFrameRate, K::real, "AcquisitionFrameRate", "Frame rate, where exposure allows it")
      .beginner()
      .unit("Hz")
      .within(c.min_frame_rate_hz, c.max_frame_rate_hz)
      .value<&M::frame_rate_hz_>();
  t.add(reg::kFrameRateEnable, K::flag, "AcquisitionFrameRateEnable",
        "Off: the highest rate that the exposure time allows")
      .beginner()
      .value<&M::frame_rate_enable_>();
  t.add(reg::kResultingFrameRate, K::real, "ResultingFrameRate",
        "The rate that frame rate and exposure time give together")
      .unit("Hz")
      .shows([](const M& m) { return std::bit_cast<std::uint64_t>(m.period().hz()); });
  t.fixed(K::choice, "ExposureMode", "How the exposure time is set", "Timed");
  t.add(reg::kExposureTime, K::real, "ExposureTime", "Exposure time")
      .beginner()
      .unit("us")
      .within(c.min_exposure_us, c.max_exposure_us)
      .value<&M::exposure_us_>();
  t.fixed(K::choice, "TriggerSelector", "The trigger that the other features mean", "FrameStart");
  t.add(reg::kTriggerMode, K::choice, "TriggerMode", "On: each frame waits for its trigger")
      .beginner()
      .choices(kOffOn)
      .shows<&M::trigger_mode_>()
      .does([](M& m, std::uint64_t v, const Change& w) {
        m.set_trigger(m.trigger_mode_, v, w.now);
        if (v == 0) m.run_freely_from(m.on_grid(std::max(m.next_free_run_, std::max(w.now, m.sensor_free_))));
        return GvStatus::success;
      });
  t.add(reg::kTriggerSource, K::choice, "TriggerSource", "Where triggers come from")
      .beginner()
      .choices({{"Software", reg::kTriggerSourceSoftware},
                {"Line1", reg::kTriggerSourceLine1},
                {"Action0", reg::kTriggerSourceAction0}})
      .shows<&M::trigger_source_>()
      .does([](M& m, std::uint64_t v, const Change& w) {
        m.set_trigger(m.trigger_source_, v, w.now);
        return GvStatus::success;
      });
  t.add(reg::kTriggerActivation, K::choice, "TriggerActivation", "Edge that triggers")
      .beginner()
      .choices({{"RisingEdge", reg::kRisingEdge}, {"FallingEdge", reg::kFallingEdge}})
      .shows<&M::trigger_activation_>()
      .does([](M& m, std::uint64_t v, const Change& w) {
        m.trigger_activation_ = static_cast<std::uint32_t>(v);
        m.rewire(w.now);
        return GvStatus::success;
      });
  t.add(reg::kTriggerDelay, K::real, "TriggerDelay", "From the trigger to the exposure")
      .beginner()
      .unit("us")
      .within(0, kMaxTriggerDelayUs)
      .value<&M::trigger_delay_us_>();
  t.add(reg::kTriggerSoftware, K::command, "TriggerSoftware", "Triggers one frame")
      .does([](M& m, std::uint64_t v, const Change& w) {
        return v == 0 ? GvStatus::success : m.software_trigger(w.now);
      });

  t.category("AnalogControl");
  t.add(reg::kGain, K::real, "Gain", "Analogue gain")
      .beginner()
      .unit("dB")
      .within(c.min_gain_db, c.max_gain_db)
      .value<&M::gain_db_>();

  t.category("DigitalIOControl");
  t.fixed(K::choice, "LineSelector", "The line that the other features mean", "Line1");
  t.fixed(K::choice, "LineMode", "Direction of the line", "Input");
  t.add(reg::kLineStatus, K::flag, "LineStatus", "Whether the line is high now").shows([](const M& m) {
    return std::uint64_t{m.line_high(m.now_)};
  });

  t.category("ActionControl");
  t.add(reg::kActionSignalCount);
  t.add(reg::kActionDeviceKey, K::integer, "ActionDeviceKey",
        "Key that action commands to this device must have")
      .value<&M::action_device_key_>()
      .writable(Access::write_only);
  t.fixed(K::integer, "ActionSelector", "The action signal that the other features mean", "0")
      .selects({"ActionGroupKey", "ActionGroupMask"});
  t.add(reg::kActionGroupKey, K::integer, "ActionGroupKey",
        "Key that action commands for this signal must have")
      .value<&M::action_group_key_>();
  t.add(reg::kActionGroupMask, K::integer, "ActionGroupMask",
        "Action commands for this signal must have one of these bits")
      .value<&M::action_group_mask_>();
  t.add(reg::kActionQueueSize, K::integer, "ActionQueueSize", "Scheduled action commands that may wait")
      .shows([](const M&) { return std::uint64_t{kActionQueue}; });

  t.category("ChunkDataControl");
  std::vector<Choice> chunks;
  for (const Chunk& chunk : chunk_table()) chunks.push_back({chunk.name, chunk.id});
  t.add(reg::kChunkModeActive, K::flag, "ChunkModeActive", "Whether chunks follow each picture")
      .lock()
      .value<&M::chunk_mode_>();
  t.add(reg::kChunkSelector, K::choice, "ChunkSelector", "The chunk that ChunkEnable means")
      .choices(std::move(chunks))
      .selects({"ChunkEnable"})
      .value<&M::chunk_selector_>();
  t.add(reg::kChunkEnable, K::flag, "ChunkEnable", "Whether the selected chunk is sent")
      .lock()
      .shows([](const M& m) { return std::uint64_t{(m.chunks_ >> m.chunk_selector_) & 1}; })
      .does([](M& m, std::uint64_t v, const Change&) {
        // The picture is always there; clients that switch every chunk off first do not mean it.
        if (m.chunk_selector_ != reg::kChunkImage) set_bit(m.chunks_, m.chunk_selector_, v != 0);
        return GvStatus::success;
      });

  t.category("TransportLayerControl");
  t.add(reg::kPayloadSize, K::integer, "PayloadSize", "Bytes of a frame").shows([](const M& m) {
    return std::uint64_t{m.frame_bytes() + m.chunk_bytes()};
  });
  t.add(reg::kVersion, K::integer, "GevVersionMajor", "GigE Vision version, major")
      .bits(15, 0)
      .also(K::integer, "GevVersionMinor", "GigE Vision version, minor")
      .bits(31, 16);
  t.add(reg::kMacHigh, K::integer, "GevMACAddress", "MAC address").size = 8;
  t.add(reg::kCurrentIp, K::integer, "GevCurrentIPAddress", "IP address");
  t.add(reg::kCurrentMask, K::integer, "GevCurrentSubnetMask", "Subnet mask");
  t.add(reg::kCurrentGateway, K::integer, "GevCurrentDefaultGateway", "Gateway");
  t.add(reg::kStreamChannelCount, K::integer, "GevStreamChannelCount", "Stream channels");
  t.add(reg::kHeartbeatTimeout, K::integer, "GevHeartbeatTimeout",
        "Silence after which the controller loses control")
      .unit("ms")
      .nearest_within(kMinHeartbeatMs, kMaxHeartbeatMs)
      .value<&M::heartbeat_timeout_ms_>();
  t.add(reg::kTickFrequencyHigh, K::integer, "GevTimestampTickFrequency", "Ticks per second of the timestamp")
      .size = 8;
  t.add(reg::kTimestampControl, K::command, "GevTimestampControlLatch", "Latches the timestamp")
      .also(K::command, "GevTimestampControlReset", "Sets the timestamp to zero")
      .also(K::command, "GevTimestampControlLatchReset", "Latches the timestamp, then sets it to zero")
      .does([](M& m, std::uint64_t v, const Change& w) {
        if ((v & reg::kTimestampLatch) != 0) m.latched_ticks_ = m.ticks(w.now);
        if ((v & reg::kTimestampReset) != 0) m.timestamp_zero_ = w.now;
        return GvStatus::success;
      })
      .writable(Access::write_only)
      .command_values(
          {reg::kTimestampLatch, reg::kTimestampReset, reg::kTimestampLatch | reg::kTimestampReset});
  t.add(reg::kTimestampHigh, K::integer, "GevTimestampValue", "Timestamp at the last latch")
      .shows<&M::latched_ticks_>()
      .size = 8;
  t.add(reg::kGvcpCapability);
  t.fixed(K::choice, "GevGVCPExtendedStatusCodesSelector", "The status codes that the next feature means",
          "Version2_0")
      .selects({"GevGVCPExtendedStatusCodes"});
  t.add(reg::kGvcpConfiguration, K::flag, "GevGVCPExtendedStatusCodes",
        "Off: what version 2.0 has a status code for is a plain error")
      .bits(13, 13)
      .also(K::choice, "ActionUnconditionalMode", "On: action commands count although no client has control")
      .in("ActionControl")
      .bits(28, 28)
      .choices(kOffOn)
      .shows([](const M& m) {
        return std::uint64_t{m.gvcp_configuration_ | (m.ptp_enabled_ ? reg::kIeee1588 : 0)};
      })
      .does([](M& m, std::uint64_t v, const Change& w) {
        m.gvcp_configuration_ =
            static_cast<std::uint32_t>(v) & (reg::kExtendedStatus | reg::kUnconditionalAction);
        if (m.config_.ptp.present) m.enable_ptp((v & reg::kIeee1588) != 0, w.now);
        return GvStatus::success;
      });
  auto& privilege = t.add(reg::kControlPrivilege, K::choice, "GevCCP", "Control channel privilege");
  privilege.shows<&M::privilege_>().does(&M::write_privilege);
  privilege.features.back().choices = {{"OpenAccess", 0}, {"ExclusiveAccess", 1}, {"ControlAccess", 2}};
  privilege.anyone = true;
  t.add(reg::kPrimaryPort).shows<&M::owner_, &Endpoint::port>();
  t.add(reg::kPrimaryIp).shows<&M::owner_, &Endpoint::ip>();
  t.fixed(K::integer, "GevStreamChannelSelector", "The stream channel that the other features mean", "0");
  t.add(reg::kStreamPort, K::integer, "GevSCPHostPort", "UDP port that the stream goes to; 0 closes it")
      .bits(31, 16, Bounds{0, 65535})
      .within(0, 0x0FFFFFFF)  // there is one interface, number 0
      .shows<&M::stream_port_>()
      .does([](M& m, std::uint64_t v, const Change&) {
        m.open_stream(static_cast<std::uint16_t>(v));
        return GvStatus::success;
      })
      .also(K::integer, "GevSCPInterfaceIndex", "Network interface of the stream")
      .bits(3, 0);
  t.add(reg::kStreamPacketSize, K::command, "GevSCPSFireTestPacket",
        "Sends one packet of the current packet size")
      .bits(0, 0)
      .also(K::flag, "GevSCPSDoNotFragment", "Sets the IP bit of the same name")
      .bits(1, 1)
      .also(K::integer, "GevSCPSPacketSize", "Size of a stream packet with IP and UDP headers")
      .unit("B")
      .bits(31, 16, Bounds{static_cast<double>(c.min_packet_size), static_cast<double>(c.max_packet_size), 4})
      .lock()
      .shows([](const M& m) {
        return std::uint64_t{m.packet_size_ | (m.do_not_fragment_ ? reg::kDoNotFragment : 0)};
      })
      .does(&M::write_packet_size);
  t.add(reg::kStreamPacketDelay, K::integer, "GevSCPD", "Delay between stream packets in timestamp ticks")
      .within(0, kMaxPacketDelayTicks)
      .value<&M::packet_delay_ticks_>();
  t.add(reg::kStreamDestination, K::integer, "GevSCDA", "IP address that the stream goes to")
      .shows<&M::stream_ip_>()
      .does([](M& m, std::uint64_t v, const Change&) {
        if (m.acquiring_) return GvStatus::access_denied;
        m.stream_ip_ = static_cast<std::uint32_t>(v);
        return GvStatus::success;
      });
  t.add(reg::kStreamSourcePort, K::integer, "GevSCSP", "UDP port that the stream comes from")
      .bits(31, 16)
      .shows<&M::stream_source_port_>();
  t.add(reg::kStreamCapability).shows([](const M& m) {
    return std::uint64_t{m.config_.range.present ? reg::kMultipart : 0};
  });
  t.add(reg::kStreamConfiguration)
      .lock()
      .shows([](const M& m) { return std::uint64_t{m.multipart_ ? reg::kMultipart : 0}; })
      .does([](M& m, std::uint64_t v, const Change&) {
        const bool wanted = (v & reg::kMultipart) != 0;
        if (wanted && !m.config_.range.present) return GvStatus::invalid_parameter;
        if (wanted != m.multipart_) m.restart_blocks();
        m.multipart_ = wanted;
        return GvStatus::success;
      });
  t.category("");
  t.add(reg::kTlParamsLocked, K::integer, "TLParamsLocked",
        "1 while features that shape the stream may not change")
      .within(0, 1)
      .shows([](const M& m) { return std::uint64_t{m.params_locked()}; })
      .does([](M& m, std::uint64_t v, const Change&) {
        m.tl_params_locked_ = static_cast<std::uint32_t>(v);
        return GvStatus::success;
      })
      .features.back()
      .visibility = "Invisible";
  t.add(reg::kFirstUrl, 512);
  t.add(reg::kSecondUrl, 512);
  t.add(reg::kInterfaceCount);
  t.add(reg::kMessageChannelCount);
  if (c.range.present) add_range_rows(t);
  if (c.ptp.present) add_ptp_rows(t);
  t.sort();
  return t;
}

/// SFNC 2.4, 3D scan control: what the counts of the range picture mean, and which pictures a frame has.
void GigeDeviceModel::add_range_rows(RegisterTable& t) {
  using K = Feature::Kind;
  using M = GigeDeviceModel;
  t.category("Scan3dControl");
  t.add(reg::kComponentSelector, K::choice, "ComponentSelector",
        "The picture of a frame that ComponentEnable means")
      .beginner()
      .choices({{"Intensity", kIntensity}, {"Range", kRange}})
      .selects({"ComponentEnable"})
      .value<&M::component_selector_>();
  t.add(reg::kComponentEnable, K::flag, "ComponentEnable", "Whether multi-part frames have this picture")
      .beginner()
      .lock()
      .shows([](const M& m) { return std::uint64_t{(m.components_ >> m.component_selector_) & 1}; })
      .does([](M& m, std::uint64_t v, const Change&) {
        auto with = m.components_;
        set_bit(with, m.component_selector_, v != 0);
        if (with == 0) return GvStatus::invalid_parameter;  // a frame of nothing is none
        m.components_ = with;
        return GvStatus::success;
      });
  t.fixed(K::choice, "Scan3dDistanceUnit", "Unit of scale and offset", "Millimeter");
  t.fixed(K::choice, "Scan3dCoordinateSystem", "What coordinate C is: the length of the ray", "Spherical");
  t.fixed(K::choice, "Scan3dOutputMode", "What the range picture has", "CalibratedC");
  t.fixed(K::choice, "Scan3dCoordinateSelector", "The coordinate that scale and offset mean", "CoordinateC");
  t.add(reg::kScan3dScale, K::real, "Scan3dCoordinateScale", "Millimetres for a count")
      .shows<&M::config_, &GigeCameraConfig::range, &GigeCameraConfig::Range::scale_mm>();
  const auto zero = [](const M&) { return std::uint64_t{0}; };
  t.add(reg::kScan3dOffset, K::real, "Scan3dCoordinateOffset", "Millimetres at 0 counts").shows(zero);
  t.fixed(K::flag, "Scan3dInvalidDataFlag", "Whether one value of the range picture says that there is none",
          "1");
  t.add(reg::kScan3dInvalidValue, K::real, "Scan3dInvalidDataValue", "That value").shows(zero);
}

void GigeDeviceModel::add_ptp_rows(RegisterTable& t) {
  using K = Feature::Kind;
  using M = GigeDeviceModel;
  t.category("PtpControl");
  t.add(reg::kPtpEnable, K::flag, "PtpEnable", "Whether the clock follows a PTP master")
      .shows<&M::ptp_enabled_>()
      .does([](M& m, std::uint64_t v, const Change& w) {
        m.enable_ptp(v != 0, w.now);
        return GvStatus::success;
      });
  t.add(reg::kPtpLatch, K::command, "PtpDataSetLatch", "Latches the offset")
      .does([](M& m, std::uint64_t v, const Change& w) {
        if (v != 0) m.latched_ptp_offset_ns_ = m.ptp_offset_ns(w.now);
        return GvStatus::success;
      });
  t.add(reg::kPtpStatus, K::choice, "PtpStatus", "State of the PTP clock")
      .choices({{"Disabled", reg::kPtpDisabled},
                {"Listening", reg::kPtpListening},
                {"Uncalibrated", reg::kPtpUncalibrated},
                {"Slave", reg::kPtpSlave}})
      .shows([](const M& m) { return std::uint64_t{m.ptp_status(m.now_)}; });
  auto& offset = t.add(reg::kPtpOffsetHigh, K::integer, "PtpOffsetFromMaster",
                       "Nanoseconds from the master at the last latch");
  offset.shows<&M::latched_ptp_offset_ns_>();
  offset.size = 8, offset.is_signed = true;
  t.category("");
  t.add(reg::kIeee1588Status).shows([](const M& m) {
    // As the standard numbers the states of a port.
    static constexpr std::uint64_t kPortState[] = {3, 4, 8, 9};
    return kPortState[m.ptp_status(m.now_)];
  });
}

}  // namespace rigor::gige

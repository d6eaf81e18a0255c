// A GigE Vision camera without a network: registers, privileges, exposure timing and the memory for resends.
// It is handed datagrams and an instant, and hands datagrams back; it starts no thread, opens no socket and
// reads no clock, so that the same camera runs behind UDP (gige_emulator.h) and in virtual time
// (gige_memory_link.h).
//
//   auto answer = model.handle_gvcp(from, datagram, now);      // at most one acknowledge, and what else it
//   caused if (model.next_exposure() <= now) {
//     FrameJob job;
//     if (model.begin_frame(now, job)) {                       // exposure starts: which picture, of which
//     region
//       bool ok = fill(job.request, job.picture());            // outside of any lock
//       auto block = model.finish_frame(std::move(job), ok);   // null where acquisition ended meanwhile
//       send(block->encode_packet(i, …) for all i);            // from block t_send on
//     }
//   }
//
// Time is the emulator's clock: CLOCK_MONOTONIC behind UDP, bench time in virtual runs. The device's own
// timestamp counter runs at 1 GHz on that clock and starts at its zero until a client resets it. Not thread
// safe: one caller at a time. GvspBlock objects that were handed out are immutable and may be read anywhere,
// but must be let go by that same one caller: a block that nobody holds is filled anew.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/aravis/gige_register_table.h"
#include "drivers/aravis/gvcp_codec.h"
#include "drivers/aravis/gvsp_codec.h"
#include "rt-core/period.h"
#include "rt-core/result.h"

namespace rigor::gige {

/// Who sent a datagram. Host byte order.
struct Endpoint {
  std::uint32_t ip = 0;
  std::uint16_t port = 0;
  bool operator==(const Endpoint&) const = default;
};
/// `a.b.c.d`, nothing else.
[[nodiscard]] std::optional<std::uint32_t> parse_ipv4(const std::string& text);
[[nodiscard]] std::string ipv4_text(std::uint32_t ip);

struct GigeCameraConfig {
  std::string vendor = "Rigor";
  std::string model = "Emulated GigE camera";
  std::string version = "1";
  std::string manufacturer_info = "simulated channel";
  std::string serial = "RIGOR0001";
  std::string user_name;
  std::uint32_t ip = 0x7F000001, mask = 0xFF000000, gateway = 0;
  std::array<std::uint8_t, 6> mac{0x02, 0, 0, 0, 0, 0};  ///< zeros behind the first byte: made from ip

  std::uint32_t sensor_width_px = 640, sensor_height_px = 480;
  std::uint32_t width_step_px = 4, height_step_px = 2, offset_step_px = 2;
  std::uint32_t min_width_px = 16, min_height_px = 16;
  std::vector<PixelFormat> formats = {PixelFormat::mono8};  ///< the first one is the default

  double frame_rate_hz = 25, min_frame_rate_hz = 0.1, max_frame_rate_hz = 200;
  double exposure_us = 10'000, min_exposure_us = 10, max_exposure_us = 1'000'000;
  double gain_db = 0, min_gain_db = 0, max_gain_db = 24;

  Duration readout = milliseconds(1);  ///< from the end of exposure to the first packet
  /// Exposures start at multiples of the frame period on the emulator's clock, so that a simulated side on
  /// the same clock exposes at the same instants. Otherwise they are counted from AcquisitionStart.
  bool align_to_clock = false;

  std::uint32_t packet_size = 1400, min_packet_size = 576, max_packet_size = 9000;
  std::size_t retained_frames = 8;  ///< kept for resends
  std::size_t trigger_queue = 16;   ///< software triggers that wait for the sensor

  /// What is wired to Line1: pulses that rise at line_phase + k·line_period on the emulator's clock and fall
  /// half a period later. Period 0: nothing, but pulse_line() pulses it.
  Period line_period;
  Duration line_phase;
  /// A clock that follows a PTP master once PtpEnable was set.
  struct Ptp {
    bool present = false;
    Duration settle = seconds(2);        ///< from enabling to Slave
    Duration offset = nanoseconds(200);  ///< from the master, at most, once settled
  } ptp;
  /// A 3D camera, that gives range (Coord3D_C16, spherical coordinates, its one format) and the amplitude of
  /// the same exposure (Mono16): two parts of a frame where the client wants such frames, otherwise range
  /// alone.
  struct Range {
    bool present = false;
    double scale_mm = 0.25;  ///< of a count; 0 counts: no return
  } range;
};

/// What a picture must show. Region in sensor pixels.
struct FrameRequest {
  std::uint64_t index = 0;            ///< exposures since AcquisitionStart, skipped ones included
  DeviceTime t_exposure_start;        ///< on the emulator's clock
  std::uint64_t timestamp_ticks = 0;  ///< the same instant as the client will see it
  Duration exposure;
  double gain_db = 0;
  Region region;
  PixelFormat format = PixelFormat::mono8;
  bool range = false, amplitude = false;  ///< of a 3D camera: which pictures, in this order
};

/// Writes the picture, rows from the top without padding, in the format that is asked for; `out` has exactly
/// the bytes of the picture. False: there is none, and the camera sends none. One call at a time, outside of
/// any lock: behind UDP on the frame thread, in virtual time in the caller of GigeMemoryLink::advance().
using FillFrame = std::function<bool(const FrameRequest& request, MutableBytes out)>;

class FrameJob {
 public:
  FrameRequest request;
  DeviceTime t_send;  ///< the first packet leaves no earlier
  [[nodiscard]] MutableBytes picture() { return block ? MutableBytes(block->data) : MutableBytes(); }

 private:
  friend class GigeDeviceModel;
  std::shared_ptr<GvspBlock> block;
  std::uint64_t epoch = 0;
};

/// A block that is ready to leave.
struct OutgoingBlock {
  std::shared_ptr<const GvspBlock> block;
  DeviceTime t_send;
  Endpoint to;
  Duration packet_delay;  ///< between packets, as the client asked for (SCPD)
};

/// A resend that was asked for: packets first … last of `block`, or, where `block` is null, an answer of
/// packet_unavailable for `first`.
struct ResendJob {
  std::shared_ptr<const GvspBlock> block;
  Endpoint to;
  std::uint64_t block_id = 0;
  std::uint32_t first = 0, last = 0;
  bool extended_ids = false;
};

struct TestPacket {
  Endpoint to;
  std::uint32_t packet_size = 0;  ///< with IP and UDP headers
  bool do_not_fragment = false;
};

/// What a datagram caused.
struct GvcpAnswer {
  Datagram ack;  ///< empty: say nothing
  std::optional<TestPacket> test_packet;
  std::optional<ResendJob> resend;
  bool schedule_changed = false;  ///< look at next_exposure() again
};

struct GigeModelCounters {
  std::uint64_t gvcp_requests = 0, malformed = 0, refused = 0;
  std::uint64_t frames = 0, exposures_skipped = 0, pictures_missing = 0;
  std::uint64_t triggers = 0, triggers_refused = 0;
  std::uint64_t line_edges = 0;   ///< that opened an exposure
  std::uint64_t line_missed = 0;  ///< the sensor was busy
  std::uint64_t actions = 0;  ///< action commands for this camera, those that could not be obeyed included
  std::uint64_t actions_late = 0;     ///< scheduled for the past: executed at once
  std::uint64_t actions_refused = 0;  ///< no PTP time, or the queue was full
  std::uint64_t actions_missed = 0;   ///< executed while the sensor was busy
  std::uint64_t resend_requests = 0, resend_packets = 0, resend_unavailable = 0;
  std::uint64_t control_taken = 0, heartbeat_expired = 0;
};

class GigeDeviceModel {
 public:
  /// bad_input for ranges that contradict each other, strings that do not fit, no or unknown formats.
  [[nodiscard]] static Result<GigeDeviceModel> create(const GigeCameraConfig& config);

  /// One datagram on the control port. Allocates.
  [[nodiscard]] GvcpAnswer handle_gvcp(Endpoint from, Bytes datagram, DeviceTime now);
  /// Takes the privilege from a controller whose heartbeat is overdue. True where it did (acquisition then
  /// ended).
  bool expire_heartbeat(DeviceTime now);

  /// Line1 rises at `rise` and falls at `fall`; edges come in order. What the camera is set to take for a
  /// trigger exposes as soon as its delay is over; while the sensor is busy it is missed.
  void pulse_line(DeviceTime rise, DeviceTime fall);
  /// Start of the next exposure, or never().
  [[nodiscard]] DeviceTime next_exposure() const;
  /// Opens the exposure that starts at or before `now`. Where more than one is overdue, the grid of frame
  /// times is kept and what lies a period or more behind `now` is skipped and counted. False: nothing due, or
  /// no client.
  [[nodiscard]] bool begin_frame(DeviceTime now, FrameJob& job);
  /// Closes it. Nothing comes out where `filled` is false, or acquisition or stream ended meanwhile.
  [[nodiscard]] std::optional<OutgoingBlock> finish_frame(FrameJob&& job, bool filled);

  /// The port that stream packets come from, for GevSCSP.
  void set_stream_source_port(std::uint16_t port) { stream_source_port_ = port; }
  [[nodiscard]] bool acquiring() const { return acquiring_; }
  [[nodiscard]] bool controlled() const { return privilege_ != 0; }
  [[nodiscard]] Endpoint controller() const { return owner_; }
  [[nodiscard]] Endpoint stream_destination() const { return {stream_ip_, stream_port_}; }
  [[nodiscard]] const GigeModelCounters& counters() const { return counters_; }
  [[nodiscard]] const GigeCameraConfig& config() const { return config_; }
  [[nodiscard]] const std::string& genicam_xml() const { return xml_; }
  [[nodiscard]] DiscoveryAck identity() const;
  /// The registers that a camera of this configuration has.
  [[nodiscard]] static RegisterTable registers(const GigeCameraConfig& config);

 private:
  explicit GigeDeviceModel(const GigeCameraConfig& config);
  [[nodiscard]] GvStatus read_u32(std::uint32_t address, Endpoint from, std::uint32_t& value) const;
  [[nodiscard]] GvStatus write_registers(std::uint32_t address, Bytes data, Endpoint from, DeviceTime now,
                                         GvcpAnswer& answer);
  [[nodiscard]] GvStatus write_number(const Register& r, std::uint64_t bits, const Change& change);
  [[nodiscard]] bool within_bounds(const Register& r, std::uint64_t& bits) const;
  static GvStatus write_privilege(GigeDeviceModel& m, std::uint64_t value, const Change& change);
  static GvStatus write_packet_size(GigeDeviceModel& m, std::uint64_t value, const Change& change);
  static void add_range_rows(RegisterTable& table);
  static void add_ptp_rows(RegisterTable& table);
  void set_trigger(std::uint32_t& part, std::uint64_t value, DeviceTime now);
  void enable_ptp(bool on, DeviceTime now);
  /// Empty: the command is not for this camera, which says nothing to it.
  [[nodiscard]] std::optional<GvStatus> act(const ActionCmd& command, DeviceTime now);
  /// Scheduled actions whose time has come.
  void run_actions(DeviceTime now);
  void assert_action(DeviceTime t);
  [[nodiscard]] GvStatus software_trigger(DeviceTime now);
  [[nodiscard]] bool is_owner(Endpoint from) const { return privilege_ != 0 && from == owner_; }
  [[nodiscard]] bool params_locked() const { return acquiring_ || tl_params_locked_ != 0; }
  [[nodiscard]] Period period() const;
  [[nodiscard]] bool on_line() const {
    return trigger_mode_ != 0 && trigger_source_ == reg::kTriggerSourceLine1;
  }
  [[nodiscard]] bool on_action() const {
    return trigger_mode_ != 0 && trigger_source_ == reg::kTriggerSourceAction0;
  }
  [[nodiscard]] Duration trigger_delay() const { return seconds_from(trigger_delay_us_ * 1e-6); }
  /// The first edge of the wired pulses that counts, at or after `t`.
  [[nodiscard]] DeviceTime wired_edge(DeviceTime t) const;
  [[nodiscard]] std::int64_t wired_index(DeviceTime t) const;
  [[nodiscard]] DeviceTime wired_at(std::int64_t k) const;
  void rewire(DeviceTime now);
  void miss_edges();
  [[nodiscard]] bool line_high(DeviceTime t) const;
  [[nodiscard]] std::uint32_t ptp_status(DeviceTime now) const;
  [[nodiscard]] std::int64_t ptp_offset_ns(DeviceTime now) const;
  [[nodiscard]] std::size_t chunk_bytes() const;
  /// Pictures of a frame, without chunks.
  [[nodiscard]] std::size_t frame_bytes() const;
  void describe_parts(const FrameRequest& request, GvspLeader& leader) const;
  [[nodiscard]] bool sends_range() const {
    return config_.range.present && (!multipart_ || (components_ & (1u << kRange)) != 0);
  }
  [[nodiscard]] bool sends_amplitude() const { return multipart_ && (components_ & (1u << kIntensity)) != 0; }
  void append_chunks(const FrameRequest& request, std::vector<std::uint8_t>& data) const;
  [[nodiscard]] DeviceTime on_grid(DeviceTime t) const;
  /// Free running from `t` on: instants are counted from here, so that they do not drift.
  void run_freely_from(DeviceTime t);
  [[nodiscard]] std::uint64_t ticks(DeviceTime t) const;
  [[nodiscard]] std::shared_ptr<GvspBlock> new_block();
  void dispatch(const GvcpRequest& q, Endpoint from, DeviceTime now, GvcpAnswer& answer);
  void resend(const PacketResendCmd& c, Endpoint from, GvcpAnswer& answer);
  void start_acquisition(DeviceTime now);
  void stop_acquisition();
  void release_control();
  void open_stream(std::uint16_t port);
  void restart_blocks();
  void build_bootstrap();

  static constexpr std::size_t kActionQueue = 16;

  GigeCameraConfig config_;
  RegisterTable registers_;
  std::string xml_;
  std::array<std::uint8_t, reg::kBootstrapEnd> bootstrap_{};

  // Control.
  std::uint32_t privilege_ = 0;
  Endpoint owner_;
  DeviceTime last_heartbeat_;
  std::uint32_t heartbeat_timeout_ms_ = 3000;
  struct LastAck {
    Endpoint from;
    Datagram request, ack;
  } last_ack_, last_action_;  // a client that lost our acknowledge asks again; it must not trigger twice

  // Clock.
  DeviceTime timestamp_zero_;
  std::uint64_t latched_ticks_ = 0;

  // Stream channel.
  std::uint16_t stream_port_ = 0, stream_source_port_ = 0;
  std::uint32_t stream_ip_ = 0, packet_size_ = 1400, packet_delay_ticks_ = 0;
  bool do_not_fragment_ = false;

  // Features.
  Region region_;
  PixelFormat format_ = PixelFormat::mono8;
  std::uint32_t mode_ = reg::kModeContinuous, frame_count_ = 1, tl_params_locked_ = 0;
  std::uint32_t trigger_mode_ = 0, frame_rate_enable_ = 1;
  double frame_rate_hz_ = 25, exposure_us_ = 10'000, gain_db_ = 0;
  std::uint32_t trigger_source_ = reg::kTriggerSourceSoftware, trigger_activation_ = reg::kRisingEdge;
  double trigger_delay_us_ = 0;
  std::uint32_t chunk_mode_ = 0, chunk_selector_ = reg::kChunkTimestamp;
  std::uint32_t chunks_ = 1u << reg::kChunkImage;  ///< bit by id
  bool multipart_ = false;
  std::uint32_t component_selector_ = kRange, components_ = 1u << kRange | 1u << kIntensity;  ///< bit by id

  // Action commands.
  std::uint32_t gvcp_configuration_ = 0, action_device_key_ = 0, action_group_key_ = 0,
                action_group_mask_ = 0;
  std::deque<DeviceTime> actions_;  ///< scheduled, in the order of their times

  // IEEE 1588.
  bool ptp_enabled_ = false;
  DeviceTime ptp_since_;
  std::int64_t latched_ptp_offset_ns_ = 0;
  DeviceTime now_;  ///< of the last datagram

  // Acquisition.
  bool acquiring_ = false;
  std::uint64_t epoch_ = 0, index_ = 0;
  std::optional<std::uint64_t> frames_left_;
  DeviceTime next_free_run_, sensor_free_;
  Period free_run_;  ///< the period of next_free_run_, which is free_run_zero_ + free_run_·free_run_index_
  DeviceTime free_run_zero_;
  std::int64_t free_run_index_ = 0;
  std::deque<DeviceTime> triggers_;  ///< starts of exposures that were asked for, the delay included
  DeviceTime next_wired_ = DeviceTime::never();  ///< edge of the wired pulses, without the delay
  DeviceTime pulse_rise_, pulse_fall_;
  std::uint64_t next_block_id_ = 1;
  std::deque<std::shared_ptr<GvspBlock>> retained_;
  std::vector<std::shared_ptr<GvspBlock>> pool_;
  GigeModelCounters counters_;
};

}  // namespace rigor::gige

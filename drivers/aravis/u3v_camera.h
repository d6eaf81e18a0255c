// A USB3 Vision camera without a bus: registers, control protocol, exposures, and the transfers of each
// frame. It is handed commands and an instant, and hands acknowledges back; it starts no thread, opens no
// socket and reads no clock.
//
//   camera.handle(command, now, acks);                  // what came on the control endpoint
//   if (camera.next_exposure() <= now) {
//     FrameJob job;
//     if (camera.begin_frame(now, job)) {               // exposure starts: which picture, of which region
//       bool ok = fill(job.request, job.picture());     // outside of any lock
//       auto frame = camera.finish_frame(std::move(job), ok);
//     }
//   }
//
// Pictures, region, formats and limits are those of a GigeCameraConfig; what is of a network there means
// nothing here. Its timestamp counts nanoseconds of the clock that it is handed. One caller at a time.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/aravis/exposure_schedule.h"
#include "drivers/aravis/gige_device_model.h"
#include "drivers/aravis/u3v_codec.h"
#include "drivers/aravis/u3v_registers.h"
#include "rt-core/result.h"

namespace rigor::u3v {

struct CameraOptions {
  gige::GigeCameraConfig camera;
  /// How long a host is to wait for an answer. Aravis waits as long for each transfer of the stream, and
  /// loses what comes at the instant at which it gives up: longer than the longest pause between two frames
  /// is best.
  std::uint32_t response_ms = 1000;
  /// What AcquisitionStart takes; above the response time the host is told by PENDING_ACK.
  Duration start_delay;
};

/// Registers by name; the table in u3v_camera_registers.cpp says where each is.
struct CameraState {
  std::uint32_t gencp_version = 0x00010002, response_ms = 0, heartbeat_ms = 0, message_channel = 0;
  std::uint32_t privilege = 0, protocol_endianness = reg::kLittleEndian,
                implementation_endianness = reg::kLittleEndian;
  std::string vendor, model, family = "Rigor", version, info, serial, user_name;
  std::uint64_t capability = 0, manifest_address = reg::kManifest, sbrm_address = reg::kSbrm,
                configuration = 0, timestamp_ns = 0, timestamp_increment_ns = 1;
  std::uint32_t u3v_version = 0x00010001, max_command = reg::kMaxTransfer, max_ack = reg::kMaxTransfer;
  std::uint32_t stream_channels = 1, speed = reg::kSuperSpeed;
  std::uint32_t sirm_length = reg::kSirmEnd - reg::kSirm, eirm_length = reg::kEirmEnd - reg::kEirm;
  std::uint64_t u3v_capability = reg::kSirmAvailable | reg::kEirmAvailable, u3v_configuration = 0;
  std::uint64_t sirm_address = reg::kSirm, eirm_address = reg::kEirm, iidc2_address = 0;
  // Streaming and event interface.
  std::uint32_t stream_info = reg::kAlignmentLog2 << 24, stream_control = 0;
  std::uint64_t required_payload = 0;
  std::uint32_t required_leader = kLeaderBytes, required_trailer = kTrailerBytes;
  std::uint32_t max_leader = 0, transfer_size = 0, transfer_count = 0, final_transfer1 = 0,
                final_transfer2 = 0, max_trailer = 0;
  std::uint32_t event_control = 0, max_event = kHeaderBytes + kEventBytes;
  // Features.
  std::uint32_t sensor_width = 0, sensor_height = 0, width = 0, height = 0, offset_x = 0, offset_y = 0;
  std::uint32_t pixel_format = 0, payload_size = 0, locked = 0;
  std::uint32_t acquisition_mode = reg::kModeContinuous, frame_count = 1, acquiring = 0, rate_enable = 1;
  double rate_hz = 25, resulting_rate_hz = 25, exposure_us = 10'000, gain_db = 0, trigger_delay_us = 0;
  std::uint32_t trigger_mode = 0, trigger_source = reg::kTriggerSourceSoftware,
                trigger_activation = reg::kRisingEdge, line_status = 0, event_notification = 0;
  std::uint32_t command = 0;  ///< what commands read as: 0, they are done
};

/// An acknowledge and when it is to leave.
struct TimedAck {
  DeviceTime due;
  std::vector<std::uint8_t> bytes;
};

class FrameJob {
 public:
  gige::FrameRequest request;
  DeviceTime t_send;  ///< the leader leaves no earlier
  [[nodiscard]] std::span<std::uint8_t> picture() {
    return payload ? std::span<std::uint8_t>(*payload) : std::span<std::uint8_t>();
  }

 private:
  friend class Camera;
  std::shared_ptr<std::vector<std::uint8_t>> payload;
  std::uint64_t epoch = 0;
};

/// What goes over the stream's endpoint, in this order.
struct Frame {
  struct Part {
    std::size_t at = 0, bytes = 0;
  };
  std::uint64_t block_id = 0, epoch = 0;
  DeviceTime t_send;
  std::vector<std::uint8_t> leader, trailer;
  std::shared_ptr<const std::vector<std::uint8_t>> payload;
  std::vector<Part> transfers;  ///< of the payload, as the streaming interface is set
};

struct CameraCounters {
  std::uint64_t commands = 0, malformed = 0, refused = 0;
  std::uint64_t frames = 0, pictures_missing = 0,
                truncated = 0;  ///< truncated: the host's transfers are too small
};

class Camera {
 public:
  /// bad_input for a configuration that contradicts itself or describes a 3D camera or a PTP clock.
  [[nodiscard]] static Result<Camera> create(const CameraOptions& options);

  /// As when its plug goes in: registers are as they were made, nothing streams. Counters go on.
  void power_on();
  /// A transfer on the control endpoint. Appends its acknowledge, behind a PENDING_ACK where it takes long;
  /// nothing where the bytes are no command or none is asked for.
  void handle(Bytes command, DeviceTime now, std::vector<TimedAck>& acks);
  /// The stream's endpoint was reset: a frame that is being sent is given up.
  void reset_stream() { ++epoch_; }

  [[nodiscard]] DeviceTime next_exposure() const { return schedule_.next(); }
  [[nodiscard]] bool begin_frame(DeviceTime now, FrameJob& job);
  /// Empty where `filled` is false, or acquisition or stream ended meanwhile.
  [[nodiscard]] std::optional<Frame> finish_frame(FrameJob&& job, bool filled);
  /// A frame of this epoch may still be sent.
  [[nodiscard]] bool current(std::uint64_t epoch) const { return epoch == epoch_; }
  /// Events since the last call, for the event endpoint.
  [[nodiscard]] std::vector<std::vector<std::uint8_t>> take_events();

  [[nodiscard]] const CameraState& state() const { return state_; }
  [[nodiscard]] const CameraOptions& options() const { return options_; }
  [[nodiscard]] const std::string& genicam_xml() const { return *xml_; }
  [[nodiscard]] const CameraCounters& counters() const { return counters_; }
  [[nodiscard]] const ExposureSchedule::Counters& exposures() const { return schedule_.counters(); }
  [[nodiscard]] bool streaming() const { return (state_.stream_control & reg::kStreamEnable) != 0; }

 private:
  explicit Camera(const CameraOptions& options);
  // u3v_camera_registers.cpp
  [[nodiscard]] Status read(std::uint64_t address, std::span<std::uint8_t> out, DeviceTime now);
  [[nodiscard]] Status write(std::uint64_t address, Bytes data, DeviceTime now);
  [[nodiscard]] Status set(std::uint64_t address, Bytes value, DeviceTime now);
  [[nodiscard]] Status set_feature(std::uint64_t address, std::uint32_t value, DeviceTime now);
  [[nodiscard]] Status set_real(std::uint64_t address, double value, DeviceTime now);
  [[nodiscard]] Status set_region(std::uint64_t address, std::uint32_t value);
  [[nodiscard]] Status enable_stream(std::uint32_t value);
  void refresh(DeviceTime now);
  // u3v_camera.cpp
  [[nodiscard]] bool locked() const { return state_.acquiring != 0 || state_.locked != 0; }
  [[nodiscard]] Region region() const {
    return {state_.offset_x, state_.offset_y, state_.width, state_.height};
  }
  [[nodiscard]] Period period() const;
  void set_schedule(DeviceTime now);
  void start_acquisition(DeviceTime now);
  void stop_acquisition();
  void raise_event(std::uint16_t id, DeviceTime t);
  [[nodiscard]] std::shared_ptr<std::vector<std::uint8_t>> new_payload();

  CameraOptions options_;
  std::shared_ptr<const std::string> xml_;
  std::shared_ptr<const std::vector<std::uint8_t>> manifest_;
  CameraState state_;
  ExposureSchedule schedule_;
  std::uint64_t epoch_ = 0, next_block_ = 0;
  std::optional<std::uint64_t> frames_left_;
  std::uint16_t next_event_ = 0;
  std::vector<std::vector<std::uint8_t>> events_;
  std::vector<std::shared_ptr<std::vector<std::uint8_t>>> pool_;
  CameraCounters counters_;
};

}  // namespace rigor::u3v

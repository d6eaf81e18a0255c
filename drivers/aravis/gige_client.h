// The other end of the wire, for where no network is: a small GigE Vision client over any byte transport. It
// drives the emulated camera in virtual time and in tests, through the same datagrams that a client on the
// network sends. (Real cameras are driven by Aravis.) It knows the emulated camera's registers from
// gige_registers.h, so it parses no XML.
//
//   GigeClient client(link);
//   client.connect();  client.set_exposure(milliseconds(5));  client.start();
//   ... link.advance(now); while (client.poll(now, frame)) use(frame); ...
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "drivers/aravis/gige_device_model.h"
#include "drivers/aravis/gvsp_assembler.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::gige {

/// Datagrams to and from one camera. A receive returns the length of the next datagram, 0 where there is none
/// (yet).
class GigeTransport {
 public:
  virtual ~GigeTransport() = default;
  virtual void send_control(Bytes datagram) = 0;
  [[nodiscard]] virtual std::size_t receive_control(MutableBytes out) = 0;
  /// To the camera's control port from where the stream arrives: requests for a resend.
  virtual void send_from_stream(Bytes datagram) = 0;
  [[nodiscard]] virtual std::size_t receive_stream(MutableBytes out) = 0;
  /// Where the camera shall send the stream.
  [[nodiscard]] virtual Endpoint stream_endpoint() const = 0;
};

enum class AcquisitionMode : std::uint8_t { continuous = 0, single_frame = 1, multi_frame = 2 };

struct GigeClientOptions {
  int attempts = 3;  ///< of a command whose acknowledge does not come
  std::uint32_t packet_size = 1400;
  std::uint32_t heartbeat_timeout_ms = 3000;
  /// Packet size and payload are set from the camera at start().
  GvspAssemblerOptions stream = {};
  /// What a camera may ask for as one frame: memory is taken for several of them.
  std::uint32_t max_payload_bytes = 1u << 30;
};

/// One thread. Every Status and Result is `protocol` with the camera's own status where it refused, `timeout`
/// where no acknowledge came.
class GigeClient {
 public:
  explicit GigeClient(GigeTransport& transport, const GigeClientOptions& options = {});

  [[nodiscard]] Result<DiscoveryAck> discover();
  /// Takes control and sets heartbeat, packet size and stream destination.
  [[nodiscard]] Status connect();
  [[nodiscard]] Status disconnect();

  [[nodiscard]] Result<std::uint32_t> read(std::uint32_t address);
  [[nodiscard]] Status write(std::uint32_t address, std::uint32_t value);
  [[nodiscard]] Result<double> read_double(std::uint32_t address);
  [[nodiscard]] Status write_double(std::uint32_t address, double value);
  [[nodiscard]] Result<std::vector<std::uint8_t>> read_memory(std::uint32_t address, std::size_t size);
  /// Follows the first URL register.
  [[nodiscard]] Result<std::string> read_genicam_xml();

  [[nodiscard]] Status set_region(const Region& region);
  [[nodiscard]] Status set_pixel_format(PixelFormat format);
  [[nodiscard]] Status set_exposure(Duration exposure);
  [[nodiscard]] Status set_gain(double gain_db);
  [[nodiscard]] Status set_frame_rate(double rate_hz);
  [[nodiscard]] Status set_acquisition(AcquisitionMode mode, std::uint32_t frame_count = 1);
  [[nodiscard]] Status set_software_trigger(bool on);
  /// Multi-part frames of a 3D camera, with these components (kRange, kIntensity), from the next start() on.
  [[nodiscard]] Status set_parts(bool range, bool amplitude);
  [[nodiscard]] Status start();
  [[nodiscard]] Status stop();
  [[nodiscard]] Status trigger();
  /// Sends an action command; what the camera answers, `timeout` where the command is not for it.
  [[nodiscard]] Result<GvStatus> action(const ActionCmd& command);
  /// Keeps control: call more often than the heartbeat timeout. wrong_state where control is lost.
  [[nodiscard]] Status heartbeat();

  /// Takes in what arrived, asks for what is missing, and hands out the next frame, complete or marked
  /// incomplete.
  [[nodiscard]] bool poll(DeviceTime now, AssembledFrame& out);
  [[nodiscard]] GvspAssemblerCounters counters() const;

 private:
  /// The acknowledge, whatever its status.
  [[nodiscard]] Result<GvcpAck> ask(const Datagram& command, GvcpCommand expected_ack);
  /// One that says success.
  [[nodiscard]] Result<GvcpAck> transact(const Datagram& command, GvcpCommand expected_ack);
  [[nodiscard]] std::uint16_t next_id();

  GigeTransport* transport_;
  GigeClientOptions options_;
  std::uint16_t id_ = 0;
  std::vector<std::uint8_t> control_buffer_, stream_buffer_;
  std::optional<GvspAssembler> assembler_;
  std::size_t parts_ = 0;  ///< of a frame, all of the same size; 0: no multi-part frames
};

}  // namespace rigor::gige

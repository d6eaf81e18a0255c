// A simulated channel as a GigE Vision camera on the network: UDP sockets and threads around GigeDeviceModel.
//
//   control thread   answers GVCP on <address>:3956, and discovery and actions that were broadcast on its
//   interface frame thread     wakes at the start of each exposure and asks FillFrame for the picture; the
//   time until the
//                    packets are due is exposure time + readout
//   send thread      sends blocks at the pace of the link that is modelled, and resends in between
//
// One camera for each address; on loopback 127.0.0.1, 127.0.0.2, … are all there without any set-up.
// Timestamps are CLOCK_MONOTONIC of this machine until a client resets the counter. A client can neither stop
// nor slow the emulator: a datagram costs bounded time and memory, what breaks the protocol is counted and
// dropped, and resends go only where the stream goes.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "drivers/aravis/gige_device_model.h"
#include "rt-core/result.h"

namespace rigor::gige {

struct GigeEmulatorOptions {
  GigeCameraConfig camera;  ///< ip and mask are set from `address`
  std::string address = "127.0.0.1";
  std::uint16_t port = kGvcpPort;  ///< clients of the standard look for 3956; 0: any, for tests
  /// Packets leave no faster than on a link of this rate; the burst fits any client's socket buffer.
  double link_bits_per_s = 1e9;
  bool answer_broadcasts = true;
};

struct GigeEmulatorHealth {
  std::uint64_t frames_sent = 0, packets_sent = 0, bytes_sent = 0, send_errors = 0;
  std::uint64_t exposures_skipped = 0;  ///< the picture before took longer than a period
  std::uint64_t pictures_missing = 0;   ///< FillFrame had none
  std::uint64_t pictures_late = 0;      ///< came after the first packet was due
  std::uint64_t blocks_dropped = 0;     ///< the link could not keep up with the frame rate
  std::uint64_t resend_requests = 0, packets_resent = 0, resends_unavailable = 0, resends_dropped = 0;
  std::uint64_t line_edges = 0, line_missed = 0;  ///< taken, and while the sensor was busy
  std::uint64_t actions = 0, actions_late = 0, actions_refused = 0,
                actions_missed = 0;  ///< GigeModelCounters
  std::uint64_t gvcp_requests = 0, malformed = 0, refused = 0, heartbeat_expired = 0;
  bool controlled = false, acquiring = false;
};

class GigeEmulator {
 public:
  /// Binds and starts. bad_input for a configuration that contradicts itself or an address that is no IPv4
  /// address; unavailable where the address is not this machine's or another camera holds it. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<GigeEmulator>> start(const GigeEmulatorOptions& options,
                                                                   FillFrame fill);
  GigeEmulator(const GigeEmulator&) = delete;
  GigeEmulator& operator=(const GigeEmulator&) = delete;
  ~GigeEmulator();  ///< stop()

  /// Ends acquisition and joins the threads; a FillFrame call in progress is waited for. Idempotent.
  void stop();
  /// Pulses the camera's Line1 now, for `width`. Any thread.
  void pulse_line(Duration width = microseconds(100));
  [[nodiscard]] GigeEmulatorHealth health() const;  ///< any thread
  [[nodiscard]] std::uint16_t port() const;         ///< of the control channel

 private:
  GigeEmulator();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::gige

// A simulated channel as a USB3 Vision camera that a host imports by USB/IP: a TCP server and threads around
// UsbDevice.
//
//   server thread   lists the camera, hands it to the first host that imports it, carries its transfers
//   frame thread    wakes at the start of each exposure and asks FillFrame for the picture
//   send thread     hands frames to the stream's endpoint when a link of the bus's rate would have carried
//   them
//
//   sudo modprobe vhci-hcd
//   sudo usbip attach -r 127.0.0.1 -b 1-1
//
// Timestamps are CLOCK_MONOTONIC of this machine. A host can neither stop nor slow the emulator: frames that
// it does not take are dropped and counted.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "drivers/aravis/u3v_camera.h"
#include "rt-core/result.h"

namespace rigor::u3v {

struct EmulatorOptions {
  CameraOptions camera;
  std::string address = "127.0.0.1";
  std::uint16_t port = 3240;  ///< 0: any, for tests
  std::string bus_id = "1-1";
  double link_bits_per_s = 3.2e9;  ///< what SuperSpeed carries of pictures
};

struct EmulatorHealth {
  std::uint64_t frames_sent = 0, frames_dropped = 0, frames_cut = 0, bytes_sent = 0;
  std::uint64_t exposures_skipped = 0, pictures_missing = 0, pictures_late = 0, truncated = 0;
  std::uint64_t line_edges = 0, line_missed = 0;
  std::uint64_t commands = 0, malformed = 0, refused = 0;  ///< of the control endpoint
  std::uint64_t attached = 0, bus_errors = 0;              ///< bus_errors: what was no USB/IP
  bool imported = false, acquiring = false;
};

class Emulator {
 public:
  /// Listens and starts. bad_input for a configuration that contradicts itself; unavailable where the address
  /// is not this machine's or the port is taken. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<Emulator>> start(const EmulatorOptions& options,
                                                               gige::FillFrame fill);
  Emulator(const Emulator&) = delete;
  Emulator& operator=(const Emulator&) = delete;
  ~Emulator();  ///< stop()

  /// Ends the connection and joins the threads. Idempotent.
  void stop();
  /// As a cable that is pulled, and plugged in again: the host loses the camera, which begins anew as after
  /// power-on and can be imported again. Any thread.
  void unplug();
  void plug();
  [[nodiscard]] EmulatorHealth health() const;  ///< any thread
  [[nodiscard]] std::uint16_t port() const;

 private:
  Emulator();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::u3v

// A camera and its client in one process, datagram for datagram, without a socket, a thread or a clock: what
// stands in for a GigE Vision channel in virtual time. Everything happens inside the calls, in an order that
// time alone decides, so that two runs are equal byte for byte.
//
//   GigeMemoryLink link(model, fill);
//   GigeClient client(link);
//   for (t = …) { link.advance(t); while (client.poll(t, frame)) …; t = link.next_event(); }
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <vector>

#include "drivers/aravis/gige_client.h"
#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {

class GigeMemoryLink final : public GigeTransport {
 public:
  /// Both references stay the caller's and outlive the link.
  GigeMemoryLink(GigeDeviceModel& model, FillFrame fill, Endpoint client = {0x7F000001, 50000});

  /// Runs the camera up to `now`: each exposure at its own instant, none skipped, each block when it is due.
  /// `now` must not run backwards.
  void advance(DeviceTime now);
  /// When advance() next has something to do; never() where only a command can change that.
  [[nodiscard]] DeviceTime next_event() const;
  /// Asked for every datagram of the stream, resent ones included; true loses it. For tests and fault
  /// injection.
  std::function<bool(Bytes)> lose;

  void send_control(Bytes datagram) override;
  [[nodiscard]] std::size_t receive_control(MutableBytes out) override;
  void send_from_stream(Bytes datagram) override;
  [[nodiscard]] std::size_t receive_stream(MutableBytes out) override;
  [[nodiscard]] Endpoint stream_endpoint() const override;

 private:
  void handle(Endpoint from, Bytes datagram);
  void transmit(const GvspBlock& block, std::uint32_t first, std::uint32_t last);
  void deliver(std::size_t length);

  GigeDeviceModel* model_;
  FillFrame fill_;
  Endpoint control_, stream_;
  DeviceTime now_;
  std::deque<OutgoingBlock> blocks_;
  std::deque<Datagram> to_control_, to_stream_;
  std::vector<Datagram> spare_;
  Datagram scratch_;
};

}  // namespace rigor::gige

// A server's side of one USB/IP connection: bytes in, bytes out. It lists the device, hands it to a host that
// imports it, and from then on carries that host's transfers to it. No sockets, no threads, no clock.
//
//   usbip::Session session(device);
//   if (!session.receive(in, out)) close();      // takes what is whole from `in`, appends to `out`
//   session.pump(out);                           // the device has something to send
//
// A host has bounded memory here: an OUT transfer of at most 1 MiB, 1024 IN transfers in flight. What goes
// beyond, and what is no USB/IP, ends the connection.
#pragma once

#include <deque>
#include <map>
#include <utility>

#include "drivers/network/usbip_device.h"

namespace rigor::usbip {

inline constexpr std::size_t kMaxOutBytes = 1 << 20, kMaxTransfers = 1024;
/// A host asks for no more in one transfer; what asks for more gets this much.
inline constexpr std::size_t kMaxInBytes = 16 << 20;

struct SessionCounters {
  std::uint64_t submits = 0, unlinks = 0, unlinked = 0, stalls = 0, malformed = 0;
};

class Session {
 public:
  explicit Session(Device& device) : device_(&device) {}
  ~Session() { end(); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// False: the connection is to be closed once `out` is sent.
  [[nodiscard]] bool receive(std::string& in, std::string& out);
  /// Answers the transfers that the device has data for, in the order in which they came.
  void pump(std::string& out);
  /// Gives the device back. Idempotent.
  void end();
  [[nodiscard]] bool attached() const { return attached_; }
  [[nodiscard]] const SessionCounters& counters() const { return counters_; }

 private:
  enum class Taken : std::uint8_t { more, whole, close };
  /// One message from the front of `in`; `used` says how much it was.
  [[nodiscard]] Taken take(Bytes in, std::size_t& used, std::string& out);
  [[nodiscard]] Taken take_operation(Bytes in, std::size_t& used, std::string& out);
  [[nodiscard]] Taken submit(const Header& h, Bytes in, std::size_t& used, std::string& out);
  void unlink(const Header& h, std::string& out);
  void control(const Header& h, Bytes data, std::string& out);
  /// The return of a transfer; `status` below 0: nothing went over.
  static void reply(std::uint32_t sequence, std::int32_t status, std::uint32_t length, std::string& out);

  struct Waiting {
    std::uint32_t sequence = 0, length = 0;
  };
  Device* device_;
  bool attached_ = false;
  std::map<std::uint8_t, std::deque<Waiting>> waiting_;
  std::size_t in_flight_ = 0;
  SessionCounters counters_;
};

}  // namespace rigor::usbip

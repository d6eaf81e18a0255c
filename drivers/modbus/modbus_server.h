// A Modbus server over a RegisterModel: the part that every emulated device shares, on TCP, on serial lines
// and on the in-memory sockets of virtual time alike.
//
// One thread serves all clients with non-blocking descriptors. A client that sends half a request, garbage,
// or nothing costs its own connection and nothing else. On a serial line a request for another unit is not
// answered, one for unit 0 (all of them) is carried out and not answered, and what is no frame is dropped at
// the next silence; requests of a line are served one after the other.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "drivers/modbus/rtu_codec.h"
#include "drivers/modbus/server_faults.h"
#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::modbus {

class Server {
 public:
  enum class Framing : std::uint8_t { tcp, rtu };
  struct Options {
    unsigned max_clients = 8;  ///< one more is turned away at once
    /// A client without a whole request for so long is dropped, whatever bytes it sends; 0: never.
    Duration idle_limit = seconds(60);
    /// Who answers. On TCP none: whatever unit is asked; else exception 11 for any but it, 0 and 255. On a
    /// line none is unit 1.
    std::optional<std::uint8_t> unit;
    /// Clients of virtual time: a request that is not to be answered ends the connection, since nobody can
    /// wait there.
    bool silence_closes = false;
  };
  struct Counters {
    std::atomic<std::uint64_t> requests{0}, exceptions{0}, malformed{0}, turned_away{0}, dropped{0};
    std::atomic<std::uint64_t> other_units{0}, broadcasts{0};  ///< of serial lines
    std::atomic<std::uint32_t> clients{0};
  };
  /// Of a serial line. `paced`: the times that bytes take on the wire are waited for (a pseudo-terminal has
  /// none).
  struct Line {
    LineTimes times;
    bool paced = false;
  };

  /// `now` gives the instant at which the model is asked; server thread. `faults` may be shared by servers.
  Server(std::shared_ptr<RegisterModel> model, std::function<BenchTime()> now, Options options,
         std::shared_ptr<FaultBox> faults = nullptr);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Binds and listens; port 0 takes a free one. not_found for an address this machine does not have,
  /// unavailable for a port that is taken or not allowed. Setup thread, before start.
  [[nodiscard]] Status listen(const std::string& address, std::uint16_t port);
  /// The port that is listened on; 0 before.
  [[nodiscard]] std::uint16_t port() const noexcept { return port_; }
  /// Makes a client out of a connected stream socket. Setup thread, before start.
  void adopt(int socket, Framing framing = Framing::tcp);
  /// Serves a serial line. The descriptor is not blocking and stays the caller's. Setup thread, before start.
  void serve_line(int descriptor, const Line& line);

  /// Called on the server's thread with the number of clients whenever it changes. A line counts as one from
  /// its first request until it was idle for `idle_limit`. Setup thread, before start.
  void on_clients(std::function<void(unsigned)> tell);

  /// Setup thread.
  [[nodiscard]] Status start();
  void stop();

  [[nodiscard]] FaultBox& faults() noexcept { return *faults_; }
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 private:
  struct Loop;
  std::shared_ptr<FaultBox> faults_;
  Counters counters_;
  std::unique_ptr<Loop> loop_;
  std::thread thread_;
  std::uint16_t port_ = 0;
};

}  // namespace rigor::modbus

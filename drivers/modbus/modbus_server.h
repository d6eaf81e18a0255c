// A Modbus TCP server over a RegisterModel: the part that every emulated device shares, on TCP and on the
// in-memory sockets of virtual time alike.
//
// One thread serves all clients with non-blocking sockets. Frames are put together here, so that a client
// that sends half a request, garbage, or nothing costs its own connection and nothing else; libmodbus makes
// the answers.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::modbus {

/// How a device misbehaves, to order. Counted over all requests of all clients.
struct ServerFaults {
  Duration response_delay{};          ///< from the request to the answer
  std::uint32_t exception_every = 0;  ///< each n-th request gets `exception_code`; 0: none
  std::uint8_t exception_code = 4;    ///< 4: server device failure
  std::uint32_t silent_every = 0;     ///< each n-th request gets no answer; 0: none
};

class Server {
 public:
  struct Options {
    unsigned max_clients = 8;           ///< one more is turned away at once
    Duration idle_limit = seconds(60);  ///< a client that says nothing for so long is dropped; 0: never
    ServerFaults faults;
  };
  struct Counters {
    std::atomic<std::uint64_t> requests{0}, exceptions{0}, malformed{0}, turned_away{0}, dropped{0};
    std::atomic<std::uint32_t> clients{0};
  };

  /// `now` gives the instant at which the model is asked; server thread.
  Server(std::shared_ptr<RegisterModel> model, std::function<BenchTime()> now, Options options);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Binds and listens; port 0 takes a free one. not_found for an address this machine does not have,
  /// unavailable for a port that is taken or not allowed. Setup thread, before start.
  [[nodiscard]] Status listen(const std::string& address, std::uint16_t port);
  /// The port that is listened on; 0 before.
  [[nodiscard]] std::uint16_t port() const noexcept { return port_; }
  /// Makes a client out of a connected stream socket. Setup thread, before start.
  void adopt(int socket);

  /// Called on the server's thread with the number of clients whenever it changes. Setup thread, before
  /// start.
  void on_clients(std::function<void(unsigned)> tell);

  /// Setup thread.
  [[nodiscard]] Status start();
  void stop();

  /// Any thread: from the next request on.
  void set_faults(const ServerFaults& faults);
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 private:
  struct Loop;
  std::unique_ptr<Loop> loop_;
  std::thread thread_;
  std::uint16_t port_ = 0;
  Counters counters_;
};

}  // namespace rigor::modbus

// A server of requests over TCP for emulated devices: some ports, some clients each, one thread. What clients
// send is bounded in size and time; who asks for more than it reads is dropped.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <thread>

#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::network {

class TcpServer {
 public:
  struct Client {
    std::string address;          ///< "127.0.0.1"
    std::string in;               ///< what has come and was not consumed
    std::string out;              ///< what is to be sent
    bool close = false;           ///< once `out` is sent
    std::shared_ptr<void> state;  ///< of whoever serves; let go with the connection
  };
  /// Server thread: there is more in `in`, or wake() was called; consumes what is whole and answers in `out`.
  using Serve = std::function<void(Client&)>;
  struct Limits {
    std::size_t clients = 8;        ///< of one port; more are turned away
    std::size_t request = 1 << 16;  ///< bytes of `in` that are not consumed
    std::size_t pending = 1 << 20;  ///< bytes of `out` that are not read
    Duration idle = seconds(30);    ///< without a byte either way
  };

  TcpServer() = default;
  ~TcpServer() { stop(); }
  TcpServer(const TcpServer&) = delete;
  TcpServer& operator=(const TcpServer&) = delete;

  /// Setup, before start; errors as of listen_tcp. Port 0: any; gives the one that it is.
  [[nodiscard]] Result<std::uint16_t> listen(const std::string& address, std::uint16_t port,
                                             const Limits& limits, Serve serve);
  [[nodiscard]] Status start();
  /// Any thread: every client is served once more, soon; for what is sent without being asked for.
  void wake();
  /// Ends the thread, drops clients and ports.
  void stop();

 private:
  struct Port {
    FileDescriptor socket;
    Limits limits;
    Serve serve;
  };
  struct Connection {
    FileDescriptor socket;
    const Port* port;
    Client client;
    MonotonicTime moved;
    bool dead = false;
  };
  void run();
  void accept(const Port& port);
  void receive(Connection& c);
  static void send(Connection& c);
  static void serve(Connection& c);

  std::list<Port> ports_;
  std::list<Connection> connections_;
  FileDescriptor wake_;
  std::atomic<bool> ending_{false};
  std::thread thread_;
};

}  // namespace rigor::network

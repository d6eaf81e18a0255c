// The live view's port: HTTP for the page's files, WebSockets for the hub, one thread for all of it, and one
// for services, which may take their time.
//
//   auto server = Server::open({.endpoint = …}, "demo");     // listens; a port in use is refused here
//   server->post([&] { server->hub().add_channel(…); server->hub().advertise_new(); });
//   server->every(milliseconds(40), [&] { server->hub().publish(…); });
//
// A client that is slow is dropped messages, one that is silent for a minute let go; what a client sends is
// limited in length, what it asks for in number. Boost.Beast stays behind this header.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "bench/live/access.h"
#include "bench/live/hub.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::live {

struct ServerOptions {
  Endpoint endpoint;
  std::string token;               ///< empty: none is asked for
  bool token_in_url = false;       ///< url() brings the token
  std::filesystem::path page_dir;  ///< empty: the files in the program
};

class Server {
 public:
  static constexpr std::size_t kMaxClients = 8;  ///< WebSockets
  static constexpr std::size_t kMaxConnections = 48;
  static constexpr std::size_t kMaxHeader = 8u << 10;
  static constexpr Duration kGoodbye = milliseconds(500);

  /// Listens, and answers from now on, on threads that may run where the caller may and are nicer than it.
  /// bad_input: the address is not this machine's, the port is taken or may not be used.
  [[nodiscard]] static Result<std::unique_ptr<Server>> open(const ServerOptions& options,
                                                            const std::string& name);
  ~Server();
  /// Any thread but the server's: runs `last` there, takes leave of the clients (code 1001, `run has ended`),
  /// gives them kGoodbye to answer, closes all connections and ends both threads. What clients ask for after
  /// the goodbye is dropped. Nothing that was given to this object is called any more; only url() may be.
  void end(std::function<void()> last);

  [[nodiscard]] std::string url() const;  ///< with the port that it got
  /// On the server's thread alone.
  [[nodiscard]] Hub& hub();
  /// Any thread: run it on the server's thread, soon.
  void post(std::function<void()> what);
  /// Any thread but the server's: the same, and wait until it has run.
  void run_there(std::function<void()> what);
  /// Any thread: from now on, each `period`, on the server's thread; a late one is not made up for.
  void every(Duration period, std::function<void()> what);

 private:
  struct Impl;
  explicit Server(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::live

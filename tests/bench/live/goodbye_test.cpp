// The end of the live view's server, seen by a client that does not answer.
#include <gtest/gtest.h>

#include <memory>

#include "bench/live/server.h"
#include "tests/bench/live/websocket_client.h"

namespace rigor::live {
namespace {

std::unique_ptr<Server> open_server() {
  ServerOptions options;
  options.endpoint = {"127.0.0.1", 0};
  auto server = Server::open(options, "test");
  EXPECT_TRUE(server) << server.error().text();
  return std::move(*server);
}

TEST(LiveGoodbye, ClosesTheConnectionOfWhoDoesNotAnswer) {
  const auto server = open_server();
  WebSocketClient client(server->url()), page(server->url());
  client.upgrade();
  page.send_bytes("GET /none HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
  EXPECT_TRUE(page.read_until("there is no such file"));
  server->end([] {});
  EXPECT_TRUE(client.read_until("run has ended"));
  EXPECT_TRUE(client.closed());  // the server is still there
  EXPECT_TRUE(page.closed());
}

}  // namespace
}  // namespace rigor::live

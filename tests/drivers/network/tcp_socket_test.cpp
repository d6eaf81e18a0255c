// TCP sockets: who is connected to, for how long that is tried, and where a device is served.
#include "drivers/network/tcp_socket.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <vector>

namespace rigor::network {
namespace {

using ::testing::HasSubstr;

MonotonicTime in(Duration d) { return monotonic_now() + d; }

/// A listener whose queue is full: what connects next is neither taken nor refused.
struct FullListener {
  FullListener() {
    for (int i = 0; i < 64; ++i) {
      auto made = connect_tcp("127.0.0.1", listener.port, in(milliseconds(30)));
      if (!made) return;
      clients.push_back(std::move(*made));
    }
  }
  TcpListener listener = listen_tcp("127.0.0.1", 0, "nothing").value();
  std::vector<FileDescriptor> clients;
};

TEST(TcpSocket, ConnectsByNameAndByBothKindsOfAddress) {
  for (const char* address : {"127.0.0.1", "::1"}) {
    auto l = listen_tcp(address, 0, "a device");
    if (!l && std::string(address) == "::1") continue;  // a machine without IPv6
    ASSERT_TRUE(l) << l.error().text();
    ASSERT_NE(l->port, 0);
    auto near = connect_tcp(address, l->port, in(seconds(5)));
    ASSERT_TRUE(near) << near.error().text();
    const TcpClient far = accept_tcp(l->socket);
    ASSERT_TRUE(far.socket);
    EXPECT_EQ(far.address, address);
    ASSERT_EQ(::send(near->get(), "x", 1, 0), 1);
    ASSERT_EQ(wait_for_socket(far.socket.get(), POLLIN, in(seconds(5)), -1), 0);
    char c = 0;
    ASSERT_EQ(::recv(far.socket.get(), &c, 1, 0), 1);
    EXPECT_EQ(c, 'x');
    EXPECT_FALSE(accept_tcp(l->socket).socket) << "nobody else, and no waiting for them";
  }
  auto l = listen_tcp("localhost", 0, "a device");
  ASSERT_TRUE(l) << l.error().text();
  EXPECT_TRUE(connect_tcp("localhost", l->port, in(seconds(5))))
      << "of the addresses of the name, the one that is served";
  auto four = listen_tcp("127.0.0.1", 0, "a device");
  ASSERT_TRUE(four);
  EXPECT_TRUE(connect_tcp("localhost", four->port, in(seconds(5)))) << "also where another comes first";
}

TEST(TcpSocket, SaysWhoWasExpectedWhereNobodyListens) {
  std::uint16_t port = 0;
  {
    const auto l = listen_tcp("127.0.0.1", 0, "a device");
    port = l->port;
  }
  const auto refused = connect_tcp("127.0.0.1", port, in(seconds(5)), -1, "a scanner");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::not_found);
  EXPECT_EQ(refused.error().text(), "127.0.0.1:" + std::to_string(port) +
                                        ": expected a scanner that listens here, got: Connection refused");
  const auto nameless = connect_tcp("no host", 1, in(seconds(5)));
  ASSERT_FALSE(nameless);
  EXPECT_THAT(nameless.error().text(), HasSubstr("no host:1: expected a host name or address, got: "));
}

TEST(TcpSocket, GivesUpAtTheLimitAndWhenItIsCut) {
  const FullListener full;
  ASSERT_LT(full.clients.size(), 64u);
  const MonotonicTime before = monotonic_now();
  const auto late = connect_tcp("127.0.0.1", full.listener.port, in(milliseconds(20)));
  ASSERT_FALSE(late);
  EXPECT_THAT(late.error().text(), HasSubstr("Connection timed out"));
  EXPECT_GE(monotonic_now() - before, milliseconds(20));

  const FileDescriptor cut(::eventfd(1, EFD_CLOEXEC | EFD_NONBLOCK));
  const auto ended = connect_tcp("127.0.0.1", full.listener.port, in(seconds(3600)), cut.get());
  ASSERT_FALSE(ended) << "without waiting for an hour";
  EXPECT_THAT(ended.error().text(), HasSubstr("Operation canceled"));
  EXPECT_EQ(wait_for_socket(-1, POLLIN, monotonic_now(), -1), ETIMEDOUT);
}

TEST(TcpSocket, SaysWhyAnAddressIsNotServed) {
  const auto first = listen_tcp("127.0.0.1", 0, "Modbus");
  ASSERT_TRUE(first);
  const auto taken = listen_tcp("127.0.0.1", first->port, "Modbus");
  ASSERT_FALSE(taken);
  EXPECT_EQ(taken.error().code, ErrorCode::unavailable);
  EXPECT_THAT(taken.error().text(), HasSubstr("cannot serve Modbus here: Address already in use; another "
                                              "program has the port"));
  const auto foreign = listen_tcp("192.0.2.1", 0, "Modbus");  // TEST-NET-1: no machine's
  ASSERT_FALSE(foreign);
  EXPECT_EQ(foreign.error().code, ErrorCode::not_found);
  EXPECT_EQ(foreign.error().exit_status(), 2);
  const auto nameless = listen_tcp("no host", 0, "Modbus");
  ASSERT_FALSE(nameless);
  EXPECT_EQ(nameless.error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::network

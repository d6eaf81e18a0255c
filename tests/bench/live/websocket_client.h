// A WebSocket of the live view that answers nothing by itself.
#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <cerrno>
#include <optional>
#include <string>

#include "rt-core/byte_order.h"
#include "rt-core/file_descriptor.h"

namespace rigor::live {

class WebSocketClient {
 public:
  enum Opcode : std::uint8_t { kText = 1, kBinary = 2, kClose = 8, kPing = 9, kPong = 10 };
  struct Frame {
    std::uint8_t opcode = 0;
    std::string content;
  };

  /// Connects. A read waits a minute at most.
  explicit WebSocketClient(const std::string& url) : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1))));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(fd_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
    const timeval minute{60, 0};
    (void)::setsockopt(fd_.get(), SOL_SOCKET, SO_RCVTIMEO, &minute, sizeof minute);
  }
  /// Bytes as they are; nothing where the server has closed the connection.
  void send_bytes(const std::string& bytes) {
    (void)::send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
  }
  void upgrade() {
    send_bytes(
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n");
    EXPECT_TRUE(read_until("\r\n\r\n"));
    received_.erase(0, received_.find("\r\n\r\n") + 4);
  }
  /// With a mask of zero.
  void send_frame(Opcode opcode, const std::string& content) {
    std::string head{static_cast<char>(0x80 | opcode)};
    head += static_cast<char>(0x80 | (content.size() < 126 ? content.size() : 126));
    if (content.size() >= 126) append_be(head, static_cast<std::uint16_t>(content.size()));
    send_bytes(head + std::string(4, '\0') + content);
  }
  /// Empty: the connection has ended, or nothing came for a minute.
  std::optional<Frame> read_frame() {
    if (!read_bytes(2)) return std::nullopt;
    std::size_t head = 2, size = static_cast<std::uint8_t>(received_[1]) & 0x7f;
    if (size >= 126) {
      head += size == 126 ? 2 : 8;
      if (!read_bytes(head)) return std::nullopt;
      size = head == 4 ? load_be<std::uint16_t>(received_, 2)
                       : static_cast<std::size_t>(load_be<std::uint64_t>(received_, 2));
    }
    if (!read_bytes(head + size)) return std::nullopt;
    Frame frame{static_cast<std::uint8_t>(received_[0] & 0x0f), received_.substr(head, size)};
    received_.erase(0, head + size);
    return frame;
  }
  /// False: the connection has ended before, or nothing came for a minute.
  bool read_until(const std::string& words) {
    while (received_.find(words) == std::string::npos)
      if (read_some() <= 0) return false;
    return true;
  }
  /// False: it is still open after a minute without a byte.
  bool closed() {
    for (;;) {
      const ssize_t n = read_some();
      if (n == 0 || (n < 0 && errno == ECONNRESET)) return true;
      if (n < 0) return false;
    }
  }

 private:
  bool read_bytes(std::size_t count) {
    while (received_.size() < count)
      if (read_some() <= 0) return false;
    return true;
  }
  ssize_t read_some() {
    char bytes[64 << 10];
    const ssize_t n = ::recv(fd_.get(), bytes, sizeof bytes, 0);
    if (n > 0) received_.append(bytes, static_cast<std::size_t>(n));
    return n;
  }
  FileDescriptor fd_;
  std::string received_;
};

}  // namespace rigor::live

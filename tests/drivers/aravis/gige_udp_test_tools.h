// For tests over real sockets on loopback: the in-process client's transport as UDP, and a relay between a
// client and the camera that loses stream packets.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <atomic>
#include <cstring>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "drivers/aravis/gige_client.h"
#include "rt-core/file_descriptor.h"

namespace rigor::gige::testing {

inline sockaddr_in address_of(Endpoint e) {
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr.s_addr = htonl(e.ip);
  a.sin_port = htons(e.port);
  return a;
}

class UdpSocket {
 public:
  explicit UdpSocket(Endpoint at) : fd_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    const int size = 4 << 20;
    setsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    const auto a = address_of(at);
    if (!fd_ || bind(fd_.get(), reinterpret_cast<const sockaddr*>(&a), sizeof a) != 0) {
      throw std::runtime_error("cannot bind a test socket: " + std::string(std::strerror(errno)));
    }
  }
  [[nodiscard]] int fd() const { return fd_.get(); }
  [[nodiscard]] Endpoint local() const {
    sockaddr_in a{};
    socklen_t n = sizeof a;
    getsockname(fd(), reinterpret_cast<sockaddr*>(&a), &n);
    return {ntohl(a.sin_addr.s_addr), ntohs(a.sin_port)};
  }
  void send(Endpoint to, Bytes d) const {
    const auto a = address_of(to);
    (void)sendto(fd(), d.data(), d.size(), 0, reinterpret_cast<const sockaddr*>(&a), sizeof a);
  }
  /// 0 where nothing came in `timeout_ms`.
  std::size_t receive(MutableBytes out, int timeout_ms, Endpoint* from = nullptr) const {
    pollfd p{fd(), POLLIN, 0};
    if (poll(&p, 1, timeout_ms) <= 0) return 0;
    sockaddr_in a{};
    socklen_t n = sizeof a;
    const auto got = recvfrom(fd(), out.data(), out.size(), 0, reinterpret_cast<sockaddr*>(&a), &n);
    if (from != nullptr) *from = {ntohl(a.sin_addr.s_addr), ntohs(a.sin_port)};
    return got > 0 ? static_cast<std::size_t>(got) : 0;
  }

 private:
  FileDescriptor fd_;
};

class UdpTransport final : public GigeTransport {
 public:
  UdpTransport(Endpoint camera, std::uint32_t own_ip)
      : camera_(camera), control_({own_ip, 0}), stream_({own_ip, 0}) {}
  void send_control(Bytes d) override {
    waiting_ = true;
    control_.send(camera_, d);
  }
  std::size_t receive_control(MutableBytes out) override {
    // The first answer is waited for; what lies behind it is taken only if it is there.
    const auto n = control_.receive(out, waiting_ ? 500 : 0);
    waiting_ = false;
    return n;
  }
  void send_from_stream(Bytes d) override { stream_.send(camera_, d); }
  std::size_t receive_stream(MutableBytes out) override { return stream_.receive(out, 0); }
  [[nodiscard]] Endpoint stream_endpoint() const override { return stream_.local(); }

 private:
  Endpoint camera_;
  UdpSocket control_, stream_;
  bool waiting_ = false;
};

/// Looks like a camera at `front`, port 3956, and passes everything on to the camera at `back`; the stream is
/// made to pass through it, too, and loses packets there, resent ones not excepted.
class LossRelay {
 public:
  LossRelay(Endpoint front, Endpoint back, double loss, std::uint32_t seed)
      : back_(back), front_(front), up_({front.ip, 0}), stream_({front.ip, 0}), loss_(loss), rng_(seed) {
    thread_ = std::thread([this] { loop(); });
  }
  ~LossRelay() {
    stop_ = true;
    thread_.join();
  }
  [[nodiscard]] std::uint64_t passed() const { return passed_; }
  [[nodiscard]] std::uint64_t lost() const { return lost_; }

 private:
  void loop() {
    std::vector<std::uint8_t> d(65536);
    pollfd fds[3] = {{front_.fd(), POLLIN, 0}, {up_.fd(), POLLIN, 0}, {stream_.fd(), POLLIN, 0}};
    while (!stop_) {
      if (poll(fds, 3, 50) <= 0) continue;
      Endpoint from;
      if (const auto n = front_.receive(d, 0, &from)) from_client(MutableBytes(d).first(n), from);
      if (const auto n = up_.receive(d, 0, &from)) from_camera(MutableBytes(d).first(n));
      while (const auto n = stream_.receive(d, 0, &from)) {
        if (std::uniform_real_distribution<>(0, 1)(rng_) < loss_) {
          ++lost_;
        } else {
          ++passed_;
          stream_.send(client_stream_, Bytes(d).first(n));
        }
      }
    }
  }
  void from_client(MutableBytes d, Endpoint from) {
    if (d.size() >= 16) {
      const auto command = load_be<std::uint16_t>(d, 2);
      const auto address = load_be<std::uint32_t>(d, 8);
      const bool writes = command == 0x82 || command == 0x86;
      if (writes && address == reg::kStreamPort) {
        client_stream_.port = static_cast<std::uint16_t>(load_be<std::uint32_t>(d, 12));
        if (client_stream_.port != 0) store_be(d, 12, std::uint32_t{stream_.local().port});
      }
      if (writes && address == reg::kStreamDestination) {
        client_stream_.ip = load_be<std::uint32_t>(d, 12);
        store_be(d, 12, stream_.local().ip);
      }
    }
    if (d.size() >= 2 && (d[1] & 1) != 0)
      client_ = from;  // resend requests come from elsewhere and get no answer
    up_.send(back_, d);
  }
  void from_camera(MutableBytes d) {
    if (d.size() == kGvcpHeaderSize + kDiscoveryAckSize) store_be(d, kGvcpHeaderSize + 36, front_.local().ip);
    front_.send(client_, d);
  }

  Endpoint back_, client_, client_stream_;
  UdpSocket front_, up_, stream_;
  double loss_;
  std::mt19937 rng_;
  std::atomic<bool> stop_{false};
  std::atomic<std::uint64_t> passed_{0}, lost_{0};
  std::thread thread_;
};

/// Every byte depends on the seed and on its place: a frame put together from two does not pass.
inline void fill_pattern(std::uint64_t seed, MutableBytes out) {
  std::uint64_t x = seed * 0x9E3779B97F4A7C15ULL + 1;
  std::size_t i = 0;
  for (; i + 4 <= out.size(); i += 4) {
    x = x * 6364136223846793005ULL + 1442695040888963407ULL;
    store_be(out, i, static_cast<std::uint32_t>(x >> 32));
  }
  for (; i < out.size(); ++i) out[i] = static_cast<std::uint8_t>(seed + i);
}
[[nodiscard]] inline bool has_pattern(std::uint64_t seed, Bytes picture) {
  std::vector<std::uint8_t> expected(picture.size());
  fill_pattern(seed, expected);
  return std::memcmp(expected.data(), picture.data(), picture.size()) == 0;
}

}  // namespace rigor::gige::testing

// A scan that is a formula, and what tests of the scanner's channels need around it.
#pragma once

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <functional>
#include <numbers>
#include <thread>
#include <vector>

#include "drivers/sick/sick_emulator.h"
#include "drivers/sick/telegram.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "tests/eventually.h"

namespace rigor::sick::test {

/// LMS111: 541 beams by 0.5 degree, 50 Hz. Range of beam b in scan k: 1 m + b mm + (k mod 100) · 0.1 m; every
/// tenth beam has nothing, every seventh a second echo half a metre behind.
class FormulaScan final : public SampleProvider {
 public:
  explicit FormulaScan(double rotation_hz = 50, double step_deg = 0.5, double start_deg = -135,
                       std::uint32_t beams = 541) {
    constexpr double kRad = std::numbers::pi / 180;
    scan_.columns = beams;
    scan_.start_azimuth_rad = start_deg * kRad;
    scan_.rotation_radps = rotation_hz * 2 * std::numbers::pi;
    scan_.column_period_s = step_deg / 360 / rotation_hz;
  }
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, std::size_t{scan_.columns} * 2 * sizeof(LidarPoint), "scanner"};
  }
  const models::LidarScan* scan() const override { return &scan_; }
  static double range_m(std::uint64_t scan, std::size_t beam, int echo) {
    return 1 + static_cast<double>(beam) * 1e-3 + static_cast<double>(scan % 100) * 0.1 + echo * 0.5;
  }
  static float remission(std::size_t beam, int echo) {
    return static_cast<float>(beam % 200 + 20U * static_cast<unsigned>(echo));
  }
  Status capture(const Request& r, Sample& s) override {
    if (const auto slow = delay_us.load(); slow > 0)
      std::this_thread::sleep_for(std::chrono::microseconds(slow));
    if (failing) return fail(ErrorCode::internal, "test", "planned");
    std::uint32_t count = 0;
    for (std::size_t b = 0; b < scan_.columns; ++b) {
      if (b % 10 == 9) continue;
      const double a = scan_.azimuth_rad(static_cast<double>(b));
      for (int e = 0; e < (b % 7 == 0 ? 2 : 1); ++e) {
        const double range = range_m(r.index, b, e);
        const LidarPoint p{
            static_cast<float>(range * std::cos(a)),
            static_cast<float>(range * std::sin(a)),
            0,
            remission(b, e),
            static_cast<std::int32_t>(std::lround(scan_.column_period_s * 1e9 * static_cast<double>(b))),
            0,
            static_cast<std::uint8_t>(e),
            0};
        std::memcpy(s.memory().data() + sizeof p * count++, &p, sizeof p);
      }
    }
    s.info = PointCloudInfo{count};
    s.size_bytes = count * sizeof(LidarPoint);
    return {};
  }
  std::atomic<int> delay_us{0};
  std::atomic<bool> failing{false};

 private:
  models::LidarScan scan_;
};

inline ChannelConfig config_of(const std::string& params, Duration period = milliseconds(20),
                               Duration latency = milliseconds(40), std::string name = "front") {
  ChannelConfig c;
  c.name = std::move(name);
  c.kind = SampleKind::point_cloud;
  c.period = period;
  c.latency = latency;
  auto node = ConfigDocument::parse(params, "test.yaml");
  EXPECT_TRUE(node) << (node ? "" : node.error().text());
  c.params = *node;
  return c;
}

inline DeviceParts parts_of(std::shared_ptr<SampleProvider> samples) {
  DeviceParts parts;
  parts.samples = std::move(samples);
  return parts;
}

/// A client that is nothing but a socket.
class PlainClient {
 public:
  explicit PlainClient(std::uint16_t port, int receive_buffer = 0) {
    socket_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (receive_buffer > 0)
      ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    sockaddr_in a{};
    a.sin_family = AF_INET;
    a.sin_port = htons(port);
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    connected_ = ::connect(socket_, reinterpret_cast<const sockaddr*>(&a), sizeof a) == 0;
  }
  ~PlainClient() { close(); }
  void close() {
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
  }
  [[nodiscard]] bool connected() const { return connected_; }
  [[nodiscard]] int socket() const { return socket_; }
  bool send(Bytes bytes) {
    return ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size());
  }
  /// The next telegram's body; empty when the other end closed, or said nothing for so long.
  Buffer receive(int timeout_ms = 10000) {
    while (true) {
      if (const Bytes b = parser_.next(); b.data()) return {b.begin(), b.end()};
      pollfd p{socket_, POLLIN, 0};
      if (::poll(&p, 1, timeout_ms) <= 0) return {};
      const auto n = ::recv(socket_, parser_.room(65536).data(), 65536, 0);
      if (n <= 0) {
        closed_ = true;
        return {};
      }
      parser_.added(static_cast<std::size_t>(n));
    }
  }
  Buffer ask(const std::string& type, const std::string& name, const Buffer& values = {}) {
    Buffer out;
    append_telegram(out, type, name, values);
    if (!send(out)) return {};
    for (int i = 0; i < 1000; ++i) {
      Buffer b = receive();
      if (b.empty() || b[1] != 'S') return b;  // not a scan
    }
    return {};
  }
  [[nodiscard]] bool closed_by_peer(int timeout_ms = 10000) {
    while (!closed_ && !receive(timeout_ms).empty()) {
    }
    return closed_;
  }
  [[nodiscard]] const FrameParser& parser() const { return parser_; }

 private:
  int socket_ = -1;
  bool connected_ = false, closed_ = false;
  FrameParser parser_;
};

inline std::string text_of(const Buffer& b) { return {b.begin(), b.end()}; }

using rigor::test::eventually;

}  // namespace rigor::sick::test

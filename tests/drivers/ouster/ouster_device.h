// An emulated Ouster that serves, and configurations of channels that read it.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <string>

#include "drivers/network/http.h"
#include "drivers/ouster/ouster_emulator.h"
#include "tests/drivers/lidar/lidar_test_tools.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster::test {

inline ChannelConfig config_of(const std::string& params, SampleKind kind = SampleKind::point_cloud) {
  const bool imu = kind == SampleKind::imu;
  return packet_lidar::test::channel_config(params, kind, milliseconds(imu ? 10 : 100),
                                            milliseconds(imu ? 10 : 120));
}
inline DeviceParts parts_of(LidarMode mode = {512, 10}, bool dual = false) {
  DeviceParts parts;
  parts.samples = std::make_shared<FormulaLidar>(mode, dual);
  return parts;
}

/// An emulator that serves now.
struct Device {
  std::array<std::uint16_t, 2> port = network::test::free_ports();
  std::unique_ptr<OusterEmulator> emulator = std::make_unique<OusterEmulator>();
  std::uint16_t http = 0;  ///< 0: any

  Status start(const std::string& config = "", const std::string& more = "") {
    emulator->attach(parts_of());
    if (auto s = emulator->configure(config_of("{tcp_port: 0, http_port: " + std::to_string(http) +
                                               ", config: {udp_port_lidar: " + std::to_string(port[0]) +
                                               ", udp_port_imu: " + std::to_string(port[1]) + config + "}" +
                                               more + "}"));
        !s)
      return s;
    if (auto s = emulator->arm({}); !s) return s;
    http = emulator->http_port();
    return emulator->start(bench_now());
  }
  [[nodiscard]] std::string host() const { return "host: 127.0.0.1, http_port: " + std::to_string(http); }
  network::HttpReply ask(const std::string& method, const std::string& target,
                         const std::string& body = "") const {
    auto r =
        network::http_request("127.0.0.1", http, {method, target, body}, monotonic_now() + seconds(10), -1);
    EXPECT_TRUE(r) << r.error().text();
    return r ? *r : network::HttpReply{0, ""};
  }
};

}  // namespace rigor::ouster::test

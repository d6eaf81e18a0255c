// A simulated Mid-360 whose ranges are a formula of where its firings point, and bytes written in hex.
#pragma once

#include <cmath>
#include <cstring>
#include <string_view>
#include <vector>

#include "drivers/livox/mid360_device.h"
#include "sensor-hal/channel/providers.h"
#include "tests/drivers/lidar/lidar_test_tools.h"

namespace rigor::livox::test {

[[nodiscard]] inline std::vector<std::uint8_t> bytes_of_hex(std::string_view hex) {
  const auto digit = [](char c) { return c <= '9' ? c - '0' : c - 'a' + 10; };
  std::vector<std::uint8_t> out;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    out.push_back(static_cast<std::uint8_t>(digit(hex[i]) << 4 | digit(hex[i + 1])));
  return out;
}

class FormulaMid360 final : public SampleProvider {
 public:
  explicit FormulaMid360(std::int64_t scan_ns = 100'000'000)
      : scan_(models::formula_scan(models::PatternFormula::livox_mid360, scan_ns)) {}
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, std::size_t{scan_.columns} * kLines * sizeof(LidarPoint), "lidar"};
  }
  const models::LidarScan* scan() const override { return &scan_; }
  /// Of the n-th firing since the start; none in a part of each packet.
  static double range_m(std::uint64_t n) { return n % 32 == 7 ? 0 : 4 + 0.01 * static_cast<double>(n % 997); }
  static std::array<double, 3> place_m(std::uint64_t n) {
    auto d =
        models::livox_mid360_direction(static_cast<std::uint32_t>(n % kLines), static_cast<double>(n) * 5e-6);
    for (double& v : d) v *= range_m(n);
    return d;
  }
  Status capture(const Request& r, Sample& sample) override {
    std::vector<LidarPoint> points;
    const std::uint64_t firings = std::uint64_t{scan_.columns} * kLines;
    for (std::uint64_t i = 0; i < firings; ++i) {
      const std::uint64_t n = r.index * firings + i;
      if (range_m(n) == 0) continue;
      const auto at = place_m(n);
      points.push_back({static_cast<float>(at[0]), static_cast<float>(at[1]), static_cast<float>(at[2]),
                        static_cast<float>(n % 200), static_cast<std::int32_t>(i * 5000),
                        static_cast<std::uint16_t>(n % kLines), 0, 0});
    }
    packet_lidar::test::store_points(points, sample);
    return {};
  }

 private:
  models::LidarScan scan_;
};

/// Packet j of a device that sees one thing everywhere: a point at (1, 2, 2) m.
[[nodiscard]] inline std::vector<std::uint8_t> plain_packet(std::uint64_t j, std::uint64_t start_ns = 0,
                                                            std::int64_t count_shift = 0) {
  std::vector<Point> points(kDots, Point{1, 2, 2, 50, 0});
  PacketHead head;
  head.udp_count = static_cast<std::uint16_t>(static_cast<std::int64_t>(j) + count_shift);
  head.timestamp_ns = start_ns + j * kDots * kPoint_ns;
  std::vector<std::uint8_t> out;
  compose_points(DataType::cartesian_mm, head, points, out);
  return out;
}

}  // namespace rigor::livox::test

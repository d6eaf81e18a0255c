// A receiver's measurements that are a formula, and what tests of its channels need around it.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "drivers/gnss/gnss_emulator.h"
#include "sensor-hal/config/yaml.h"
#include "tests/eventually.h"

namespace rigor::gnss::test {

/// Drives east at 10 m/s from a place, 3 m/s up; the height tells the index: 100 m and a millimetre each.
class FormulaReceiver final : public SampleProvider {
 public:
  double latitude_deg = 48.5, longitude_deg = 9.25, height_m = 100;
  FixStatus status = FixStatus::rtk_fixed;
  std::uint16_t satellites = 14;

  Geometry geometry() const override { return {SampleKind::nav_fix, 0, 0, 0, "receiver"}; }
  bool immediate() const override { return true; }
  Status capture(const Request& r, Sample& s) override {
    NavFix f;
    f.status = status;
    f.satellites = satellites;
    const double t_s = (r.t_capture - r.t_start).seconds();
    f.latitude_deg = latitude_deg;
    f.longitude_deg = std::remainder(
        longitude_deg + 10 * t_s / kMetresPerDegree / std::cos(latitude_deg * kRadPerDeg), 360);
    f.height_m = height_m + 1e-3 * static_cast<double>(r.index % 1000);
    f.covariance_enu_m2 = {0.0004, 0.0001, 0, 0.0001, 0.0009, 0, 0, 0, 0.0025};
    if (status == FixStatus::none) f.latitude_deg = f.longitude_deg = f.height_m = Solution::kNone;
    s.info = f;
    s.size_bytes = 0;
    return {};
  }
  static constexpr double kMetresPerDegree = 111'320;
};

inline ChannelConfig config_of(const std::string& params, SampleKind kind = SampleKind::nav_fix,
                               Period period = milliseconds(100), Duration latency = milliseconds(60),
                               std::string name = "rover") {
  ChannelConfig c;
  c.name = std::move(name);
  c.kind = kind;
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
/// A receiver that speaks, on a pseudo-terminal or a TCP port.
inline std::unique_ptr<GnssEmulator> start_emulator(const std::string& params,
                                                    std::shared_ptr<SampleProvider> samples) {
  auto emulator = std::make_unique<GnssEmulator>();
  emulator->attach(parts_of(std::move(samples)));
  auto s = emulator->configure(config_of(params));
  if (s) s = emulator->arm({});
  if (s) s = emulator->start(bench_now());
  EXPECT_TRUE(s) << (s ? "" : s.error().text());
  return emulator;
}
using rigor::test::eventually;

}  // namespace rigor::gnss::test

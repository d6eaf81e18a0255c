// Scanners to test with: what they measure is a formula of scan and step, so that every range can be checked.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <string>

#include "drivers/usb/scip_emulator.h"
#include "drivers/usb/scip_source.h"
#include "drivers/usb/scip_virtual_source.h"

namespace rigor::usb::testing {

/// Range of a step: its scan's number is in every one of them.
inline std::uint32_t formula_mm(std::uint64_t scan, std::uint32_t step) {
  return static_cast<std::uint32_t>(100 + (scan % 1000) + (step * 7) % 900);
}

/// Points at the steps of a model; scan and step make the range.
class FormulaScans final : public SampleProvider {
 public:
  explicit FormulaScans(const ScannerModel& model) : model_(model) {}
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, (model_.end_step + 1) * sizeof(LidarPoint), "scanner"};
  }
  Status capture(const Request& r, Sample& sample) override {
    ScipScan scan;
    scan.request.first_step = model_.parameters.first_step;
    scan.request.last_step = model_.parameters.last_step;
    for (std::uint32_t s = scan.request.first_step; s <= scan.request.last_step; ++s)
      scan.range_mm.push_back(formula_mm(r.index, s));
    const std::span<LidarPoint> points(reinterpret_cast<LidarPoint*>(sample.memory().data()),
                                       sample.memory().size() / sizeof(LidarPoint));
    const std::size_t count = scan_points(scan, model_.parameters, points);
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(count)};
    sample.size_bytes = count * sizeof(LidarPoint);
    return {};
  }

 private:
  ScannerModel model_;
};

inline ScipDevice::Measure formula(const ScannerModel& model) {
  return [&model](std::uint64_t scan, DeviceTime, std::span<std::uint32_t> range,
                  std::span<std::uint32_t> intensity) {
    const auto& p = model.parameters;
    for (std::uint32_t s = p.first_step; s <= p.last_step; ++s)
      range[s] = formula_mm(scan, s), intensity[s] = 1000 + s;
    return true;
  };
}

inline ChannelConfig scanner_config(const std::string& params, Duration period = milliseconds(25),
                                    Duration latency = milliseconds(40)) {
  ChannelConfig c;
  c.name = "scanner";
  c.kind = SampleKind::point_cloud;
  c.period = period;
  c.latency = latency;
  c.seed = 1;
  auto node = ConfigDocument::parse(params, "test.yaml");
  if (!node)
    ADD_FAILURE() << node.error().text();
  else
    c.params = *node;
  return c;
}

/// An emulated UTM-30LX that is up.
struct RunningEmulator {
  explicit RunningEmulator(const std::string& params, const ScannerModel& model = utm_30lx()) {
    emulator.measure_by(formula(model));
    Status s = emulator.configure(scanner_config(params));
    if (s) s = emulator.arm({});
    if (s) s = emulator.start(bench_now());
    if (!s) problem = s.error().text();
  }
  ~RunningEmulator() {
    if (emulator.state() == ChannelState::running) (void)emulator.stop();
  }
  [[nodiscard]] std::string tty() const { return "{transport: tty, device: " + emulator.where() + "}"; }
  [[nodiscard]] std::string tty_with(const std::string& keys) const {
    return "{transport: tty, device: " + emulator.where() + ", " + keys + "}";
  }
  ScipEmulator emulator;
  std::string problem;
};

/// Number of a formula's scan, or -1 where a point is not of one scan.
inline std::int64_t formula_scan(const Sample& sample, const ScannerModel& model) {
  const auto* cloud = sample.as<PointCloudInfo>();
  if (!cloud || cloud->count == 0) return -1;
  std::int64_t number = -1;
  for (std::uint32_t i = 0; i < cloud->count; ++i) {
    LidarPoint p;
    std::memcpy(&p, sample.bytes().data() + i * sizeof p, sizeof p);
    const double range = std::sqrt(static_cast<double>(p.x_m) * p.x_m + static_cast<double>(p.y_m) * p.y_m);
    const auto& parameters = model.parameters;
    const auto step = static_cast<std::uint32_t>(parameters.first_step +
                                                 std::lround(p.t_offset_ns * 1e-9 / parameters.step_s()));
    const std::int64_t n = std::lround(range * 1e3) - 100 - (step * 7) % 900;
    if (number >= 0 && n != number) return -1;
    number = n;
  }
  return number;
}

}  // namespace rigor::usb::testing

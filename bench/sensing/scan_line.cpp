#include "bench/sensing/scan_line.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "sensor-hal/models/lidar/lidar_yaml.h"

namespace rigor {
namespace {

constexpr double kScanDegree = std::numbers::pi / 180;

std::optional<record::ScanLine> line_of(const models::LidarModel& model) {
  const models::LidarScan& s = model.scan;
  if (s.kind != models::LidarScanKind::rotor || s.beams.size() != 1 || s.columns < 2 ||
      s.columns > record::kMostRays || s.rotation_radps == 0)
    return std::nullopt;
  const models::LidarBeam& b = s.beams[0];
  if (std::abs(b.elevation_rad) > 1e-3) return std::nullopt;
  record::ScanLine line;
  line.angle_min_rad = s.azimuth_rad(0) + s.rotation_radps * b.fire_time_s + b.azimuth_rad;
  line.angle_increment_rad = s.rotation_radps * s.column_period_s;
  line.rays = s.columns;
  line.time_increment_s = s.column_period_s;
  line.scan_time_s = 2 * std::numbers::pi / std::abs(s.rotation_radps);
  line.range_min_m = model.range.min_m;
  line.range_max_m = model.range.max_m;
  return line;
}

/// What a device's channel asks of it: a part of its rays, or several of them in one.
void narrow(record::ScanLine& line, const ConfigNode& channel) {
  if (channel.has("resolution_deg")) {
    const double coarser = channel.number("resolution_deg", {.min = 0.01, .max = 6}) * kScanDegree /
                           std::abs(line.angle_increment_rad);
    line.rays = static_cast<std::uint32_t>(std::floor((line.rays - 1) / coarser + 1e-3)) + 1;
    line.angle_increment_rad *= coarser;
    line.time_increment_s *= coarser;
  }
  const double step = line.angle_increment_rad;
  if (step > 0 && (channel.has("start_deg") || channel.has("stop_deg"))) {
    constexpr double kSlack = 1e-6;  // of a step: a third of a degree is no binary fraction
    const double last = line.angle_min_rad + step * (line.rays - 1);
    const double from = channel.has("start_deg") ? channel.number("start_deg", {}) * kScanDegree : -INFINITY;
    const double to = channel.has("stop_deg") ? channel.number("stop_deg", {}) * kScanDegree : INFINITY;
    const double before = std::max(0.0, std::ceil((from - line.angle_min_rad) / step - kSlack));
    const double behind = std::max(0.0, std::ceil((last - to) / step - kSlack));
    if (before + behind < line.rays) {
      line.angle_min_rad += before * step;
      line.rays -= static_cast<std::uint32_t>(before + behind);
    }
  }
  if (!channel.has("cluster")) return;
  const auto cluster = static_cast<std::uint32_t>(channel.integer_or("cluster", 1, {.min = 1, .max = 99}));
  line.angle_min_rad += 0.5 * (cluster - 1) * step;
  line.angle_increment_rad *= cluster;
  line.time_increment_s *= cluster;
  line.rays = (line.rays + cluster - 1) / cluster;
}

std::optional<record::ScanLine> of_model(const ConfigNode& params) {
  if (!params.present() || !params.has("sensor")) return std::nullopt;
  const auto model = load_lidar_model(params.base_dir() / params.text("sensor"));
  return model ? line_of(*model) : std::nullopt;  // the assembly has refused a wrong file before
}

record::ScanLine as_written(const ChannelEntry& entry) {
  const ConfigNode& n = entry.laser_scan;
  record::ScanLine line;
  line.angle_min_rad = n.number("start_deg", {.min = -360, .max = 360}) * kScanDegree;
  line.angle_increment_rad = n.number("step_deg", {.min = -180, .max = 180}) * kScanDegree;
  if (line.angle_increment_rad == 0) throw n.error("step_deg", "expected an angle, got 0");
  line.rays = static_cast<std::uint32_t>(n.integer("rays", {.min = 2, .max = record::kMostRays}));
  line.scan_time_s = entry.period.seconds();
  if (n.has("rotation_hz"))
    line.scan_time_s = 1 / n.number("rotation_hz", {.min = 0, .max = 1e4, .exclusive_min = true});
  line.time_increment_s = line.scan_time_s * std::abs(line.angle_increment_rad) / (2 * std::numbers::pi);
  const std::vector<double> range = n.numbers("range_m", 2);
  if (!(range[0] >= 0 && range[0] < range[1]))
    throw n.error("range_m",
                  fmt::format("expected [NEAREST, FARTHEST], got [{:g}, {:g}]", range[0], range[1]));
  line.range_min_m = range[0];
  line.range_max_m = range[1];
  n.finish();
  return line;
}

}  // namespace

Result<ScanLines> scan_lines(const RigConfig& rig, const ChannelEntry& entry) {
  return catch_config([&] {
    ScanLines lines;
    if (entry.kind != SampleKind::point_cloud) return lines;
    if (entry.laser_scan.present()) {
      lines.own = lines.simulated = as_written(entry);
      return lines;
    }
    if (entry.is_pair) lines.simulated = of_model(entry.simulated.params);
    lines.own = of_model(entry.source.params);
    if (lines.own) return lines;
    const EmulatorEntry* emulator = rig.emulator(entry.source.emulated_by);
    if (emulator) lines.own = of_model(emulator->emulator.params);
    if (!lines.own) lines.own = lines.simulated;
    // A part of the scan in the device's own steps, which no sensor model knows.
    if (entry.source.params.has("start_step") || entry.source.params.has("end_step")) lines.own.reset();
    if (lines.own) narrow(*lines.own, entry.source.params);
    return lines;
  });
}

}  // namespace rigor

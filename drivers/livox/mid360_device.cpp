#include "drivers/livox/mid360_device.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace rigor::livox {
namespace {

constexpr std::uint64_t kFrame_ns = 100'000'000;  ///< in which udp_cnt counts

Status unlike(const std::string& what) {
  return fail(
      ErrorCode::bad_input, "sensor",
      "expected a sensor model of a Livox Mid-360 (configs/sensors/livox-mid360.yaml), got one with " + what);
}

/// Whether a scan is one that this device makes.
Status check(const models::LidarScan& s) {
  const double firing_us = s.column_period_s * 1e6 / static_cast<double>(s.beams.size());
  if (std::abs(firing_us - 5) > 1e-6)
    return unlike(std::to_string(firing_us) + " µs from firing to firing; it has 5");
  for (std::size_t i = 0; i < s.beams.size(); ++i)
    if (std::abs(s.beams[i].fire_time_s - static_cast<double>(i) * 5e-6) > 1e-9)
      return unlike("beam " + std::to_string(i) + " that fires after " +
                    std::to_string(s.beams[i].fire_time_s * 1e6) + " µs");
  return {};
}

}  // namespace

Mid360Device::Mid360Device(std::shared_ptr<SampleProvider> samples, models::ScanGrid grid)
    : samples_(std::move(samples)), empty_(std::move(grid)) {
  sample_.reserve(samples_->geometry().max_bytes);
}

Result<Mid360Device> Mid360Device::create(std::shared_ptr<SampleProvider> samples) {
  const models::LidarScan* scan = samples ? samples->scan() : nullptr;
  if (!scan)
    return fail(
        ErrorCode::bad_input, "sensor",
        "expected a simulated LiDAR for this device to be: give its emulator a `sensor` (a sensor model "
        "such as configs/sensors/livox-mid360.yaml)");
  if (scan->kind != models::LidarScanKind::pattern)
    return tl::unexpected<Error>(unlike("a scan that is no pattern").error());
  auto grid = models::ScanGrid::create_of_pattern(*scan);
  if (!grid) return tl::unexpected<Error>(grid.error());
  if (auto s = check(*scan); !s) return tl::unexpected<Error>(s.error());
  return Mid360Device(std::move(samples), std::move(*grid));
}

Status Mid360Device::measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                             packet_lidar::Scan& out) {
  return packet_lidar::measure_scan(*samples_, index, t_begin, motion, 0, sample_, out);
}

void Mid360Device::compose(std::uint64_t packet, DataType type, const DeviceClock& clock,
                           const std::function<const packet_lidar::Scan*(std::uint64_t)>& of,
                           std::vector<std::uint8_t>& out) const {
  const std::uint64_t first = packet * kDots, beams = empty_.beams();
  std::uint64_t k = first / firings();
  const packet_lidar::Scan* scan = of(k);
  std::array<Point, kDots> points{};
  for (std::uint64_t i = 0; i < kDots; ++i) {
    const std::uint64_t n = first + i;
    if (n / firings() != k) scan = of(k = n / firings());
    if (!scan || !scan->seen) continue;
    const auto column = static_cast<std::uint32_t>(n % firings() / beams);
    const auto beam = static_cast<std::uint32_t>(n % beams);
    const auto& seen = scan->grid.at(column, beam);
    if (!(seen.range_m > 0)) continue;
    const auto& place = scan->grid.place_m(column, beam);
    points[i] = {place[0], place[1], place[2],
                 static_cast<std::uint8_t>(std::clamp(std::round(seen.remission), 0.0F, 255.0F)), 0};
  }
  const std::uint64_t since_ns = first * static_cast<std::uint64_t>(kPoint_ns), packet_ns = kDots * kPoint_ns;
  // The first packet that begins in a frame has 0.
  const std::uint64_t frame_first = (since_ns / kFrame_ns * kFrame_ns + packet_ns - 1) / packet_ns;
  PacketHead head;
  head.udp_count = static_cast<std::uint16_t>(packet - frame_first);
  head.time_type = clock.type;
  head.timestamp_ns = clock.start_ns + since_ns;
  compose_points(type, head, points, out);
}

}  // namespace rigor::livox

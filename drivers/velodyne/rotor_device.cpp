#include "drivers/velodyne/rotor_device.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <string>

namespace rigor::velodyne {
namespace {

constexpr double kPi = std::numbers::pi;

Status differs(const DeviceFacts& f, const std::string& what) {
  return fail(ErrorCode::bad_input, "sensor",
              "expected a sensor model of a " + std::string(f.name) + " (configs/sensors/velodyne-" +
                  std::string(f.key) + ".yaml), got one with " + what);
}

/// Whether a scan is one that this device makes.
Status check(const models::LidarScan& s, const DeviceFacts& f) {
  if (s.beams.size() != f.lasers) return differs(f, std::to_string(s.beams.size()) + " beams");
  if (std::abs(s.column_period_s * 1e9 - static_cast<double>(f.sequence_ns)) > 1)
    return differs(f, std::to_string(s.column_period_s * 1e6) + " µs from column to column");
  const double rotation_hz = -s.rotation_radps / (2 * kPi);
  if (!(rotation_hz >= 4.9 && rotation_hz <= 20.1))
    return differs(f, "a rotor that does not turn clockwise at 5 to 20 Hz, but at " +
                          std::to_string(rotation_hz) + " Hz");
  if (std::abs(s.start_azimuth_rad) > 1e-9) return differs(f, "a scan that does not start at 0 degrees");
  if (static_cast<double>(s.columns) * s.column_period_s * rotation_hz < 1 - 1e-6)
    return differs(f, "a scan of less than a turn");
  const Calibration c = factory_calibration(f.model);
  for (std::size_t i = 0; i < s.beams.size(); ++i) {
    if (std::abs(s.beams[i].elevation_rad - c.lasers[i].elevation_rad) > 0.05 * kPi / 180)
      return differs(f, "beam " + std::to_string(i) + " at " +
                            std::to_string(s.beams[i].elevation_rad * 180 / kPi) + " degrees");
    if (std::abs(s.beams[i].fire_time_s * 1e9 - static_cast<double>(f.laser_ns) * static_cast<double>(i)) >
        10)
      return differs(f, "beam " + std::to_string(i) + " that fires after " +
                            std::to_string(s.beams[i].fire_time_s * 1e6) + " µs");
  }
  return {};
}

std::uint8_t intensity_of(float remission) {
  return static_cast<std::uint8_t>(std::clamp(std::round(remission), 0.0F, 255.0F));
}
DataPacket::Return told(const models::ScanGrid::Return& r) {
  const std::uint16_t raw = range_raw_of(static_cast<double>(r.range_m));
  return {raw, raw == 0 ? std::uint8_t{0} : intensity_of(r.remission)};
}

}  // namespace

RotorDevice::RotorDevice(const RotorSettings& settings, std::shared_ptr<SampleProvider> samples,
                         models::ScanGrid grid)
    : settings_(settings),
      facts_(&facts_of(settings.model)),
      samples_(std::move(samples)),
      empty_(std::move(grid)),
      rotation_hz_(-empty_.scan().rotation_radps / (2 * kPi)) {
  sample_.reserve(samples_->geometry().max_bytes);
}

Result<RotorDevice> RotorDevice::create(const RotorSettings& settings,
                                        std::shared_ptr<SampleProvider> samples) {
  const models::LidarScan* scan = samples ? samples->scan() : nullptr;
  if (!scan)
    return fail(ErrorCode::bad_input, "sensor",
                "expected a simulated LiDAR for this device to be: give its emulator a `sensor` (a sensor "
                "model such as "
                "configs/sensors/velodyne-vlp16.yaml)");
  auto grid = models::ScanGrid::create(*scan);
  if (!grid) return tl::unexpected<Error>(grid.error());
  if (auto s = check(*scan, facts_of(settings.model)); !s) return tl::unexpected<Error>(s.error());
  return RotorDevice(settings, std::move(samples), std::move(*grid));
}

double RotorDevice::azimuth_deg(std::uint64_t sequence) const {
  // Whole turns are taken away by integer: days of running lose nothing.
  const double turns =
      static_cast<double>(sequence) * (static_cast<double>(facts_->sequence_ns) * 1e-9) * rotation_hz_;
  return (turns - std::floor(turns)) * 360;
}

std::uint64_t RotorDevice::first_sequence(std::uint64_t revolution) const {
  const double sequences_per_turn = 1e9 / (rotation_hz_ * static_cast<double>(facts_->sequence_ns));
  // A hair's breadth, so that a turn of whole sequences does not begin one late.
  return static_cast<std::uint64_t>(std::ceil(static_cast<double>(revolution) * sequences_per_turn - 1e-6));
}

std::uint64_t RotorDevice::revolution_of(std::uint64_t sequence) const {
  const double turn =
      static_cast<double>(sequence) * static_cast<double>(facts_->sequence_ns) * 1e-9 * rotation_hz_;
  auto k = static_cast<std::uint64_t>(turn);
  while (first_sequence(k + 1) <= sequence) ++k;
  while (k > 0 && first_sequence(k) > sequence) --k;
  return k;
}

std::uint64_t RotorDevice::last_revolution_of(std::uint64_t packet) const {
  return revolution_of((packet + 1) * facts_->sequences_per_packet(settings_.dual) - 1);
}

Revolution RotorDevice::make_revolution() const { return {0, false, empty_}; }

Status RotorDevice::measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                            Revolution& out) {
  // The rotor turns clockwise.
  double beyond = azimuth_deg(first_sequence(index));
  if (beyond > 180) beyond -= 360;
  return packet_lidar::measure_scan(*samples_, index, t_begin, motion, -beyond * kPi / 180, sample_, out);
}

void RotorDevice::compose(std::uint64_t packet, const std::function<const Revolution*(std::uint64_t)>& of,
                          DataPacketWriter& out) const {
  const std::size_t blocks_per_step = settings_.dual ? 2 : 1;
  const std::uint64_t first = packet * facts_->sequences_per_packet(settings_.dual);
  std::uint64_t k = revolution_of(first);
  const Revolution* revolution = of(k);
  for (std::size_t block = 0; block < kBlocks; block += blocks_per_step)
    for (std::uint32_t half = 0; half < facts_->sequences_per_block; ++half) {
      const std::uint64_t n = first + block / blocks_per_step * facts_->sequences_per_block + half;
      if (n >= first_sequence(k + 1)) revolution = of(++k);
      if (half == 0) {
        const auto cdeg = static_cast<std::uint32_t>(std::lround(azimuth_deg(n) * 100));
        for (std::size_t b = block; b < block + blocks_per_step; ++b) out.set_azimuth(b, cdeg);
      }
      const std::uint64_t column = n - first_sequence(k);
      for (std::uint32_t laser = 0; laser < facts_->lasers; ++laser) {
        DataPacket::Return one{0, 0}, two{0, 0};
        if (revolution && revolution->seen && column < revolution->grid.columns()) {
          one = told(revolution->grid.at(static_cast<std::uint32_t>(column), laser, 0));
          two = told(revolution->grid.at(static_cast<std::uint32_t>(column), laser, 1));
        }
        const std::size_t channel = half * facts_->lasers + laser;
        if (!settings_.dual) {
          out.set(block, channel, one);
          continue;
        }
        if (one.range_raw == 0) one = two;
        if (two.range_raw == 0) two = one;
        // The first block holds the last return, whichever of them that is.
        const bool second_is_last = two.range_raw > one.range_raw;
        out.set(block, channel, second_is_last ? two : one);
        out.set(block + 1, channel, second_is_last ? one : two);
      }
    }
  const std::uint64_t us =
      settings_.start_us + first * static_cast<std::uint64_t>(facts_->sequence_ns) / 1000;
  out.finish(static_cast<std::uint32_t>(us % kHour_us), settings_.dual ? ReturnMode::dual : settings_.single,
             settings_.product);
}

}  // namespace rigor::velodyne

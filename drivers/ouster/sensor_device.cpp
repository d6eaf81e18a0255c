#include "drivers/ouster/sensor_device.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

namespace rigor::ouster {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180;

Status unlike(const std::string& what) {
  return fail(
      ErrorCode::bad_input, "sensor",
      "expected a sensor model of an Ouster (configs/sensors/ouster-os1-128.yaml), got one with " + what);
}

/// Where the beams of a scan begin, level: against the axis, along the encoder.
double origin_of(const models::LidarBeam& b) { return std::hypot(b.radial_offset_m, b.horizontal_offset_m); }

Result<LidarMode> mode_of(const models::LidarScan& s) {
  const auto refuse = [](const std::string& what) -> Result<LidarMode> {
    return tl::unexpected<Error>(unlike(what).error());
  };
  const std::size_t beams = s.beams.size();
  if (beams != 16 && beams != 32 && beams != 64 && beams != 128)
    return refuse(std::to_string(beams) + " beams");
  const double hz = -s.rotation_radps / (2 * kPi);
  const auto rate = static_cast<std::uint32_t>(std::lround(std::clamp(hz, 0.0, 100.0)));
  if (rate < 1 || std::abs(hz - rate) > 1e-6)
    return refuse("a rotor that does not turn clockwise at a whole number of turns a second, but at " +
                  std::to_string(hz) + " Hz");
  if (s.columns % 512 != 0 || s.columns > 4096 || std::abs(s.columns * s.column_period_s * rate - 1) > 1e-6)
    return refuse(std::to_string(s.columns) + " columns of " + std::to_string(s.column_period_s * 1e6) +
                  " µs; a turn has 512, 1024, 2048 or 4096");
  for (std::size_t i = 0; i < beams; ++i) {
    const models::LidarBeam& b = s.beams[i];
    const auto beam = "beam " + std::to_string(i) + " ";
    if (std::abs(b.fire_time_s) > 1e-9) return refuse(beam + "that does not fire with its column");
    if (std::abs(b.vertical_offset_m - s.beams[0].vertical_offset_m) > 1e-6)
      return refuse(beam + "that begins at another height than the first");
    if (std::abs(origin_of(b) - origin_of(s.beams[0])) > 1e-5)
      return refuse(beam + "that begins at another distance from the axis than the first");
    // In the rotor's frame it begins at (n, 0).
    const double across =
        b.radial_offset_m * std::sin(b.azimuth_rad) + b.horizontal_offset_m * std::cos(b.azimuth_rad);
    if (std::abs(across) > 1e-5)
      return refuse(beam + "that begins " + std::to_string(across * 1e3) + " mm beside the rotor's azimuth");
    if (i > 0 && b.elevation_rad > s.beams[i - 1].elevation_rad)
      return refuse(beam + "above the one before it: rows go from the top down");
  }
  return LidarMode{s.columns, rate};
}

Pixel pixel_of(const models::ScanGrid::Return& r, double beam_origin_m) {
  if (!(r.range_m > 0)) return {};
  // The device counts range from the lidar's origin.
  const double mm = (static_cast<double>(r.range_m) + beam_origin_m) * 1e3;
  if (mm > 4e6) return {};
  Pixel p;
  p.range_mm = static_cast<std::uint32_t>(std::lround(mm));
  p.reflectivity = static_cast<std::uint8_t>(std::clamp(std::round(r.remission), 0.0F, 255.0F));
  // Photons fall with the square of range; a scale of our own: 1000 of a reflectivity of 100 at 10 m.
  const double range = std::max(1.0, static_cast<double>(r.range_m));
  p.signal = static_cast<std::uint16_t>(
      std::clamp(std::round(1000.0 * static_cast<double>(r.remission) / range / range), 1.0, 65535.0));
  return p;
}

}  // namespace

SensorDevice::SensorDevice(std::shared_ptr<SampleProvider> samples, models::ScanGrid grid, LidarMode mode)
    : samples_(std::move(samples)), empty_(std::move(grid)), scan_mode_(mode) {
  sample_.reserve(samples_->geometry().max_bytes);
}

Result<SensorDevice> SensorDevice::create(std::shared_ptr<SampleProvider> samples) {
  const models::LidarScan* scan = samples ? samples->scan() : nullptr;
  if (!scan)
    return fail(
        ErrorCode::bad_input, "sensor",
        "expected a simulated LiDAR for this device to be: give its emulator a `sensor` (a sensor model "
        "such as configs/sensors/ouster-os1-128.yaml)");
  auto grid = models::ScanGrid::create(*scan);
  if (!grid) return tl::unexpected<Error>(grid.error());
  const auto mode = mode_of(*scan);
  if (!mode) return tl::unexpected<Error>(mode.error());
  return SensorDevice(std::move(samples), std::move(*grid), *mode);
}

Metadata SensorDevice::metadata(const DeviceMode& mode) const {
  const models::LidarScan& s = empty_.scan();
  Metadata m;
  m.mode = mode.lidar;
  m.profile = mode.profile;
  m.window = mode.window;
  m.pixels_per_column = static_cast<std::uint32_t>(s.beams.size());
  for (const models::LidarBeam& b : s.beams) {
    m.beam_altitude_deg.push_back(b.elevation_rad / kDegree);
    m.beam_azimuth_deg.push_back(-b.azimuth_rad / kDegree);
    // The image is straight where each row is shifted by its beam's azimuth.
    const double columns = -b.azimuth_rad / (2 * kPi) * mode.lidar.columns;
    m.pixel_shift.push_back(static_cast<std::int32_t>(std::lround(columns)));
  }
  // All of them forward.
  const auto least = *std::min_element(m.pixel_shift.begin(), m.pixel_shift.end());
  for (auto& shift : m.pixel_shift) shift -= least;
  m.beam_origin_m = origin_of(s.beams[0]);
  const double c = std::cos(s.start_azimuth_rad), sn = std::sin(s.start_azimuth_rad);
  const auto whole = [](double v) { return std::abs(v - std::round(v)) < 1e-12 ? std::round(v) + 0.0 : v; };
  m.T_sensor_lidar = {whole(c), whole(-sn), 0, 0, whole(sn), whole(c),
                      0,        0,          0, 0, 1,         s.beams[0].vertical_offset_m,
                      0,        0,          0, 1};
  m.T_sensor_imu = {1, 0, 0, 6.253e-3, 0, 1, 0, -11.775e-3, 0, 0, 1, 7.645e-3, 0, 0, 0, 1};
  return m;
}

Duration SensorDevice::begin(std::uint64_t frame) const {
  // Whole seconds by integer: days of running lose nothing.
  const std::uint64_t rate = scan_mode_.rate_hz;
  return seconds(static_cast<std::int64_t>(frame / rate)) +
         Duration(static_cast<std::int64_t>(frame % rate * 1'000'000'000 / rate));
}

Duration SensorDevice::filled(std::uint64_t frame, std::uint32_t slot, const Metadata& m) const {
  return begin(frame) + seconds_from(m.column_period_s() * ((slot + 1) * m.columns_per_packet));
}

Status SensorDevice::measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                             packet_lidar::Scan& out) {
  return packet_lidar::measure_scan(*samples_, index, t_begin, motion, 0, sample_, out);
}

void SensorDevice::compose(std::uint64_t frame, std::uint32_t slot, const packet_lidar::Scan* scan,
                           const Metadata& m, std::uint64_t start_ns, LidarPacketWriter& out) const {
  std::uint64_t serial = 0;
  for (const char c : m.serial)
    if (c >= '0' && c <= '9') serial = serial * 10 + static_cast<std::uint64_t>(c - '0');
  out.set_header(static_cast<std::uint16_t>(frame), m.initialization_id, serial);
  const std::uint32_t every = scan_mode_.columns / m.mode.columns;
  const std::uint64_t t_frame = start_ns + static_cast<std::uint64_t>(begin(frame).ns());
  const bool seen = scan && scan->seen;
  for (std::uint32_t i = 0; i < m.columns_per_packet; ++i) {
    const std::uint32_t id = slot * m.columns_per_packet + i;
    const bool good = m.window.has(id);
    const auto t = t_frame + static_cast<std::uint64_t>(std::llround(m.column_period_s() * 1e9 * id));
    out.set_column(i, t, static_cast<std::uint16_t>(id), good);
    if (!good) continue;
    for (std::uint32_t row = 0; row < m.pixels_per_column; ++row) {
      out.set_near_infrared(i, row, 0);
      if (!seen) continue;
      out.set_pixel(i, row, pixel_of(scan->grid.at(id * every, row, 0), m.beam_origin_m));
      if (m.profile == Profile::dual)
        out.set_pixel(i, row, pixel_of(scan->grid.at(id * every, row, 1), m.beam_origin_m), 1);
    }
  }
}

}  // namespace rigor::ouster

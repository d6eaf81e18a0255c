#include "drivers/velodyne/packet_decoder.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

namespace rigor::velodyne {
namespace {

constexpr double kRadPerCdeg = std::numbers::pi / 18000;

/// Sine and cosine of whole hundredths of a degree; the rest is a small turn, whose square is below 1e-8.
struct Circle {
  std::array<double, kTurn_cdeg> sin, cos;
  Circle() {
    for (std::size_t i = 0; i < kTurn_cdeg; ++i) {
      sin[i] = std::sin(static_cast<double>(i) * kRadPerCdeg);
      cos[i] = std::cos(static_cast<double>(i) * kRadPerCdeg);
    }
  }
};
const Circle& circle() {
  static const Circle made;
  return made;
}

/// A rotor at 20 Hz turns by 7.2 degrees in a millisecond; a quarter more is no rotor's.
constexpr double kMaxRate_cdeg_per_ns = 7.2e-4 * 1.25;

}  // namespace

Result<PacketDecoder> PacketDecoder::create(Model model, const Calibration& calibration, RingOrder rings) {
  PacketDecoder d;
  d.facts_ = &facts_of(model);
  if (calibration.lasers.size() != d.facts_->lasers)
    return fail(ErrorCode::bad_input, "calibration",
                "expected " + std::to_string(d.facts_->lasers) + " lasers for a " +
                    std::string(d.facts_->name) + ", got " + std::to_string(calibration.lasers.size()));
  (void)circle();  // made here, not on the I/O thread
  d.range_unit_m_ = calibration.range_unit_m;
  const std::vector<std::uint16_t> order = elevation_order(calibration);
  for (std::size_t i = 0; i < calibration.lasers.size(); ++i) {
    const LaserCalibration& c = calibration.lasers[i];
    Laser l{};
    l.cos_elevation = static_cast<float>(std::cos(c.elevation_rad));
    l.sin_elevation = static_cast<float>(std::sin(c.elevation_rad));
    l.vertical_offset_m = static_cast<float>(c.vertical_offset_m);
    l.horizontal_offset_m = static_cast<float>(c.horizontal_offset_m);
    l.azimuth_cdeg = -c.azimuth_rad / kRadPerCdeg;
    l.correction_m = c.range_correction_m;
    l.min_intensity = c.min_intensity, l.max_intensity = c.max_intensity;
    // HDL-64E manual, appendix on intensity: focal distance in cm over 131 m.
    const double away = 1 - c.focal_distance_m / 131;
    l.focal_offset = 256 * away * away, l.focal_slope = c.focal_slope;
    l.ring = rings == RingOrder::laser ? static_cast<std::uint16_t>(i) : order[i];
    d.lasers_.push_back(l);
  }
  return d;
}

void PacketDecoder::place(const Laser& l, double azimuth_cdeg, DataPacket::Return r,
                          LidarPoint& to) const noexcept {
  double a = std::fmod(azimuth_cdeg + l.azimuth_cdeg, static_cast<double>(kTurn_cdeg));
  if (a < 0) a += kTurn_cdeg;
  auto whole = static_cast<std::size_t>(a + 0.5);
  const double rest = (a - static_cast<double>(whole)) * kRadPerCdeg;
  if (whole >= kTurn_cdeg) whole = 0;
  const double c0 = circle().cos[whole], s0 = circle().sin[whole];
  // Clockwise azimuth: y left falls as it grows.
  const auto cos_a = static_cast<float>(c0 - s0 * rest), sin_a = static_cast<float>(-(s0 + c0 * rest));
  const auto range_m = static_cast<float>(r.range_raw * range_unit_m_ + l.correction_m);
  const float level = range_m * l.cos_elevation;
  to.x_m = level * cos_a - l.horizontal_offset_m * sin_a;
  to.y_m = level * sin_a + l.horizontal_offset_m * cos_a;
  to.z_m = range_m * l.sin_elevation + l.vertical_offset_m;
  double intensity = r.intensity;
  if (l.focal_slope != 0) {
    const double share = 1 - r.range_raw / 65535.0;
    intensity += l.focal_slope * std::abs(l.focal_offset - 256 * share * share);
  }
  to.remission = static_cast<float>(std::clamp(intensity, l.min_intensity, l.max_intensity));
  to.ring = l.ring;
  to.flags = 0;
}

void PacketDecoder::decode(const DataPacket& packet, DecodedPacket& out) const noexcept {
  const DeviceFacts& f = *facts_;
  const std::size_t step_blocks = packet.dual() ? 2 : 1;  // blocks of the same firings
  const std::int64_t block_ns = f.sequences_per_block * f.sequence_ns;
  const double most_cdeg = kMaxRate_cdeg_per_ns * static_cast<double>(block_ns);
  const auto step_after = [&](std::size_t block) {
    return static_cast<double>(
        (packet.azimuth_cdeg(block + step_blocks) + kTurn_cdeg - packet.azimuth_cdeg(block)) % kTurn_cdeg);
  };
  // What the first block has before anything plausible was seen.
  double step_cdeg = 0;
  for (std::size_t b = 0; b + step_blocks < kBlocks; b += step_blocks)
    if (const double s = step_after(b); s <= most_cdeg) {
      step_cdeg = s;
      break;
    }
  out.sequence_count = out.point_count = 0;
  for (std::size_t block = 0, step = 0; block < kBlocks; block += step_blocks, ++step) {
    if (block + step_blocks < kBlocks)
      if (const double s = step_after(block); s <= most_cdeg) step_cdeg = s;
    const double rate = step_cdeg / static_cast<double>(block_ns);
    for (std::uint32_t half = 0; half < f.sequences_per_block; ++half) {
      DecodedPacket::Sequence& sequence = out.sequences[out.sequence_count++];
      const std::int64_t begin_ns = half * f.sequence_ns;
      sequence.azimuth_cdeg = std::fmod(packet.azimuth_cdeg(block) + rate * static_cast<double>(begin_ns),
                                        static_cast<double>(kTurn_cdeg));
      sequence.offset_ns = static_cast<std::int64_t>(step) * block_ns + begin_ns;
      sequence.first = out.point_count;
      for (std::uint32_t laser = 0; laser < f.lasers; ++laser) {
        const std::size_t channel = half * f.lasers + laser;
        const std::int64_t after_ns = begin_ns + laser * f.laser_ns;
        const double azimuth = packet.azimuth_cdeg(block) + rate * static_cast<double>(after_ns);
        const auto put = [&](DataPacket::Return r, std::uint8_t index) {
          if (r.range_raw == 0) return;
          LidarPoint& to = out.points[out.point_count++];
          place(lasers_[laser], azimuth, r, to);
          to.t_offset_ns = static_cast<std::int32_t>(static_cast<std::int64_t>(step) * block_ns + after_ns);
          to.return_index = index;
        };
        const DataPacket::Return first = packet.at(block, channel);
        if (step_blocks == 1) {
          put(first, 0);
          continue;
        }
        const DataPacket::Return other = packet.at(block + 1, channel);
        const bool two = first.range_raw != 0 && other.range_raw != 0 && first.range_raw != other.range_raw;
        put(other.range_raw != 0 ? other : first, 0);
        if (two) put(first, 1);
      }
      sequence.count = out.point_count - sequence.first;
    }
  }
}

}  // namespace rigor::velodyne

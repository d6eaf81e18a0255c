#include "drivers/sick/scan_geometry.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace rigor::sick {
namespace {

constexpr double kRadPerDeg = 0.017453292519943295;
constexpr double kTwelfths = 10000.0 / 12;

}  // namespace

double step_deg(std::uint32_t step_deg_e4) {
  const double nearest = std::round(step_deg_e4 / kTwelfths);
  if (nearest >= 1 && std::abs(step_deg_e4 - nearest * kTwelfths) <= 0.5) return nearest / 12;
  return step_deg_e4 * 1e-4;
}

DeviceTime MicrosecondClock::at(std::uint32_t us) noexcept {
  if (!known_) {
    us_ = us;
    known_ = true;
  } else {
    us_ += static_cast<std::int32_t>(us - static_cast<std::uint32_t>(us_));
  }
  return DeviceTime(us_ * 1000);
}

ScanInstants scan_instants(const ScanData& scan, MicrosecondClock& clock, double zero_index_deg) noexcept {
  ScanInstants i;
  const DeviceTime stamp = clock.at(scan.time_since_startup_us);
  i.transmission = clock.at(scan.time_of_transmission_us);
  i.first_beam = stamp;
  if (scan.scan_frequency_hz_e2 == 0 || scan.channels16.empty()) return i;
  const ScanChannel& c = scan.channels16.front();
  const double period_ns = 1e11 / scan.scan_frequency_hz_e2;
  const double ns_per_deg = period_ns / 360;
  const double step = step_deg(c.step_deg_e4);
  i.period = Duration(std::llround(period_ns));
  i.beam_step = Duration(std::llround(step * ns_per_deg));
  const double first_ns = (c.start_deg_e4 * 1e-4 - zero_index_deg) * ns_per_deg;
  const double last_ns =
      first_ns + step * static_cast<double>(c.values.empty() ? 0 : c.values.size() - 1) * ns_per_deg;
  const bool stamped_behind = static_cast<double>((i.transmission - stamp).ns()) < last_ns;
  i.first_beam = stamp + Duration(std::llround(first_ns)) - (stamped_behind ? i.period : Duration(0));
  return i;
}

bool CloudMaker::fill(const ScanData& scan, Duration beam_step, std::span<std::byte> memory,
                      std::uint32_t& count) {
  count = 0;
  std::array<const ScanChannel*, kMaxEchoes> dist{}, rssi{};
  for (const auto* channels : {&scan.channels16, &scan.channels8}) {
    for (const auto& c : *channels) {
      if (const int e = c.echo_of("DIST"); e >= 0) dist[static_cast<std::size_t>(e)] = &c;
      if (const int e = c.echo_of("RSSI"); e >= 0) rssi[static_cast<std::size_t>(e)] = &c;
    }
  }
  if (!dist[0]) return false;
  const ScanChannel& first = *dist[0];
  const std::size_t beams = first.values.size();
  constexpr std::int64_t kMostOffset_ns = std::numeric_limits<std::int32_t>::max();
  if (beam_step.ns() < 0 ||
      (beams > 1 && beam_step.ns() > kMostOffset_ns / static_cast<std::int64_t>(beams - 1)))
    return false;
  if (cosine_.size() < beams || start_deg_e4_ != first.start_deg_e4 || step_deg_e4_ != first.step_deg_e4) {
    start_deg_e4_ = first.start_deg_e4, step_deg_e4_ = first.step_deg_e4;
    cosine_.resize(beams), sine_.resize(beams);
    const double step = step_deg(step_deg_e4_);
    for (std::size_t i = 0; i < beams; ++i) {
      const double a = (start_deg_e4_ * 1e-4 - kAheadDeg + step * static_cast<double>(i)) * kRadPerDeg;
      cosine_[i] = static_cast<float>(std::cos(a)), sine_[i] = static_cast<float>(std::sin(a));
    }
  }
  const std::size_t room = memory.size() / sizeof(LidarPoint);
  for (std::size_t i = 0; i < beams; ++i) {
    for (std::size_t e = 0; e < kMaxEchoes; ++e) {
      if (!dist[e] || i >= dist[e]->values.size()) continue;
      const auto raw = dist[e]->values[i];
      if (raw < kFirstRange) continue;
      const float range_m = (static_cast<float>(raw) * dist[e]->scale + dist[e]->offset) * 1e-3F;
      if (!(range_m > 0) || !std::isfinite(range_m)) continue;
      if (count == room) return false;
      const bool there = rssi[e] && i < rssi[e]->values.size();
      const float remission =
          there ? static_cast<float>(rssi[e]->values[i]) * rssi[e]->scale + rssi[e]->offset : 0;
      const bool lit = there && std::isfinite(remission);
      const LidarPoint p{
          .x_m = range_m * cosine_[i],
          .y_m = range_m * sine_[i],
          .z_m = 0,
          .remission = lit ? remission : std::numeric_limits<float>::quiet_NaN(),
          .t_offset_ns = static_cast<std::int32_t>(beam_step.ns() * static_cast<std::int64_t>(i)),
          .ring = 0,
          .return_index = static_cast<std::uint8_t>(e),
          .flags = 0};
      std::memcpy(memory.data() + sizeof p * count++, &p, sizeof p);
    }
  }
  return true;
}

std::size_t ScanMaker::fill(std::span<const LidarPoint> points, const ChannelPlan& plan, ScanData& scan) {
  const ScanPattern& pattern = plan.pattern;
  echoes_.resize(pattern.beams);
  counts_.assign(pattern.beams, 0);
  std::size_t astray = 0;
  for (const auto& p : points) {
    const double range_m =
        std::hypot(static_cast<double>(p.x_m), static_cast<double>(p.y_m), static_cast<double>(p.z_m));
    double angle =
        std::atan2(static_cast<double>(p.y_m), static_cast<double>(p.x_m)) / kRadPerDeg + kAheadDeg;
    if (angle < pattern.start_deg - pattern.step_deg / 2) angle += 360;
    const double at = (angle - pattern.start_deg) / pattern.step_deg;
    const double beam = std::round(at);
    // A float's atan2 is good to a few 1e-6 degree: a point on its beam is never near half a step.
    if (!(beam >= 0 && beam < pattern.beams) || std::abs(at - beam) > 0.25) {
      ++astray;
      continue;
    }
    const auto b = static_cast<std::size_t>(beam);
    const Echo echo{static_cast<float>(range_m * 1e3), p.remission};
    auto& list = echoes_[b];
    auto& n = counts_[b];
    // Echoes by range, the nearest first, as the devices number them.
    std::size_t place = n;
    while (place > 0 && list[place - 1].range_mm > echo.range_mm) --place;
    if (place >= kMaxEchoes) continue;
    for (std::size_t k = std::min<std::size_t>(n, kMaxEchoes - 1); k > place; --k) list[k] = list[k - 1];
    list[place] = echo;
    n = static_cast<std::uint8_t>(std::min<std::size_t>(n + 1, kMaxEchoes));
  }

  const std::size_t echoes = std::clamp<std::size_t>(plan.echoes, 1, kMaxEchoes);
  const std::size_t wide = echoes + (plan.rssi && plan.rssi_16_bit ? echoes : 0);
  scan.channels16.resize(wide);
  scan.channels8.resize(plan.rssi && !plan.rssi_16_bit ? echoes : 0);
  const auto head = [&](ScanChannel& c, const char* kind, std::size_t echo, float scale) {
    std::copy_n(kind, 4, c.name.begin());
    c.name[4] = static_cast<char>('1' + echo);
    c.scale = scale, c.offset = 0;
    c.start_deg_e4 = static_cast<std::int32_t>(std::lround(pattern.start_deg * 1e4));
    c.step_deg_e4 = static_cast<std::uint16_t>(std::lround(pattern.step_deg * 1e4));
    c.values.assign(pattern.beams, 0);
  };
  for (std::size_t e = 0; e < echoes; ++e) {
    ScanChannel& dist = scan.channels16[e];
    head(dist, "DIST", e, plan.distance_scale);
    ScanChannel* rssi = nullptr;
    if (plan.rssi) {
      rssi = plan.rssi_16_bit ? &scan.channels16[echoes + e] : &scan.channels8[e];
      head(*rssi, "RSSI", e, 1);
    }
    for (std::size_t b = 0; b < pattern.beams; ++b) {
      const std::size_t n = counts_[b];
      const bool last = plan.filter == EchoFilter::last && n > 0;
      const std::size_t from = last ? n - 1 : 0;
      const std::size_t have = plan.filter == EchoFilter::all ? n : std::min<std::size_t>(n, 1);
      if (e >= have) continue;
      const Echo& echo = echoes_[b][from + e];
      const float raw = std::round(echo.range_mm / plan.distance_scale);
      if (!(raw >= kFirstRange && raw <= 65535)) continue;
      dist.values[b] = static_cast<std::uint16_t>(raw);
      if (!rssi) continue;
      const float most = plan.rssi_16_bit ? 65535.0F : 255.0F;
      const float units =
          std::clamp(std::round(std::ldexp(echo.rssi, -static_cast<int>(plan.rssi_shift))), 0.0F, most);
      rssi->values[b] = static_cast<std::uint16_t>(std::isnan(units) ? 0.0F : units);
    }
  }
  return astray;
}

}  // namespace rigor::sick

#include "drivers/gnss/solution_sample.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

namespace rigor::gnss {
namespace {

constexpr std::array<ValueName, 25> kValues{{{"status", ""},
                                             {"mode", ""},
                                             {"satellites_used", ""},
                                             {"satellites_in_view", ""},
                                             {"latitude_deg", "deg"},
                                             {"longitude_deg", "deg"},
                                             {"height_m", "m"},
                                             {"height_msl_m", "m"},
                                             {"velocity_east_mps", "m/s"},
                                             {"velocity_north_mps", "m/s"},
                                             {"velocity_up_mps", "m/s"},
                                             {"velocity_sigma_mps", "m/s"},
                                             {"speed_mps", "m/s"},
                                             {"course_deg", "deg"},
                                             {"sigma_east_m", "m"},
                                             {"sigma_north_m", "m"},
                                             {"sigma_up_m", "m"},
                                             {"pdop", ""},
                                             {"hdop", ""},
                                             {"vdop", ""},
                                             {"correction_age_s", "s"},
                                             {"utc_s", "s"},
                                             {"time_sigma_ns", "ns"},
                                             {"pulse_quantization_ns", "ns"},
                                             {"receiver_time_s", "s"}}};
static_assert(kValues.size() <= RegisterBlock::kMax);

/// Satellites that one sample holds: more than any receiver tracks, with several signals of each.
constexpr std::size_t kMostSatellites = 256;

}  // namespace

std::span<const ValueName> solution_values() { return kValues; }

void put_solution_values(const Solution& s, const ReceiverState& state, RegisterBlock& out) noexcept {
  const auto sigma = [&](std::size_t i) { return std::sqrt(s.covariance_enu_m2[4 * i]); };
  const std::array<double, kValues.size()> v{
      static_cast<double>(s.status),
      static_cast<double>(s.mode),
      static_cast<double>(s.satellites_used),
      static_cast<double>(state.satellites_in_view),
      s.has_fix() ? s.latitude_deg : Solution::kNone,
      s.has_fix() ? s.longitude_deg : Solution::kNone,
      s.has_fix() ? s.height_m : Solution::kNone,
      s.has_fix() ? s.height_msl_m : Solution::kNone,
      s.velocity_enu_mps[0],
      s.velocity_enu_mps[1],
      s.velocity_enu_mps[2],
      s.velocity_sigma_mps,
      s.speed_mps,
      s.course_deg,
      sigma(0),
      sigma(1),
      sigma(2),
      s.pdop,
      s.hdop,
      s.vdop,
      s.correction_age_s,
      s.utc ? static_cast<double>(s.utc->ns()) * 1e-9 : Solution::kNone,
      s.time_sigma.ns() > 0 ? static_cast<double>(s.time_sigma.ns()) : Solution::kNone,
      state.pulse_quantization_ns,
      static_cast<double>(s.t_device.ns()) * 1e-9};
  out.count = static_cast<std::uint32_t>(v.size());
  std::copy(v.begin(), v.end(), out.value.begin());
}

void put_sky(const Sky& sky, Sample& out) noexcept {
  const std::size_t room = out.memory().size() / sizeof(LidarPoint);
  std::uint32_t count = 0;
  for (const Satellite& v : sky.satellites) {
    if (!std::isfinite(v.elevation_deg) || !std::isfinite(v.azimuth_deg) || count == room) continue;
    const double el = double{v.elevation_deg} * kRadPerDeg, az = double{v.azimuth_deg} * kRadPerDeg;
    LidarPoint p{};
    p.x_m = static_cast<float>(std::cos(el) * std::sin(az));
    p.y_m = static_cast<float>(std::cos(el) * std::cos(az));
    p.z_m = static_cast<float>(std::sin(el));
    p.remission = std::isfinite(v.cn0_dbhz) ? v.cn0_dbhz : 0;
    p.ring = nmea_number(v.id);
    p.return_index = static_cast<std::uint8_t>(v.id.gnss);
    p.flags = v.used ? 1 : 0;
    std::memcpy(out.memory().data() + sizeof p * count++, &p, sizeof p);
  }
  out.info = PointCloudInfo{count};
  out.size_bytes = count * sizeof(LidarPoint);
}

void ReceiverSource::describe_channel(const ChannelSettings& settings, SampleKind kind) {
  description_.kind = kind;
  description_.frame_id = settings.frame_id;
  description_.names.clear();
  description_.units.clear();
  if (kind == SampleKind::register_block)
    for (const ValueName& v : kValues) {
      description_.names.emplace_back(v.name);
      description_.units.emplace_back(v.unit);
    }
  if (kind == SampleKind::point_cloud) description_.max_bytes = kMostSatellites * sizeof(LidarPoint);
}

void ReceiverSource::open_samples(std::size_t buffers, Feed feed) {
  feed_ = feed;
  in_run_.reset();
  state_ = {};
  last_release_ = {};
  any_handed_ = false;
  open_stream(buffers, description_.max_bytes, feed == Feed::virtual_time);
}

ReceiverStream::Handler ReceiverSource::handler() {
  ReceiverStream::Handler h;
  h.solution = [this](const Solution& s, const ReceiverStream::Place& p) { hand_solution(s, p); };
  h.sky = [this](const Sky& s, const ReceiverStream::Place& p) { hand_sky(s, p); };
  h.pulse = [this](const TimePulse& p) { note_pulse(p); };
  return h;
}

template <class Fill>
void ReceiverSource::hand(const ReceiverStream::Place& p, Duration period, Fill&& fill) noexcept {
  RunSequence::Place place{p.sequence, p.lost_before};
  if (feed_ == Feed::live) {
    const auto in_run = in_run_.place(origin(), p.t_capture, period, p.sequence, p.lost_before);
    if (!in_run) return;
    place = *in_run;
  }
  if (place.lost > 0) count_lost(place.lost);
  SampleSlot slot = take_slot();
  last_release_ = p.t_capture + config().latency;
  any_handed_ = true;
  if (slot) {
    Sample& s = *slot;
    s.size_bytes = 0;
    s.stamp = {};
    s.stamp.sequence = place.sequence;
    s.stamp.t_capture = p.t_capture;
    s.stamp.t_release = last_release_;
    s.stamp.t_arrival = feed_ == Feed::virtual_time ? last_release_ : p.arrival;
    s.stamp.sigma_capture = p.sigma;
    s.stamp.validity = p.validity;
    fill(s);
  }
  hand_over(std::move(slot));
}

void ReceiverSource::hand_solution(const Solution& s, const ReceiverStream::Place& p) noexcept {
  if (description_.kind == SampleKind::nav_fix)
    hand(p, config().period, [&](Sample& sample) { sample.info = nav_fix_of(s); });
  else if (description_.kind == SampleKind::register_block)
    hand(p, config().period, [&](Sample& sample) {
      RegisterBlock block;
      put_solution_values(s, state_, block);
      sample.info = block;
    });
}

void ReceiverSource::hand_sky(const Sky& s, const ReceiverStream::Place& p) noexcept {
  state_.satellites_in_view = static_cast<unsigned>(s.satellites.size());
  if (description_.kind == SampleKind::point_cloud)
    hand(p, config().period, [&](Sample& sample) { put_sky(s, sample); });
}

}  // namespace rigor::gnss

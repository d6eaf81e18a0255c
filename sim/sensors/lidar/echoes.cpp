#include "sim/sensors/lidar/echoes.h"

namespace rigor::lidar {

namespace {

/// The farthest a drop is detected: its remission falls with range while what is needed rises.
double farthest_drop_m(const models::LidarModel& m, const AirState& air, double extinction_per_m) {
  const auto seen = [&](double r) {
    const double e =
        LidarMath::lidar_drop_remission(
            air.drop_diameter_m,
            LidarMath::lidar_beam_diameter_m(m.footprint.start_diameter_m, air.beam_divergence_rad, r),
            m.air.drop_reflectance) *
        AirMath::air_two_way_transmission(extinction_per_m * r);
    return e > 0 && e >= LidarMath::lidar_least_remission(r, m.detection.minimum_remission,
                                                          m.detection.limit_remission,
                                                          m.detection.limit_range_m, m.detection.overlap_m);
  };
  double low = m.range.min_m, high = m.range.max_m;
  if (!seen(low)) return 0;
  if (seen(high)) return high;
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (seen(middle) ? low : high) = middle;
  }
  return low;
}

}  // namespace

AirState air_state(const models::LidarModel& m, const render::ContentFrame& frame, int band, double z_m) {
  AirState air;
  const auto b = static_cast<std::size_t>(band);
  double fog_per_m = 0;  // around the sensor
  for (const render::Haze& haze : frame.hazes) {
    const auto extinction = static_cast<double>(haze.extinction_per_m[b]);
    if (!(extinction > 0)) continue;
    if (z_m < haze.top_m) fog_per_m += extinction;
    if (haze.top_m == std::numeric_limits<double>::infinity() || air.layer_count == air.layers.size())
      air.everywhere_per_m += extinction;
    else
      air.layers[air.layer_count++] = {extinction, haze.top_m};
  }
  const render::Precipitation& p = frame.precipitation;
  if (p.kind != render::Precipitation::Kind::none) {
    air.everywhere_per_m += static_cast<double>(p.extinction_per_m[b]);
    air.beam_divergence_rad =
        std::sqrt(m.footprint.horizontal_divergence_rad * m.footprint.vertical_divergence_rad);
    const bool beam_has_width = m.footprint.start_diameter_m > 0 || air.beam_divergence_rad > 0;
    if (m.air.drop_reflectance > 0 && p.drops_per_m3 > 0 && p.diameter_m > 0 && beam_has_width) {
      air.drop_diameter_m = static_cast<double>(p.diameter_m);
      air.drop_reach_m = farthest_drop_m(m, air, air.everywhere_per_m + fog_per_m);
      if (air.drop_reach_m > m.range.min_m) {
        air.drops_per_m3 = static_cast<double>(p.drops_per_m3);
        air.drops_within_reach =
            LidarMath::lidar_expected_drops(m.range.min_m, air.drop_reach_m, m.footprint.start_diameter_m,
                                            air.beam_divergence_rad, air.drops_per_m3);
      }
    }
  }
  if (m.air.lidar_ratio_sr > 0 && fog_per_m > 0) {
    // Power from fog falls with range: the echo is where the receiver first sees all of the beam.
    const double r = std::max(m.range.min_m, m.detection.overlap_m);
    air.soft_range_m = static_cast<float>(r);
    air.soft_remission = static_cast<float>(
        LidarMath::lidar_soft_remission(fog_per_m, m.air.lidar_ratio_sr, m.air.pulse_length_m) *
        AirMath::air_two_way_transmission(fog_per_m * r));
  }
  return air;
}

void EchoList::insert(const models::LidarModel& m, const Echo& e) {
  for (std::uint32_t i = 0; i < count_; ++i) {
    Echo& have = echoes_[i];
    if (std::abs(have.range_m - e.range_m) > static_cast<float>(m.echoes.separation_m)) continue;
    const double ph = power(m, have.remission, have.range_m), pe = power(m, e.remission, e.range_m);
    const double range = (ph * have.range_m + pe * e.range_m) / (ph + pe);
    const float remission = static_cast<float>((ph + pe) / power(m, 1.0, range));
    have.cos_incidence = static_cast<float>(
        (ph * static_cast<double>(have.cos_incidence) + pe * static_cast<double>(e.cos_incidence)) /
        (ph + pe));
    if (pe > ph) have.source = e.source, have.sub_ray = e.sub_ray;
    have.range_m = static_cast<float>(range);
    have.remission = remission;
    return;
  }
  if (count_ == kMaxEchoes) drop_weakest();
  std::uint32_t at = count_++;
  for (; at > 0 && echoes_[at - 1].range_m > e.range_m; --at) echoes_[at] = echoes_[at - 1];
  echoes_[at] = e;
}

EchoList form_echoes(const models::LidarModel& m, std::span<Return> returns) {
  // By insertion: few, and mostly in order.
  for (std::size_t i = 1; i < returns.size(); ++i) {
    const Return r = returns[i];
    std::size_t at = i;
    for (; at > 0 && returns[at - 1].range_m > r.range_m; --at) returns[at] = returns[at - 1];
    returns[at] = r;
  }
  EchoList list;
  const auto separation = static_cast<float>(m.echoes.separation_m);
  for (std::size_t i = 0; i < returns.size();) {
    double sum = 0, moment = 0, cosine = 0, most = -1;
    std::uint16_t dominant = 0;
    const float nearest = returns[i].range_m;
    std::size_t j = i;
    do {
      const Return& r = returns[j];
      const double p = power(m, r.remission, r.range_m);
      sum += p;
      moment += p * static_cast<double>(r.range_m - nearest);
      cosine += p * static_cast<double>(r.cos_incidence);
      if (p > most) most = p, dominant = r.sub_ray;
      ++j;
    } while (j < returns.size() && returns[j].range_m - returns[j - 1].range_m <= separation);
    const double range = static_cast<double>(nearest) + moment / sum;
    list.push_back({.range_m = static_cast<float>(range),
                    .remission = static_cast<float>(sum / power(m, 1.0, range)),
                    .cos_incidence = static_cast<float>(cosine / sum),
                    .sub_ray = dominant});
    i = j;
  }
  return list;
}

}  // namespace rigor::lidar

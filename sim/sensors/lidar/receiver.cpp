#include <cmath>

#include "sim/sensors/lidar/lidar_simulator_impl.h"

namespace rigor {

using lidar::Echo;
using lidar::EchoList;
using lidar::EchoSource;
using lidar::LidarMath;
using lidar::PointTruth;
using lidar::ScanRays;
using models::LidarReturns;

void LidarSimulator::Impl::receive_tile(std::uint32_t tile) {
  const std::size_t first = std::size_t{tile} * lidar::kTileColumns * rays.beams() * returns_per_firing;
  std::uint32_t count = 0;
  for (std::uint32_t i = 0; i < rays.tile_columns(tile); ++i)
    for (std::uint32_t s = 0; s < rays.beams(); ++s)
      receive(tile * lidar::kTileColumns + i, s, count, &tile_points[first],
              want_truth ? &tile_truth[first] : nullptr);
  tile_count[tile] = count;
}

/// What the device makes of one firing's light.
void LidarSimulator::Impl::receive(std::uint32_t column, std::uint32_t slot_index, std::uint32_t& count,
                                   LidarPoint* to, PointTruth* truth_to) {
  const std::size_t firing = std::size_t{column} * rays.beams() + slot_index;
  const ScanRays::Slot& slot = rays.slot(slot_index);
  const Echo* have = &echoes[firing * echoes_kept];
  std::uint32_t have_count = echo_count[firing];

  // What else sends light: ghosts of retro-reflectors beside, drops, fog. Rare, so the list is made on
  // demand.
  EchoList list;
  const auto add = [&](const Echo& e) {
    if (list.count() == 0)
      for (std::uint32_t i = 0; i < have_count; ++i) list.push_back(have[i]);
    list.insert(m, e);
  };
  if (any_retro) {
    const auto columns = static_cast<int>(rays.columns()), beams = static_cast<int>(rays.beams());
    for (int dc = -m.retro.crosstalk_columns; dc <= m.retro.crosstalk_columns; ++dc)
      for (int db = -m.retro.crosstalk_beams; db <= m.retro.crosstalk_beams; ++db) {
        const int c = static_cast<int>(column) + dc, rank = static_cast<int>(slot.rank) + db;
        if ((dc == 0 && db == 0) || c < 0 || c >= columns || rank < 0 || rank >= beams) continue;
        const std::size_t other =
            static_cast<std::size_t>(c) * rays.beams() + rays.slot_of_rank(static_cast<std::uint32_t>(rank));
        const Echo& bright = retro[other];
        if (!(bright.remission > 0)) continue;
        float ghost = bright.remission;
        for (int step = std::abs(dc) + std::abs(db); step > 0; --step)
          ghost *= static_cast<float>(m.retro.crosstalk);
        add({.range_m = bright.range_m, .remission = ghost, .source = EchoSource::ghost});
      }
  }
  if (air.drops_per_m3 > 0) {
    const auto words = models::draw_words(key, models::NoiseEffect::lidar_drop, capture_index,
                                          static_cast<std::uint32_t>(firing));
    const double expected = -std::log(models::NoiseMath<double>::unit_from_bits(words[0]));
    if (expected < air.drops_within_reach) {
      const double r = LidarMath::lidar_nearest_drop_m(expected, m.range.min_m, m.footprint.start_diameter_m,
                                                       air.beam_divergence_rad, air.drops_per_m3);
      const float nearest = have_count > 0 ? have[0].range_m : std::numeric_limits<float>::infinity();
      if (static_cast<float>(r) < nearest) {
        const double e = LidarMath::lidar_drop_remission(
            air.drop_diameter_m,
            LidarMath::lidar_beam_diameter_m(m.footprint.start_diameter_m, air.beam_divergence_rad, r),
            m.air.drop_reflectance);
        Eigen::Vector3f direction, origin;
        rays.centre(firing, track, direction, origin);
        const double two_way = air.two_way(track.origin().z() + static_cast<double>(origin.z()),
                                           static_cast<double>(direction.z()), r);
        add({.range_m = static_cast<float>(r),
             .remission = static_cast<float>(e * two_way),
             .source = EchoSource::particle});
      }
    }
  }
  if (air.soft_remission > 0 && (have_count == 0 || air.soft_range_m < have[0].range_m))
    add({.range_m = air.soft_range_m, .remission = air.soft_remission, .source = EchoSource::particle});
  if (list.count() > 0) {
    have = &list[0];
    have_count = list.count();
  }
  if (have_count == 0) return;

  // Which echoes are detected, and which of them are told.
  const double sun = any_sun && sun_seen[firing] ? sun_noise : 0;
  const auto detected = [&](const Echo& e) {
    if (spec.ideal) return true;
    const double least = LidarMath::lidar_least_remission(
        static_cast<double>(e.range_m), m.detection.minimum_remission, m.detection.limit_remission,
        m.detection.limit_range_m, m.detection.overlap_m);
    return e.remission > 0 && static_cast<double>(e.remission) >= least * (1 + sun);
  };
  int first = -1, strongest = -1, second = -1, last = -1;
  double p1 = -1, p2 = -1;
  for (std::uint32_t i = 0; i < have_count; ++i) {
    if (!detected(have[i])) continue;
    const int n = static_cast<int>(i);
    if (first < 0) first = n;
    last = n;
    const double p = have_count == 1 ? 0 : lidar::power(m, have[i].remission, have[i].range_m);
    if (p > p1) {
      second = strongest, p2 = p1;
      strongest = n, p1 = p;
    } else if (p > p2) {
      second = n, p2 = p;
    }
  }
  if (first < 0) return;
  int told[2] = {strongest, -1};
  if (!spec.ideal) {
    if (m.echoes.returns == LidarReturns::first) told[0] = first;
    if (m.echoes.returns == LidarReturns::last) told[0] = last;
    if (m.echoes.returns == LidarReturns::dual) told[1] = last != strongest ? last : second;
  }

  const ScanRays::Aim& aim = rays.aim(firing);
  const auto t_offset_ns = static_cast<std::int32_t>(std::lround(rays.time_s(column, slot_index) * 1e9));
  for (std::uint8_t r = 0; r < 2; ++r) {
    if (told[r] < 0) continue;
    const Echo& e = have[told[r]];
    double range = static_cast<double>(e.range_m);
    const double remission = static_cast<double>(e.remission);
    double units = LidarMath::lidar_remission_units(
        remission, range, m.remission.scale, m.remission.retro_scale,
        m.remission.range_exponent > 0 ? m.remission.reference_range_m : 0, m.remission.range_exponent);
    if (!spec.ideal) {
      units *= static_cast<double>(slot.remission_gain);
      if (noisy) {
        const auto words = models::draw_words(key, models::NoiseEffect::lidar_echo, capture_index,
                                              static_cast<std::uint32_t>(firing * 2 + r));
        using Draws = models::NoiseMath<double>;
        double sigma = 0;
        if (remission > 1 && m.noise.retro_sigma_m > 0) {
          sigma = m.noise.retro_sigma_m;
        } else {
          const double q = m.noise.reference_range_m > 0
                               ? LidarMath::lidar_received_power(remission, range, m.noise.reference_range_m,
                                                                 m.detection.overlap_m)
                               : remission;
          sigma = m.noise.scale_m > 0 ? LidarMath::lidar_range_sigma_m(q, m.noise.floor_m, m.noise.scale_m,
                                                                       m.noise.offset, m.noise.exponent)
                                      : m.noise.floor_m;
        }
        if (sun > 0) sigma *= std::sqrt(1 + sun);
        range += sigma * Draws::normal_quantile(Draws::unit_from_bits(words[0]));
        if (m.remission.noise > 0)
          units *= 1 + m.remission.noise * Draws::normal_quantile(Draws::unit_from_bits(words[1]));
      }
      range += LidarMath::lidar_range_error_m(static_cast<double>(e.range_m), m.range.scale,
                                              static_cast<double>(slot.bias_m), m.range.remission_bias_m,
                                              remission, m.range.incidence_bias_m,
                                              static_cast<double>(e.cos_incidence));
      if (m.range.step_m > 0) range = LidarMath::lidar_quantise(range, m.range.step_m);
      units = std::max(0.0, units);
      if (m.remission.step > 0) units = LidarMath::lidar_quantise(units, m.remission.step);
      if (m.remission.maximum > 0) units = std::min(units, m.remission.maximum);
    }
    if (!(range >= m.range.min_m && range <= m.range.max_m && range > 0)) continue;
    const auto d = static_cast<float>(range);
    to[count] = {.x_m = aim.origin_m[0] + d * aim.direction[0],
                 .y_m = aim.origin_m[1] + d * aim.direction[1],
                 .z_m = aim.origin_m[2] + d * aim.direction[2],
                 .remission = static_cast<float>(units),
                 .t_offset_ns = t_offset_ns,
                 .ring = slot.ring,
                 .return_index = r,
                 .flags = 0};
    if (truth_to) {
      PointTruth& t = truth_to[count];
      t = {};
      t.range_m = centre_range_m[firing];
      t.source = e.source;
      if (e.source == EchoSource::surface) {
        // Echoes of surfaces keep their sub-ray when others join the list: find the truth by it.
        const Echo* own = &echoes[firing * echoes_kept];
        for (std::uint32_t i = 0; i < echo_count[firing]; ++i)
          if (own[i].sub_ray == e.sub_ray) t.echo = echo_truth[firing * echoes_kept + i];
      }
    }
    ++count;
  }
}

}  // namespace rigor

#include "sim/sensors/lidar/scan_rays.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace rigor::lidar {

using models::LidarScanKind;

void Track::follow(const render::PoseFunction& T_world_sensor, BenchTime begin, Duration duration,
                   std::uint32_t columns) {
  // 128 steps: 10 m/s² over 0.8 ms of a 100 ms scan depart from a line by 0.8 µm.
  const std::int64_t steps = duration.ns() > 0 ? std::min<std::int64_t>(std::max(columns, 2U), 128) : 0;
  steps_.clear();
  bool moves = false;
  Eigen::Isometry3d first;
  for (std::int64_t i = 0; i <= steps; ++i) {
    const Eigen::Isometry3d pose = T_world_sensor(steps == 0 ? begin : begin + duration * i / steps);
    if (i == 0) {
      first = pose;
      origin_ = pose.translation();
    }
    // A pose that is no number counts as moved, so that it is seen by `finite`.
    moves = moves || !(pose.matrix() == first.matrix());
    steps_.push_back({(pose.translation() - origin_).cast<float>(), pose.linear().cast<float>()});
  }
  if (!moves) steps_.resize(1);
}

Track::At Track::at(float share) const {
  if (steps_.size() == 1) return steps_.front();
  const float x = std::clamp(share, 0.0F, 1.0F) * static_cast<float>(steps_.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(x), steps_.size() - 2);
  const float t = x - static_cast<float>(i);
  const At &a = steps_[i], &b = steps_[i + 1];
  return {a.shift + t * (b.shift - a.shift), a.R_world_sensor + t * (b.R_world_sensor - a.R_world_sensor)};
}

bool Track::finite() const {
  return origin_.allFinite() && std::all_of(steps_.begin(), steps_.end(), [](const At& a) {
           return a.shift.allFinite() && a.R_world_sensor.allFinite();
         });
}

double Track::reach_m() const {
  double reach = 0;
  for (const At& a : steps_) reach = std::max(reach, static_cast<double>(a.shift.norm()));
  return reach;
}

ScanRays::ScanRays(const models::LidarModel& model, bool ideal) : scan_(model.scan) {
  columns_ = scan_.columns;
  beams_ = static_cast<std::uint32_t>(scan_.beams.size());
  column_period_s_ = scan_.column_period_s;
  duration_s_ = scan_.duration_s();

  std::vector<std::uint32_t> order(beams_);
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(),
                   [&](auto a, auto b) { return scan_.beams[a].fire_time_s < scan_.beams[b].fire_time_s; });
  slots_.resize(beams_);
  for (std::uint32_t s = 0; s < beams_; ++s) {
    const models::LidarBeam& b = scan_.beams[order[s]];
    slots_[s] = {.ring = static_cast<std::uint16_t>(order[s]),
                 .fire_time_s = b.fire_time_s,
                 .bias_m = static_cast<float>(b.range_bias_m + model.range.bias_m),
                 .remission_gain = static_cast<float>(b.remission_gain)};
  }
  slot_of_rank_.resize(beams_);
  std::iota(slot_of_rank_.begin(), slot_of_rank_.end(), 0U);
  std::stable_sort(slot_of_rank_.begin(), slot_of_rank_.end(), [&](auto a, auto b) {
    return scan_.beams[slots_[a].ring].elevation_rad < scan_.beams[slots_[b].ring].elevation_rad;
  });
  for (std::uint32_t r = 0; r < beams_; ++r) slots_[slot_of_rank_[r]].rank = static_cast<std::uint16_t>(r);

  footprint_ = model.footprint;
  if (ideal) footprint_.sub_rays = 1, footprint_.most_sub_rays = 0;
  const models::LidarFootprint& footprint = footprint_;
  for (const models::SubRay& s : models::footprint_pattern(footprint)) {
    pattern_.push_back({static_cast<float>(s.u * std::tan(footprint.horizontal_divergence_rad / 2)),
                        static_cast<float>(s.v * std::tan(footprint.vertical_divergence_rad / 2)),
                        static_cast<float>(s.u * footprint.start_diameter_m / 2),
                        static_cast<float>(s.v * footprint.start_diameter_m / 2), static_cast<float>(s.u),
                        static_cast<float>(s.v)});
    weights_.push_back(static_cast<float>(s.weight));
  }

  aims_.resize(firings());
  if (scan_.kind == LidarScanKind::rotor)
    for (std::uint32_t c = 0; c < columns_; ++c)
      for (std::uint32_t s = 0; s < beams_; ++s) {
        const double azimuth = scan_.azimuth_rad(c) + scan_.rotation_radps * slots_[s].fire_time_s;
        aim_at(c, s, models::rotor_aim(scan_.beams[slots_[s].ring], azimuth));
      }
}

void ScanRays::aim_at(std::uint32_t column, std::uint32_t slot, const models::LidarAim& aim) {
  Aim& to = aims_[std::size_t{column} * beams_ + slot];
  for (std::size_t i = 0; i < 3; ++i) {
    to.direction[i] = static_cast<float>(aim.direction[i]);
    to.origin_m[i] = static_cast<float>(aim.origin_m[i]);
  }
}

void ScanRays::begin_table(std::uint64_t index) {
  const models::PatternTable& pattern = *scan_.pattern.table;
  table_.clear();
  pattern.scan(index, scan_.pattern_scan_ns, table_);
  columns_ = static_cast<std::uint32_t>(table_.size());
  half_divergence_.resize(pattern.has_divergence ? columns_ : 0);
  for (std::uint32_t c = 0; c < columns_; ++c) {
    models::LidarBeam beam = scan_.beams[0];
    beam.azimuth_rad = static_cast<double>(table_[c].azimuth_rad);
    beam.elevation_rad = static_cast<double>(table_[c].elevation_rad);
    aim_at(c, 0, models::rotor_aim(beam, 0));
    if (pattern.has_divergence) half_divergence_[c] = std::tan(table_[c].divergence_rad / 2);
  }
  mean_half_divergence_ = 0;
  for (const float h : half_divergence_)
    mean_half_divergence_ += static_cast<double>(h) / static_cast<double>(half_divergence_.size());
}

void ScanRays::begin_scan(std::uint64_t index, BenchTime begin) {
  if (scan_.kind == LidarScanKind::rotor) return;
  if (scan_.pattern.table) return begin_table(index);
  const bool formula = scan_.kind == LidarScanKind::pattern;
  const double begin_s =
      formula ? static_cast<double>(index) * (static_cast<double>(scan_.pattern_scan_ns) * 1e-9)
              : static_cast<double>(begin.ns()) * 1e-9;
  tbb::parallel_for(0U, tiles(), [&](std::uint32_t tile) {
    for (std::uint32_t i = 0; i < tile_columns(tile); ++i)
      for (std::uint32_t s = 0; s < beams_; ++s) {
        const std::uint32_t c = tile * kTileColumns + i;
        const double t_s = begin_s + time_s(c, s);
        if (formula)
          aim_at(c, s, {models::livox_mid360_direction(slots_[s].ring, t_s), {0, 0, 0}});
        else
          aim_at(c, s, models::rosette_aim(scan_.beams[slots_[s].ring], scan_.prisms, t_s));
      }
  });
}

ScanRays::Width ScanRays::width(std::uint32_t sub_rays) const {
  if (sub_rays == 1) return {};
  // Half the side of a square with the area of a disc of radius 1, shared by the rays.
  const double share = std::sqrt(std::numbers::pi / sub_rays) / 2;
  double radius_per_m = std::sqrt(std::tan(footprint_.horizontal_divergence_rad / 2) *
                                  std::tan(footprint_.vertical_divergence_rad / 2));
  if (!half_divergence_.empty()) radius_per_m = mean_half_divergence_;
  return {static_cast<float>(share * footprint_.start_diameter_m / 2),
          static_cast<float>(share * radius_per_m)};
}

void ScanRays::centre(std::size_t firing, const Track& track, Eigen::Vector3f& direction,
                      Eigen::Vector3f& origin) const {
  const auto column = static_cast<std::uint32_t>(firing / beams_),
             s = static_cast<std::uint32_t>(firing % beams_);
  const Track::At at = track.at(share(column, s));
  const Aim& a = aims_[firing];
  direction = (at.R_world_sensor * Eigen::Map<const Eigen::Vector3f>(a.direction)).normalized();
  origin = at.shift + at.R_world_sensor * Eigen::Map<const Eigen::Vector3f>(a.origin_m);
}

ScanRays::Beam ScanRays::beam(std::uint32_t column, std::uint32_t slot, const Track& track) const {
  const float when = share(column, slot);
  const Track::At at = track.at(when);
  const Aim& a = aims_[std::size_t{column} * beams_ + slot];
  const Eigen::Map<const Eigen::Vector3f> d_sensor(a.direction);
  const float level = std::sqrt(d_sensor.x() * d_sensor.x() + d_sensor.y() * d_sensor.y());
  const Eigen::Vector3f left_sensor = level > 1e-6F
                                          ? Eigen::Vector3f(-d_sensor.y() / level, d_sensor.x() / level, 0)
                                          : Eigen::Vector3f(0, 1, 0);
  const Eigen::Vector3f d = at.R_world_sensor * d_sensor, left = at.R_world_sensor * left_sensor;
  return {at.shift + at.R_world_sensor * Eigen::Map<const Eigen::Vector3f>(a.origin_m), d, left,
          d.cross(left), when};
}

namespace {

void put(render::Ray& to, const Eigen::Vector3f& origin, const Eigen::Vector3f& direction, float when,
         float far_m) {
  const float inverse = 1.0F / std::sqrt(direction.squaredNorm());
  for (int k = 0; k < 3; ++k) {
    to.origin[k] = origin[k];
    to.direction[k] = direction[k] * inverse;
  }
  to.time = when;
  to.far_m = far_m;
}

}  // namespace

void ScanRays::fill_tile(std::uint32_t tile, const Track& track, float far_m,
                         std::span<render::Ray> rays) const {
  for (std::uint32_t i = 0; i < tile_columns(tile); ++i)
    for (std::uint32_t s = 0; s < beams_; ++s) {
      const std::uint32_t column = tile * kTileColumns + i;
      const Beam b = beam(column, s, track);
      render::Ray* to = &rays[ray_in_tile(tile, i, s)];
      put(*to, b.origin, b.direction, b.when, far_m);
      for (std::size_t k = 1; k < pattern_.size(); ++k) {
        const Offset& p = pattern_[k];
        const bool own = !half_divergence_.empty();
        const float across = own ? p.u * half_divergence_[column] : p.across;
        const float rise = own ? p.v * half_divergence_[column] : p.up;
        put(*++to, b.origin + p.across_m * b.left + p.up_m * b.up,
            b.direction + across * b.left + rise * b.up, b.when, far_m);
      }
    }
}

void ScanRays::fill_firing(std::size_t firing, std::uint32_t first, const Track& track, float far_m,
                           std::span<render::Ray> rays) const {
  const auto column = static_cast<std::uint32_t>(firing / beams_),
             slot = static_cast<std::uint32_t>(firing % beams_);
  const Beam b = beam(column, slot, track);
  const bool own = !half_divergence_.empty();
  const auto across =
      own ? half_divergence_[column] : static_cast<float>(std::tan(footprint_.horizontal_divergence_rad / 2));
  const auto rise =
      own ? half_divergence_[column] : static_cast<float>(std::tan(footprint_.vertical_divergence_rad / 2));
  const auto radius_m = static_cast<float>(footprint_.start_diameter_m / 2);
  for (std::uint32_t k = 0; k < rays.size(); ++k) {
    const models::SubRay r = models::footprint_ray(footprint_, static_cast<std::uint32_t>(firing), first + k);
    const auto u = static_cast<float>(r.u), v = static_cast<float>(r.v);
    put(rays[k], b.origin + u * radius_m * b.left + v * radius_m * b.up,
        b.direction + u * across * b.left + v * rise * b.up, b.when, far_m);
  }
}

}  // namespace rigor::lidar

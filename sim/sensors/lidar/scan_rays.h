// From a scan pattern and a moving platform to rays: where each firing starts, where it points, and when.
//
// A firing has the index column · beams + slot, slots in the order of firing. Rays of a query lie in tiles of
// kTileColumns columns: in a tile beam by beam from the lowest up, in a beam column by column, then sub-rays,
// so that neighbours in the query are neighbours in space (engines work on packets).
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::lidar {

inline constexpr std::uint32_t kTileColumns = 16;

/// Poses over a scan, relative to the first: linear in between (rotations by normalised matrices; the
/// instants are so near each other that both are exact to well below a micrometre).
class Track {
 public:
  /// At equal steps over `duration`; calls the function once for each instant.
  void follow(const render::PoseFunction& T_world_sensor, BenchTime begin, Duration duration,
              std::uint32_t columns);
  [[nodiscard]] const Eigen::Vector3d& origin() const { return origin_; }
  [[nodiscard]] bool still() const { return steps_.size() == 1; }
  /// Origin's shift and rotation at a share 0 … 1 of the scan.
  struct At {
    Eigen::Vector3f shift;
    Eigen::Matrix3f R_world_sensor;
  };
  [[nodiscard]] At at(float share) const;
  [[nodiscard]] bool finite() const;
  /// Farthest way from the first pose's place.
  [[nodiscard]] double reach_m() const;

 private:
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();
  std::vector<At> steps_;
};

class ScanRays {
 public:
  explicit ScanRays(const models::LidarModel& model, bool ideal);

  /// Of the scan at hand: a pattern's scans differ.
  [[nodiscard]] std::uint32_t columns() const { return columns_; }
  [[nodiscard]] std::uint32_t beams() const { return beams_; }
  [[nodiscard]] std::size_t firings() const { return std::size_t{columns_} * beams_; }
  [[nodiscard]] std::uint32_t sub_rays() const { return static_cast<std::uint32_t>(pattern_.size()); }
  [[nodiscard]] std::uint32_t tiles() const { return (columns_ + kTileColumns - 1) / kTileColumns; }
  [[nodiscard]] std::uint32_t tile_columns(std::uint32_t tile) const {
    return std::min(kTileColumns, columns_ - tile * kTileColumns);
  }
  /// What a ray of a firing stands for: squares that are together as large as the footprint. A ray alone is
  /// its middle.
  struct Width {
    float half_m = 0, half_per_m = 0;
  };
  [[nodiscard]] Width width(std::uint32_t sub_rays) const;
  [[nodiscard]] float weight(std::size_t sub_ray) const { return weights_[sub_ray]; }

  struct Slot {
    std::uint16_t ring = 0;  ///< beam index
    std::uint16_t rank = 0;  ///< from the lowest beam up
    double fire_time_s = 0;
    float bias_m = 0, remission_gain = 1;
  };
  [[nodiscard]] const Slot& slot(std::uint32_t s) const { return slots_[s]; }
  /// Slot of the beam with a rank.
  [[nodiscard]] std::uint32_t slot_of_rank(std::uint32_t rank) const { return slot_of_rank_[rank]; }

  struct Aim {
    float direction[3], origin_m[3];  ///< sensor frame at the firing's instant
  };
  [[nodiscard]] const Aim& aim(std::size_t firing) const { return aims_[firing]; }
  [[nodiscard]] double time_s(std::uint32_t column, std::uint32_t slot) const {
    if (!table_.empty()) return static_cast<double>(table_[column].time_ns) * 1e-9;
    return column * column_period_s_ + slots_[slot].fire_time_s;
  }
  [[nodiscard]] double duration_s() const { return duration_s_; }

  /// Aims that change from scan to scan: of a rosette by the bench time at which it begins, of a pattern by
  /// its index. Parallel.
  void begin_scan(std::uint64_t index, BenchTime begin);
  /// Most firings of any scan.
  [[nodiscard]] std::size_t max_firings() const { return std::size_t{scan_.columns} * beams_; }
  /// First ray of a firing among those of its tile.
  [[nodiscard]] std::size_t ray_in_tile(std::uint32_t tile, std::uint32_t column_in_tile,
                                        std::uint32_t slot) const {
    return (std::size_t{slots_[slot].rank} * tile_columns(tile) + column_in_tile) * pattern_.size();
  }
  [[nodiscard]] std::size_t rays_in_tile(std::uint32_t tile) const {
    return std::size_t{tile_columns(tile)} * beams_ * pattern_.size();
  }
  /// All rays of a tile.
  void fill_tile(std::uint32_t tile, const Track& track, float far_m, std::span<render::Ray> rays) const;
  /// Rays are added where echoes are not clear: no pattern is the same for all.
  [[nodiscard]] bool adds_rays() const { return footprint_.most_sub_rays > 0; }
  /// Rays first … first + rays.size() - 1 of a firing's sequence.
  void fill_firing(std::size_t firing, std::uint32_t first, const Track& track, float far_m,
                   std::span<render::Ray> rays) const;
  /// World direction and origin (relative to the track's) of a firing's centre.
  void centre(std::size_t firing, const Track& track, Eigen::Vector3f& direction,
              Eigen::Vector3f& origin) const;
  [[nodiscard]] float share(std::uint32_t column, std::uint32_t slot) const {
    return duration_s_ > 0 ? static_cast<float>(time_s(column, slot) / duration_s_) : 0.0F;
  }

 private:
  /// A firing's ray in the world, and the axes across it.
  struct Beam {
    Eigen::Vector3f origin, direction, left, up;
    float when;
  };
  [[nodiscard]] Beam beam(std::uint32_t column, std::uint32_t slot, const Track& track) const;
  void aim_at(std::uint32_t column, std::uint32_t slot, const models::LidarAim& aim);
  void begin_table(std::uint64_t index);

  models::LidarScan scan_;
  std::uint32_t columns_ = 0, beams_ = 0;
  double column_period_s_ = 0, duration_s_ = 0;
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> slot_of_rank_;
  std::vector<Aim> aims_;
  struct Offset {
    float across, up;      ///< angle as a tangent
    float across_m, up_m;  ///< shift of the origin
    float u, v;            ///< on the unit disc
  };
  models::LidarFootprint footprint_;
  std::vector<Offset> pattern_;
  std::vector<float> weights_;
  std::vector<models::PatternFiring> table_;  ///< of the scan at hand, by column
  std::vector<float> half_divergence_;        ///< as a tangent, by column; empty: the model's
  double mean_half_divergence_ = 0;           ///< of these: rays of a scan have one width
};

}  // namespace rigor::lidar

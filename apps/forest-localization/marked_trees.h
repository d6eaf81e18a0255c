// Guides to the stems that are marked for felling: to one after the other, the nearest first; or along a
// path, with a stop where one comes within reach, and there a crane works. Keys: forest_localization.h,
// `marked`.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "apps/forest-localization/crane_ports.h"
#include "apps/forest-localization/path_follower.h"
#include "apps/forest-localization/stem_map.h"

namespace rigor::forest {

class MarkedTrees {
 public:
  // Setup context; ConfigError with its place is thrown.
  /// The map outlives it.
  MarkedTrees(const ConfigNode& n, const StemMap& map);
  void add_crane(const ConfigNode& n, const ApplicationPorts& ports) { crane_.emplace(n, ports); }
  [[nodiscard]] bool along_path() const noexcept { return along_path_; }
  /// Of a path: where on it each marked stem is worked on. Within the crane's reach, as nearly at its best
  /// bearing as can be; without a crane, where the path passes it.
  void plan_stops(PathFollower& follower);

  // Loop thread; no allocation.
  /// Before the follower's step: tells it how far, or where to.
  void step(PathFollower& follower, const PoseGaussian& pose, bool may_drive, BenchTime now) noexcept;
  /// Stems of a scan, in the base's frame. Where it stands before a stem, what the scanners see of it is
  /// nearer to the truth than the map.
  void see(std::span<const StemObservation> stems, const PoseGaussian& pose,
           const PathFollower& follower) noexcept;
  /// The crane works: the base must stand.
  [[nodiscard]] bool busy() const noexcept { return crane_ && crane_->work().busy(); }
  /// What of the scans is the crane itself.
  [[nodiscard]] std::optional<IgnoredStrip> strip() const noexcept {
    return crane_ ? crane_->strip() : std::nullopt;
  }
  /// The stem it is about, or StemMap::kNone.
  [[nodiscard]] std::uint32_t target() const noexcept { return target_; }
  [[nodiscard]] double cut() const noexcept { return crane_ ? crane_->work().cut() : 0; }
  [[nodiscard]] std::uint32_t out_of_reach() const noexcept { return out_of_reach_; }

 private:
  static constexpr Duration kSettles = seconds(1);
  static constexpr double kSameStem_m = 0.3;
  struct Stop {
    double progress_m = 0;
    std::uint32_t stem = 0;
  };
  void work_along(PathFollower& follower, const PoseGaussian& pose, bool may_drive, BenchTime now) noexcept;
  void aim(PathFollower& follower, const PoseGaussian& pose, BenchTime now) noexcept;

  const StemMap* map_;
  bool along_path_ = false;
  double stand_off_m_ = 2;
  Duration dwell_;
  std::optional<CranePorts> crane_;
  std::vector<std::uint8_t> visited_;
  std::uint32_t target_ = StemMap::kNone;
  BenchTime t_there_;

  // Along a path.
  std::vector<Stop> stops_;
  std::size_t next_stop_ = 0;
  std::uint32_t out_of_reach_ = 0;
  bool begun_here_ = false, target_seen_ = false;
  Eigen::Vector2d target_in_base_ = Eigen::Vector2d::Zero();
};

}  // namespace rigor::forest

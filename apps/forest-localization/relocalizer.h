// Where the base is, without a pose to begin with: two stems that are as far apart as two of the map's, and
// as thick, give a pose, and the other stems say whether it is right.
//
// The search is cut into pieces for the loop: `begin` takes the stems of one scan, each `work` tries so many
// poses, and `state` tells whether it has found one. Meanwhile the base may move: what is found holds for the
// instant of that scan.
//
// When is a pose right? Among N poses that were tried in a stand of density λ, so many other stems fall
// within `tolerance_m` of a stem of the map by chance that the expected number of poses with m or more
// agreeing ones is N·P(B(K − 2, λπ·tolerance²) ≥ m − 2) (a contrario: Desolneux, Moisan, Morel, IJCV 2000).
// It must be below `false_alarms`, and no pose elsewhere may have as many less one: a stand planted in rows
// looks alike in many places.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "apps/forest-localization/statistics.h"
#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/stem_map.h"

namespace rigor::forest {

struct RelocalizerConfig {
  double tolerance_m = 0.25;
  double map_sigma_m = 0.03, map_radius_sigma_m = 0.02;
  double false_alarms = 1e-3;
  std::uint32_t max_pairs = 60;  ///< of observations, the farthest apart first
};

/// Where the base should be, roughly: of a satellite receiver.
struct PositionHint {
  double x_m = 0, y_m = 0, sigma_m = 0;
};

class Relocalizer {
 public:
  enum class State : std::uint8_t { idle, working, found, failed };
  static constexpr std::size_t kMaxStems = 24;

  explicit Relocalizer(const RelocalizerConfig& config) : config_(config) {}

  // Loop thread; no allocation.
  /// Stems in the base's frame; the nearest kMaxStems count. The map outlives the search.
  void begin(std::span<const StemObservation> stems, const StemMap& map,
             std::optional<PositionHint> hint = {}) noexcept;
  /// Tries at most `poses` poses.
  void work(std::uint32_t poses) noexcept;
  [[nodiscard]] State state() const noexcept { return state_; }
  void forget() noexcept { state_ = State::idle; }
  /// Where state is found: the pose by least squares over the stems that agree.
  [[nodiscard]] const PoseGaussian& pose() const noexcept { return pose_; }
  [[nodiscard]] std::uint32_t agreeing() const noexcept { return best_count_; }
  [[nodiscard]] std::uint64_t tried() const noexcept { return tried_; }

 private:
  struct Pair {
    double distance_m;
    std::uint32_t a, b;
  };
  void next_pair() noexcept;
  void try_pose(std::uint32_t stem_a, std::uint32_t stem_b) noexcept;
  [[nodiscard]] bool convincing() const noexcept;
  [[nodiscard]] bool refine() noexcept;
  [[nodiscard]] bool fits_radius(const StemObservation& o, std::uint32_t stem) const noexcept;

  RelocalizerConfig config_;
  const StemMap* map_ = nullptr;
  std::optional<PositionHint> hint_;
  std::array<StemObservation, kMaxStems> stems_{};
  std::uint32_t count_ = 0;
  std::array<Pair, kMaxStems*(kMaxStems - 1) / 2> pairs_{};
  std::uint32_t pair_count_ = 0, pair_ = 0;
  std::span<const StemPair> candidates_;
  std::size_t candidate_ = 0;
  std::uint64_t tried_ = 0;
  Eigen::Vector3d best_ = Eigen::Vector3d::Zero();
  std::uint32_t best_count_ = 0, second_count_ = 0;
  double best_sum_ = 0;
  State state_ = State::idle;
  PoseGaussian pose_;
};

}  // namespace rigor::forest

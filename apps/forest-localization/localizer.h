// The base's pose from stems, odometry, a gyro where there is one, and a rough place where there is one.
//
// Samples come with latencies of their own: a scan that is 160 ms old meets odometry that is 10 ms old. So
// the filter stands at the last scan's instant, and what odometry and gyro said is kept; the pose of any
// later instant is worked out ahead of it.
//
//   searching ──constellation found──▶ tracking ──no stems for long, or wheels alone──▶ dead_reckoning
//       ▲       stems fit again           │ ▲                                              │
//       └── scans do not fit for metres ──┘ └──────────────── stems fit again ─────────────┘
//
// Where several scans do not fit, a search begins beside the tracking. It replaces the pose when it finds
// another; finding none is no proof against the pose, which goes on by odometry for `blind_way_m`. While
// searching dead reckoning goes on, too, and ends the search when what is seen fits it.
//
// A scan that does not fit is tried again with a looser prior before it counts against the pose: wheels slip
// by decimetres between two scans.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "apps/forest-localization/pose_filter.h"
#include "apps/forest-localization/relocalizer.h"
#include "apps/forest-localization/stem_matcher.h"
#include "apps/forest-localization/timeline.h"
#include "rt-core/time.h"

namespace rigor::forest {

struct LocalizerConfig {
  PoseFilterConfig filter;
  StemMatcherConfig matcher;
  RelocalizerConfig relocalizer;
  double lost_sigma_m = 0.5;  ///< of the place, its worse axis, from which the pose is not to drive by
  double slip_m = 0.4, slip_rad = 0.2;  ///< what wheels may have slipped between two scans
  std::uint32_t lost_scans = 8;  ///< that do not fit, one after the other, from which it doubts the pose
  double blind_way_m = 5;        ///< way in doubt, after which the pose counts as lost
  double near_m = 1;             ///< sigma of a search around dead reckoning, at the least
  double guess_speed_mps = 0.5, guess_turn_radps = 0.5;  ///< without odometry: sigma of what is unknown
};

enum class LocalizerState : std::uint8_t { searching, tracking, dead_reckoning };

class Localizer {
 public:
  /// Setup context. Without a start it begins with searching. The map outlives it.
  Localizer(const LocalizerConfig& config, const StemMap& map, std::optional<PoseGaussian> start);

  // Loop thread; no allocation.
  /// Way and turn since some start, as the odometry counts them.
  void odometry(BenchTime t_capture, double way_m, double turn_rad) noexcept;
  /// Rate about the base's z.
  void gyro(BenchTime t_capture, double rate_radps) noexcept;
  /// Of a satellite receiver. It confines a search, and begins one where the pose is far from it.
  void hint(BenchTime t_capture, const PositionHint& hint) noexcept;
  /// Stems of one scan, in the base's frame at t_capture. Older than the one before: left out.
  void scan(BenchTime t_capture, std::span<const StemObservation> stems) noexcept;
  /// Once a cycle: a piece of the search, at most `poses` poses.
  void work(std::uint32_t poses) noexcept;

  [[nodiscard]] LocalizerState state() const noexcept { return state_; }
  /// At `now`, ahead of the last scan by what odometry and gyro said since, and by their last rates where
  /// they have not said it yet. While searching: where it was lost, moved on.
  [[nodiscard]] PoseGaussian at(BenchTime now) noexcept;
  [[nodiscard]] const PoseFilter& filter() const noexcept { return filter_; }
  /// Speed and turn rate by the last odometry (and gyro), corrected.
  [[nodiscard]] double speed_mps() const noexcept;
  [[nodiscard]] double turn_radps() const noexcept;

  struct Counters {
    std::uint64_t scans = 0, old_scans = 0, empty_scans = 0, poor_scans = 0;
    std::uint64_t stems = 0, matched = 0, slips = 0, lost = 0, found = 0, searches = 0;
  };
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 private:
  template <class F>
  void increments(BenchTime from, BenchTime to, F&& take) const noexcept;
  void advance(BenchTime to) noexcept;
  void lose() noexcept;
  void start_search(BenchTime t, std::span<const StemObservation> stems) noexcept;
  [[nodiscard]] double worst_sigma_m() const noexcept;
  [[nodiscard]] double way_m() const noexcept {
    return odometry_.size() > 0 ? odometry_.newest().sums[0] : 0;
  }

  LocalizerConfig config_;
  const StemMap* map_;
  PoseFilter filter_;
  StemMatcher matcher_;
  Relocalizer relocalizer_;
  Timeline<2> odometry_;  ///< way, turn
  Timeline<1> gyro_;      ///< angle
  double last_rate_radps_ = 0;
  BenchTime t_filter_, t_search_, t_hint_;
  std::optional<PositionHint> hint_;
  bool begun_ = false;
  bool pose_known_ = false;  ///< of some time: there is something to reckon on from
  double way_good_m_ = 0;    ///< odometry's, at the last scan that fitted
  std::uint32_t poor_ = 0, far_ = 0, agreeing_ = 0;
  LocalizerState state_ = LocalizerState::searching;
  Counters counters_;
};

}  // namespace rigor::forest

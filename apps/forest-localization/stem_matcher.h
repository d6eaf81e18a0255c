// Which stem of the map each observed circle is.
//
// Joint compatibility by branch and bound (J. Neira, J. D. Tardós, IEEE T-RA 2001): pairings are taken one by
// one, nearest observation first; each must fit within the 0.999 ellipsoid of what is left of the pose's
// uncertainty after those before it, and all together within that of their sum. The pairing with most members
// wins, among equals the one of least sum. Conditioning a pose of three numbers is cheap, so the joint
// distance comes as a sum of conditional ones.
//
// The diameter is a third coordinate of each observation and tells neighbours apart.
//
// The search ends after `max_nodes`; what was best by then counts.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "apps/forest-localization/statistics.h"
#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/stem_map.h"

namespace rigor::forest {

struct StemMatch {
  std::uint32_t observation = 0, stem = 0;
};

struct StemMatcherConfig {
  double map_sigma_m = 0.03;         ///< of a stem's place in the map, each axis
  double map_radius_sigma_m = 0.02;  ///< of its radius there against what a scanner sees
  std::uint32_t max_nodes = 1500;
};

class StemMatcher {
 public:
  static constexpr std::size_t kMaxMatches = 40;

  explicit StemMatcher(const StemMatcherConfig& config) : config_(config) {}
  /// Observations in the base's frame; of more than kMaxMatches the nearest. The answer is valid until the
  /// next call. Loop thread; no allocation.
  std::span<const StemMatch> match(std::span<const StemObservation> stems, const PoseGaussian& prior,
                                   const StemMap& map) noexcept;
  /// Of the last call: the search was cut short.
  [[nodiscard]] bool exhausted() const noexcept { return nodes_ >= config_.max_nodes; }

 private:
  struct Path {
    std::array<StemMatch, kMaxMatches> match;
    std::uint32_t count = 0;
    double sum = 0;
  };
  void descend(std::uint32_t depth, const PoseGaussian& pose) noexcept;

  StemMatcherConfig config_;
  const StemMap* map_ = nullptr;
  std::span<const StemObservation> stems_;
  std::array<std::uint32_t, StemDetector::kMaxStems> order_{};
  std::uint32_t count_ = 0, nodes_ = 0;
  Path now_, best_;
};

}  // namespace rigor::forest

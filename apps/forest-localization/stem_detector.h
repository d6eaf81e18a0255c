// Stems in one sweep of a 2D scanner: segments between jumps of the range, a circle for each, and what a
// stem cannot be thrown away.
//
// A circle that is seen from one side, in a few points, is badly told by its curvature alone: at 10 m a stem
// of 30 cm is five beams of a scanner with steps of a third of a degree, and its sagitta of 15 cm has a noise
// of 12 mm. So the fit has two kinds of residuals:
//
//   points  (|p − c| − ρ − sin²α·σ²/2ρ) / σ_e     α: incidence; the third term is the mean by which noise
//           σ_e² = σ²cos²α + surface²             along a slanted beam moves points outwards (Chernov,
//                + sin⁴α·σ⁴/2ρ²                    "Circular and Linear Regression", 2010, ch. 6)
//   edges   the tangent's bearing, φ ± asin(ρ/d), lies between the last beam that met the stem and the next
//           that passed it: middle ± step/√12. Only where what is beside is farther away: behind another
//           stem there is no edge to be seen.
//
// Start: from both edges and the nearest point, or, where one is hidden, Taubin's algebraic circle (PAMI
// 1991). Refinement: Gauss–Newton with damping. The covariance is the inverse of the normal matrix.
//
// Thrown away: wider than a stem (walls), misfit beyond the 0.999 quantile (bushes, boxes), a radius that
// remains undetermined, hollow circles (corners from inside).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sensor-hal/types/sample.h"

namespace rigor::forest {

struct StemDetectorConfig {
  double range_sigma_m = 0.0116;
  double step_rad = 0.0058177641733144;  ///< between beams
  double half_field_rad = 2.35619449;    ///< the sweep goes from minus to plus this bearing
  double edge_beyond_rad = 0;            ///< so far beside a stem's edge a beam still returns: its footprint
  double edge_sigma_rad = 0;             ///< how well that is known; beside step/√12
  double surface_sigma_m = 0.003;        ///< bark
  double min_diameter_m = 0.05, max_diameter_m = 1.2;
  double min_range_m = 0.2, max_range_m = 20;
  std::size_t min_points = 4;
  double max_radius_sigma_m = 0.06;
  double misfit = 1;  ///< times the variance that noise explains; more for stems that are no circles
};

/// A stem's circle in the frame of the scan (or wherever it was moved to), in the horizontal plane.
struct StemObservation {
  double x_m = 0, y_m = 0, radius_m = 0;
  double covariance[3][3] = {};  ///< of x, y, radius
  std::uint32_t points = 0;
  bool hidden_left = false, hidden_right = false;
  double chi_squared = 0;
  std::uint32_t degrees_of_freedom = 0;
};

/// x, y, yaw: maps child coordinates to parent coordinates, in the plane.
struct PlanarPose {
  double x_m = 0, y_m = 0, yaw_rad = 0;
};
[[nodiscard]] StemObservation moved(const StemObservation& stem, const PlanarPose& T_parent_child) noexcept;

/// How the scanner moves while it turns, in its own axes at t_capture.
struct ScanMotion {
  double forward_mps = 0, left_mps = 0, turn_radps = 0;
};

class StemDetector {
 public:
  static constexpr std::size_t kMaxBeams = 16384;  ///< of a sweep; what is beyond is left out and counted
  static constexpr std::size_t kMaxStems = 64;     ///< the nearest ones

  /// Setup context: takes its memory.
  explicit StemDetector(const StemDetectorConfig& config);
  [[nodiscard]] const StemDetectorConfig& config() const noexcept { return config_; }

  /// Stems in the scanner's frame at t_capture, by increasing bearing; valid until the next call. NaN,
  /// infinite and zero points are no returns; second returns are left out. Loop thread; no allocation.
  std::span<const StemObservation> detect(std::span<const LidarPoint> scan,
                                          const ScanMotion& motion = {}) noexcept;

  struct Counters {
    std::uint64_t scans = 0, left_out = 0;
    std::uint64_t segments = 0, too_few = 0, too_wide = 0, misfit = 0, undetermined = 0, stems = 0;
  };
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 private:
  struct Beam {
    double bearing_rad, range_m, x_m, y_m;
    std::int32_t t_offset_ns;
  };
  struct Edge {
    bool seen = false;
    double bearing_rad = 0;
  };
  std::size_t take(std::span<const LidarPoint> scan) noexcept;
  [[nodiscard]] double jump_m(double range_m) const noexcept;
  [[nodiscard]] bool connected(const Beam& a, const Beam& b) const noexcept;
  [[nodiscard]] Edge edge(std::size_t last, std::ptrdiff_t outwards, std::size_t count) const noexcept;
  bool fit(std::size_t first, std::size_t end, std::size_t count, StemObservation& out) noexcept;
  void keep(const StemObservation& stem) noexcept;

  StemDetectorConfig config_;
  std::vector<Beam> beams_;
  std::vector<StemObservation> stems_;
  std::size_t stem_count_ = 0;
  Counters counters_;
};

}  // namespace rigor::forest

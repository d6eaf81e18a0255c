// What has changed between a LiDAR and its simulated side, from point clouds of the same instants.
//
// Points of one firing (the same offset, ring and return) are compared along their ray. Of the simulated
// point at range ρ in direction d, on a surface with normal n, the residual real − simulated of the range is
//
//   range bias         1                        m
//   range scale        ρ                        relative
//   mount x, y, z      −ρ (d × n)/(d·n)         rad, of the real sensor in the simulated side's frame
//   mount move x, y, z −n/(d·n)                 m, likewise
//   beam k             1 for its rings          m, apart from the range bias; sum 0
//   remission          simulated remission      relative, in a fit of its own
//
// ρ is the mean of the point's two neighbours along the ring: noise of the point itself is in the residual,
// too, and would show as a scale of −noise² over the variance of ranges.
//
// Normals come from the simulated cloud: across neighbouring points of a ring, and across rings where there
// are several. A scanner of one ring sees a plane: its turn about z and its moves along x and y are all there
// is. Edges and grazing rays are left out; Huber's weights (c = 1.345) limit what stands out (leaves,
// people).
//
// Noise is what second differences along a ring leave of the residuals: its variance over sigma_m², as excess
// of the real side if the simulated side's noise is sigma_m; over all, and by remission in three equal parts
// of remission_max against that. `lost` is the share of firings that the simulated side alone answers,
// `gained` that which the real side alone answers, of those that either answers. First returns only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/pair_watch/noise_sums.h"
#include "sensor-hal/channel/pair_watch/robust_fit.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"
#include "sensor-hal/types/sample.h"

namespace rigor::pair_watch {

struct CloudChangeOptions {
  std::size_t points = 100000;  ///< at most, in a cloud; what comes after is not looked at
  std::size_t rows = 8192;      ///< the regression takes every n-th point, so that these are enough
  std::uint32_t rings = 1;      ///< ring indices are below this
  double sigma_m = 0.02;        ///< of one range, by the sensor model
  double remission_max = 1;     ///< in the device's own unit
  double edge_m = 0.3;  ///< neighbours farther apart than this in range, per metre across, are an edge
};

class CloudChange {
 public:
  /// Setup; allocates all there will be. bad_input: options out of bounds.
  [[nodiscard]] static Result<CloudChange> make(const CloudChangeOptions& options);
  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return parameters_; }

  /// A point of the regression: on a surface of the simulated side, with what the real one measured there.
  struct Row {
    std::array<double, 8> derivative;  ///< bias, scale, turns, moves
    double residual, base_weight, weight;
    std::uint32_t beam;
    std::array<double, 3> direction, normal;  ///< unit
    double range;                             ///< simulated, m
    std::int32_t t_ns;
    std::uint16_t ring;
  };

  // One thread at a time; no allocation.
  /// Of the last pair, by ring, then by firing; empty where it said nothing.
  [[nodiscard]] std::span<const Row> rows() const noexcept { return rows_; }
  /// False: not clouds, or one is incomplete; nothing has happened. A cloud without points is one.
  bool add(const Sample& real, const Sample& simulated) noexcept;
  void finish(Estimate& estimate) noexcept;

 private:
  explicit CloudChange(const CloudChangeOptions& options);
  struct Point {
    double d[3];  ///< unit
    double range = 0, azimuth_rad = 0, remission = 0;
    double residual = 0, remission_residual = 0;  ///< NaN: the real side has none
    std::int32_t t_ns = 0;
    std::uint16_t ring = 0;
  };
  [[nodiscard]] static double off_line_m(const Point& a, const Point& p, const Point& b) noexcept;
  [[nodiscard]] bool normal_at(std::size_t i, double (&n)[3]) const noexcept;
  [[nodiscard]] const Point* beside(const Point& p, std::size_t ring) const noexcept;
  void match(const Sample& real, const Sample& simulated) noexcept;
  void take_noise(std::size_t begin, std::size_t end) noexcept;
  void regress() noexcept;

  CloudChangeOptions options_;
  std::vector<Parameter> parameters_;
  std::size_t beams_ = 1, first_beam_ = 0, rest_ = 0;  ///< rest: place of the first after the fit's
  std::vector<std::size_t> term_of_;                   ///< of bias, scale, turns, moves; none: kMaxParameters
  std::vector<Point> points_;                          ///< of the simulated side, by ring, then by firing
  std::vector<std::size_t> ring_begin_;
  std::vector<std::uint32_t> ring_order_;  ///< rings by elevation
  std::vector<std::uint32_t> ring_place_;  ///< of a ring in that order
  std::vector<Row> rows_;
  RobustFit fit_;
  WindowFit remission_;
  NoiseSums noise_sums_;
  double both_ = 0, lost_ = 0, gained_ = 0;
};

}  // namespace rigor::pair_watch

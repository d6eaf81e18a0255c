// A forest of discs, walls and a bush, measured by rays in closed form: the truth for tests that must not
// know the simulator of the bench.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/stem_map.h"
#include "sensor-hal/types/sample.h"

namespace rigor::forest::test {

constexpr double kPi = std::numbers::pi;

struct Segment {
  double ax, ay, bx, by;
};

struct Scanner {
  double step_rad = kPi / 540;  ///< a third of a degree
  double half_angle_rad = 0.75 * kPi;
  double range_sigma_m = 0.0116;
  double max_range_m = 25;
  double rotation_s = 1.0 / 15;
  double mount_x_m = 0;  ///< ahead of the pose that it is given, on the same body
  double drop = 0;       ///< share of returns that are lost
};

struct Twist {
  double forward_mps = 0, turn_radps = 0;
};

/// A pose that moves on a circle.
inline PlanarPose after(const PlanarPose& from, const Twist& twist, double dt_s) {
  const double half = twist.turn_radps * dt_s / 2;
  const double chord = twist.forward_mps * dt_s * (std::abs(half) < 1e-9 ? 1 : std::sin(half) / half);
  return {from.x_m + chord * std::cos(from.yaw_rad + half), from.y_m + chord * std::sin(from.yaw_rad + half),
          from.yaw_rad + 2 * half};
}

class DiscForest {
 public:
  std::vector<Stem> stems;
  std::vector<Segment> walls;

  /// Stems at random, at least `apart_m` from each other and from the points of `free`, by `margin_m`.
  static DiscForest random(double half_extent_m, double per_m2, unsigned seed,
                           const std::vector<PlanarPose>& free = {}, double margin_m = 1.2) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> place(-half_extent_m, half_extent_m), radius(0.08, 0.25);
    DiscForest f;
    const auto wanted = static_cast<std::size_t>(per_m2 * 4 * half_extent_m * half_extent_m);
    for (int tries = 0; f.stems.size() < wanted && tries < 200000; ++tries) {
      const Stem s{place(rng), place(rng), radius(rng)};
      const auto near = [&](double x, double y, double limit) {
        return std::hypot(s.x_m - x, s.y_m - y) < limit;
      };
      if (std::any_of(f.stems.begin(), f.stems.end(),
                      [&](const Stem& o) { return near(o.x_m, o.y_m, 1.5); }) ||
          std::any_of(free.begin(), free.end(),
                      [&](const PlanarPose& p) { return near(p.x_m, p.y_m, margin_m); }))
        continue;
      f.stems.push_back(s);
    }
    return f;
  }

  /// One sweep around t_capture, at which the scanner's body has the pose T_world_body and moves with
  /// `twist`. Beams at −half … +half; the middle one fires at t_capture. What meets nothing is left out.
  std::vector<LidarPoint> scan(const PlanarPose& T_world_body, const Scanner& s, std::mt19937& rng,
                               const Twist& twist = {}) const {
    std::normal_distribution<double> noise(0, s.range_sigma_m);
    std::uniform_real_distribution<double> chance(0, 1);
    const auto beams = static_cast<std::size_t>(std::llround(2 * s.half_angle_rad / s.step_rad)) + 1;
    std::vector<const Stem*> near;
    for (const Stem& stem : stems)
      if (std::hypot(stem.x_m - T_world_body.x_m, stem.y_m - T_world_body.y_m) < s.max_range_m + 2)
        near.push_back(&stem);
    std::vector<double> range(beams, std::numeric_limits<double>::infinity());
    std::vector<double> at_s(beams);
    const bool moves = twist.forward_mps != 0 || twist.turn_radps != 0;
    for (std::size_t i = 0; i < beams; ++i)
      at_s[i] = (static_cast<double>(i) * s.step_rad - s.half_angle_rad) / (2 * kPi) * s.rotation_s;
    const auto mounted = [&](const PlanarPose& body) {
      return PlanarPose{body.x_m + s.mount_x_m * std::cos(body.yaw_rad),
                        body.y_m + s.mount_x_m * std::sin(body.yaw_rad), body.yaw_rad};
    };
    const PlanarPose T_world_sensor = mounted(T_world_body);
    const auto pose_of = [&](std::size_t i) {
      return moves ? mounted(after(T_world_body, twist, at_s[i])) : T_world_sensor;
    };
    for (const Stem* stem : near) {
      // Only the beams that can meet it, found by where it stands at t_capture, with room for the motion.
      const double dx = stem->x_m - T_world_sensor.x_m, dy = stem->y_m - T_world_sensor.y_m;
      const double d = std::hypot(dx, dy);
      if (d <= stem->radius_m) continue;
      const double middle = std::remainder(std::atan2(dy, dx) - T_world_sensor.yaw_rad, 2 * kPi);
      const double room = std::asin(stem->radius_m / d) + (moves ? 0.05 + 0.1 / d : 0) + 2 * s.step_rad;
      const auto index = [&](double bearing) {
        return static_cast<std::ptrdiff_t>(std::floor((bearing + s.half_angle_rad) / s.step_rad));
      };
      const auto from = std::max<std::ptrdiff_t>(0, index(middle - room));
      const auto to = std::min<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(beams) - 1, index(middle + room));
      for (auto i = from; i <= to; ++i) {
        const auto k = static_cast<std::size_t>(i);
        const PlanarPose p = pose_of(k);
        const double angle = p.yaw_rad + static_cast<double>(i) * s.step_rad - s.half_angle_rad;
        const double ux = std::cos(angle), uy = std::sin(angle);
        const double x = stem->x_m - p.x_m, y = stem->y_m - p.y_m;
        const double along = x * ux + y * uy, across2 = x * x + y * y - along * along;
        if (along <= 0 || across2 >= stem->radius_m * stem->radius_m) continue;
        range[k] = std::min(range[k], along - std::sqrt(stem->radius_m * stem->radius_m - across2));
      }
    }
    for (const Segment& w : walls)
      for (std::size_t k = 0; k < beams; ++k) {
        const PlanarPose p = pose_of(k);
        const double angle = p.yaw_rad + static_cast<double>(k) * s.step_rad - s.half_angle_rad;
        const double ux = std::cos(angle), uy = std::sin(angle);
        const double ex = w.bx - w.ax, ey = w.by - w.ay, det = ex * uy - ey * ux;
        if (std::abs(det) < 1e-12) continue;
        const double qx = w.ax - p.x_m, qy = w.ay - p.y_m;
        const double r = (ex * qy - ey * qx) / det, u = (ux * qy - uy * qx) / det;
        if (r > 0 && u >= 0 && u <= 1) range[k] = std::min(range[k], r);
      }
    std::vector<LidarPoint> out;
    for (std::size_t k = 0; k < beams; ++k) {
      if (!(range[k] < s.max_range_m) || (s.drop > 0 && chance(rng) < s.drop)) continue;
      const double r = range[k] + (s.range_sigma_m > 0 ? noise(rng) : 0);
      const double bearing = static_cast<double>(k) * s.step_rad - s.half_angle_rad;
      LidarPoint point{};
      point.x_m = static_cast<float>(r * std::cos(bearing));
      point.y_m = static_cast<float>(r * std::sin(bearing));
      point.t_offset_ns = static_cast<std::int32_t>(std::llround(at_s[k] * 1e9));
      out.push_back(point);
    }
    return out;
  }
};

/// Quantiles of the chi-squared distribution at 0.0005 and 0.9995: Wilson and Hilferty; for 20 and more
/// degrees.
inline double chi_squared_low(double n) {
  return n * std::pow(1 - 2 / (9 * n) - 3.2905 * std::sqrt(2 / (9 * n)), 3);
}
inline double chi_squared_high(double n) {
  return n * std::pow(1 - 2 / (9 * n) + 3.2905 * std::sqrt(2 / (9 * n)), 3);
}

}  // namespace rigor::forest::test

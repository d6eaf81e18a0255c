#include "apps/forest-localization/stem_detector.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "apps/forest-localization/statistics.h"

namespace rigor::forest {
namespace {

struct Circle {
  double x_m = 0, y_m = 0, radius_m = 0;
};

/// Radius whose curvature at the rim decides how far two neighbouring beams of one stem may lie apart.
constexpr double kRimRadius_m = 0.25;

/// A beam that grazes a stem says little by its range and all by having met it, which the edges say already.
constexpr double kLeastCosine = 0.5;

/// Means of the points less their centre of gravity, for Taubin's fit.
struct Moments {
  double xx = 0, yy = 0, xy = 0, xz = 0, yz = 0, zz = 0, mean_x = 0, mean_y = 0;
};

/// Newton's method on the characteristic polynomial, from 0: N. Chernov, "Circular and Linear Regression",
/// 2010, sec. 5.9.
Circle taubin(const Moments& m) noexcept {
  const double z = m.xx + m.yy;
  const double covariance = m.xx * m.yy - m.xy * m.xy;
  const double variance_z = m.zz - z * z;
  const double a3 = 4 * z, a2 = -3 * z * z - m.zz;
  const double a1 = variance_z * z + 4 * covariance * z - m.xz * m.xz - m.yz * m.yz;
  const double a0 =
      m.xz * (m.xz * m.yy - m.yz * m.xy) + m.yz * (m.yz * m.xx - m.xz * m.xy) - variance_z * covariance;
  double x = 0, y = a0;
  for (int i = 0; i < 30; ++i) {
    const double slope = a1 + x * (2 * a2 + 3 * a3 * x);
    const double next = x - y / slope;
    if (next == x || !std::isfinite(next)) break;
    const double next_y = a0 + next * (a1 + next * (a2 + next * a3));
    if (std::abs(next_y) >= std::abs(y)) break;
    x = next;
    y = next_y;
  }
  const double det = 2 * (x * x - x * z + covariance);
  const double cx = (m.xz * (m.yy - x) - m.yz * m.xy) / det;
  const double cy = (m.yz * (m.xx - x) - m.xz * m.xy) / det;
  return {cx + m.mean_x, cy + m.mean_y, std::sqrt(cx * cx + cy * cy + z)};
}

}  // namespace

StemObservation moved(const StemObservation& stem, const PlanarPose& T) noexcept {
  const double c = std::cos(T.yaw_rad), s = std::sin(T.yaw_rad);
  StemObservation out = stem;
  out.x_m = T.x_m + c * stem.x_m - s * stem.y_m;
  out.y_m = T.y_m + s * stem.x_m + c * stem.y_m;
  Eigen::Matrix3d R;
  R << c, -s, 0, s, c, 0, 0, 0, 1;
  Eigen::Matrix3d P;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) P(i, j) = stem.covariance[i][j];
  const Eigen::Matrix3d turned = R * P * R.transpose();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out.covariance[i][j] = turned(i, j);
  return out;
}

StemDetector::StemDetector(const StemDetectorConfig& config)
    : config_(config), beams_(kMaxBeams), stems_(kMaxStems) {}

std::size_t StemDetector::take(std::span<const LidarPoint> scan) noexcept {
  std::size_t n = 0;
  for (const LidarPoint& p : scan) {
    if (p.return_index != 0) continue;
    const double x = p.x_m, y = p.y_m;
    const double range = std::hypot(x, y);
    if (!std::isfinite(range) || range < config_.min_range_m) continue;
    if (n == kMaxBeams) {
      ++counters_.left_out;
      continue;
    }
    beams_[n++] = {std::atan2(y, x), range, x, y, p.t_offset_ns};
  }
  const auto less = [](const Beam& a, const Beam& b) {
    return a.bearing_rad != b.bearing_rad ? a.bearing_rad < b.bearing_rad : a.range_m < b.range_m;
  };
  const auto end = beams_.begin() + static_cast<std::ptrdiff_t>(n);
  if (!std::is_sorted(beams_.begin(), end, less)) std::sort(beams_.begin(), end, less);
  return n;
}

double StemDetector::jump_m(double range_m) const noexcept {
  // Between the last two beams on a stem the surface falls back by up to √(2·ρ·spacing).
  const double rim = std::sqrt(2 * kRimRadius_m * range_m * config_.step_rad);
  return std::min(rim, 0.4) + 4 * config_.range_sigma_m;
}

bool StemDetector::connected(const Beam& a, const Beam& b) const noexcept {
  // A hole of one beam is a return that was lost.
  return b.bearing_rad - a.bearing_rad < 2.6 * config_.step_rad &&
         std::abs(b.range_m - a.range_m) < jump_m(std::min(a.range_m, b.range_m));
}

StemDetector::Edge StemDetector::edge(std::size_t last, std::ptrdiff_t outwards,
                                      std::size_t count) const noexcept {
  Edge e;
  const double sign = outwards > 0 ? 1 : -1;
  e.bearing_rad = beams_[last].bearing_rad + sign * (config_.step_rad / 2 - config_.edge_beyond_rad);
  // At the end of the sweep nobody looked beside it.
  if (sign * beams_[last].bearing_rad + 1.5 * config_.step_rad > config_.half_field_rad) return e;
  e.seen = true;  // no return beside: the open air
  if ((outwards < 0 && last == 0) || (outwards > 0 && last + 1 == count)) return e;
  const Beam& next = beams_[last + static_cast<std::size_t>(outwards)];
  const bool beside = std::abs(next.bearing_rad - beams_[last].bearing_rad) < 1.6 * config_.step_rad;
  if (beside) e.seen = next.range_m > beams_[last].range_m;
  return e;
}

bool StemDetector::fit(std::size_t first, std::size_t end, std::size_t count, StemObservation& out) noexcept {
  const std::size_t n = end - first;
  const Edge right = edge(first, -1, count), left = edge(end - 1, 1, count);
  const double sigma = config_.range_sigma_m, sigma2 = sigma * sigma;

  Moments m;
  double nearest = beams_[first].range_m;
  for (std::size_t i = first; i < end; ++i) {
    m.mean_x += beams_[i].x_m / static_cast<double>(n);
    m.mean_y += beams_[i].y_m / static_cast<double>(n);
    nearest = std::min(nearest, beams_[i].range_m);
  }
  Circle c;
  if (right.seen && left.seen) {
    const double half = (left.bearing_rad - right.bearing_rad) / 2;
    const double middle = (left.bearing_rad + right.bearing_rad) / 2;
    if (!(half > 0) || half > 1.2) return ++counters_.too_wide, false;
    const double d = nearest / (1 - std::sin(half));
    c = {d * std::cos(middle), d * std::sin(middle), d * std::sin(half)};
  } else {
    for (std::size_t i = first; i < end; ++i) {
      const double x = beams_[i].x_m - m.mean_x, y = beams_[i].y_m - m.mean_y, z = x * x + y * y;
      m.xx += x * x, m.yy += y * y, m.xy += x * y, m.xz += x * z, m.yz += y * z, m.zz += z * z;
    }
    const double k = 1 / static_cast<double>(n);
    m.xx *= k, m.yy *= k, m.xy *= k, m.xz *= k, m.yz *= k, m.zz *= k;
    c = taubin(m);
    if (!std::isfinite(c.radius_m) || c.radius_m > config_.max_diameter_m) {
      // Points that are nearly straight, or bent the wrong way by noise: begin with a stem of middle size.
      const double r = 0.15, d = std::hypot(m.mean_x, m.mean_y);
      c = {m.mean_x * (1 + r / d), m.mean_y * (1 + r / d), r};
    }
  }

  const double edge_variance =
      config_.step_rad * config_.step_rad / 12 + config_.edge_sigma_rad * config_.edge_sigma_rad;
  Eigen::Matrix3d N;
  Eigen::Vector3d g;
  // Sum of squares at `at`, and the normal equations there. Weights are those of the last circle.
  const auto evaluate = [&](const Circle& at, const Circle& weights_of) {
    N.setZero();
    g.setZero();
    double sum = 0;
    const auto add = [&](double residual, const Eigen::Vector3d& J, double weight) {
      N.noalias() += weight * J * J.transpose();
      g.noalias() += weight * residual * J;
      sum += weight * residual * residual;
    };
    for (std::size_t i = first; i < end; ++i) {
      const Beam& b = beams_[i];
      // Incidence by where the beam passes the centre, not by the point: noise must not choose its own
      // weight.
      const double rho = std::max(weights_of.radius_m, 0.02);
      const double beside = (b.x_m * weights_of.y_m - b.y_m * weights_of.x_m) / (b.range_m * rho);
      const double cosine = std::max(std::sqrt(std::max(1 - beside * beside, 0.0)), kLeastCosine);
      const double sine2 = 1 - cosine * cosine;
      const double bow = sine2 * sigma2 / (2 * rho);
      const double variance =
          sigma2 * cosine * cosine + config_.surface_sigma_m * config_.surface_sigma_m + 2 * bow * bow;
      const double dx = b.x_m - at.x_m, dy = b.y_m - at.y_m, d = std::max(std::hypot(dx, dy), 1e-9);
      add(d - at.radius_m - bow, {-dx / d, -dy / d, -1}, 1 / variance);
    }
    const double d = std::max(std::hypot(at.x_m, at.y_m), 1e-6);
    const double ratio = std::min(at.radius_m / d, 0.999), root = std::sqrt(1 - ratio * ratio);
    const Eigen::Vector3d bearing(-at.y_m / (d * d), at.x_m / (d * d), 0);
    const Eigen::Vector3d width(-ratio * at.x_m / (d * d * root), -ratio * at.y_m / (d * d * root),
                                1 / (d * root));
    const double phi = std::atan2(at.y_m, at.x_m), asine = std::asin(ratio);
    if (left.seen) add(wrapped_rad(phi + asine - left.bearing_rad), bearing + width, 1 / edge_variance);
    if (right.seen) add(wrapped_rad(phi - asine - right.bearing_rad), bearing - width, 1 / edge_variance);
    return sum;
  };

  double damping = 1e-4;
  double cost = evaluate(c, c);
  for (int k = 0; k < 25; ++k) {
    Eigen::Matrix3d A = N;
    A.diagonal() *= 1 + damping;
    const Eigen::Vector3d step = A.inverse() * -g;
    if (!step.allFinite()) break;
    const Circle next{c.x_m + step.x(), c.y_m + step.y(), c.radius_m + step.z()};
    const bool possible = next.radius_m > 0.005 && std::hypot(next.x_m, next.y_m) > next.radius_m;
    if (possible && evaluate(next, c) <= cost) {
      c = next;
      damping = std::max(damping / 10, 1e-9);
      if (step.norm() < 1e-6) break;
    } else {
      damping = std::max(damping, 1e-6) * 10;
      if (damping > 1e6) break;
    }
    cost = evaluate(c, c);  // with its own weights
  }
  cost = evaluate(c, c);
  const Eigen::Matrix3d P = N.inverse();
  const double radius_sigma = std::sqrt(P(2, 2));
  if (!(radius_sigma < config_.max_radius_sigma_m) || !P.allFinite() || !(P(0, 0) > 0) || !(P(1, 1) > 0))
    return ++counters_.undetermined, false;
  if (2 * c.radius_m < config_.min_diameter_m || 2 * c.radius_m > config_.max_diameter_m ||
      std::hypot(c.x_m, c.y_m) < nearest)
    return ++counters_.too_wide, false;
  const std::size_t degrees = n + (left.seen ? 1 : 0) + (right.seen ? 1 : 0) - 3;
  if (degrees > 0 && cost > config_.misfit * chi_squared_999(static_cast<double>(degrees)))
    return ++counters_.misfit, false;

  out = {};
  out.x_m = c.x_m, out.y_m = c.y_m, out.radius_m = c.radius_m;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out.covariance[i][j] = P(i, j);
  out.points = static_cast<std::uint32_t>(n);
  out.hidden_left = !left.seen;
  out.hidden_right = !right.seen;
  out.chi_squared = cost;
  out.degrees_of_freedom = static_cast<std::uint32_t>(degrees);
  return true;
}

void StemDetector::keep(const StemObservation& stem) noexcept {
  if (stem_count_ < kMaxStems) {
    stems_[stem_count_++] = stem;
    return;
  }
  // The farthest gives way; the order by bearing stays.
  const auto farther = [](const StemObservation& a, const StemObservation& b) {
    return std::hypot(a.x_m, a.y_m) < std::hypot(b.x_m, b.y_m);
  };
  const auto worst = std::max_element(stems_.begin(), stems_.end(), farther);
  ++counters_.left_out;
  if (!farther(stem, *worst)) return;
  std::move(worst + 1, stems_.end(), worst);
  stems_.back() = stem;
}

std::span<const StemObservation> StemDetector::detect(std::span<const LidarPoint> scan,
                                                      const ScanMotion& motion) noexcept {
  ++counters_.scans;
  stem_count_ = 0;
  const std::size_t count = take(scan);
  for (std::size_t first = 0, end = 0; first < count; first = end) {
    end = first + 1;
    while (end < count && connected(beams_[end - 1], beams_[end])) ++end;
    const std::size_t n = end - first;
    const Beam& a = beams_[first];
    const Beam& b = beams_[end - 1];
    if (std::min(a.range_m, b.range_m) > config_.max_range_m) continue;
    ++counters_.segments;
    if (n < config_.min_points) {
      ++counters_.too_few;
      continue;
    }
    if (std::hypot(a.x_m - b.x_m, a.y_m - b.y_m) > config_.max_diameter_m + 4 * config_.range_sigma_m) {
      ++counters_.too_wide;
      continue;
    }
    StemObservation stem;
    if (!fit(first, end, count, stem)) continue;
    // All beams of one stem are fired within a millisecond or so: it is moved as a whole.
    const double dt_s = (0.5 * a.t_offset_ns + 0.5 * b.t_offset_ns) * 1e-9;
    keep(moved(stem, {motion.forward_mps * dt_s, motion.left_mps * dt_s, motion.turn_radps * dt_s}));
    ++counters_.stems;
  }
  return {stems_.data(), stem_count_};
}

}  // namespace rigor::forest

#include "calibration/lidar/plane_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <random>

namespace rigor::calibration {
namespace {

constexpr double kCell_rad = 2 * std::numbers::pi / 180;
constexpr std::size_t kMostSearched = 40'000;
constexpr int kTries = 600;

struct Spot {
  Eigen::Vector3d p;
  float azimuth_rad;
  std::uint16_t beam;
  std::uint32_t index;
};

/// Cells of 2 degrees of one beam: a wall fills them, what a plane only cuts through does not.
class Cells {
 public:
  explicit Cells(std::size_t beams)
      : per_beam_(static_cast<std::size_t>(2 * std::numbers::pi / kCell_rad) + 2),
        count_(per_beam_ * beams, {0, 0}) {}
  [[nodiscard]] std::size_t at(const LidarReturn& r) const {
    const auto k =
        static_cast<std::size_t>((static_cast<double>(r.azimuth_rad) + std::numbers::pi) / kCell_rad);
    return r.beam * per_beam_ + std::min(k, per_beam_ - 1);
  }
  void clear() { std::fill(count_.begin(), count_.end(), std::array<std::uint32_t, 2>{0, 0}); }
  void add(std::size_t cell, bool in) { ++count_[cell][0], count_[cell][1] += in; }
  [[nodiscard]] bool filled(std::size_t cell) const { return 2 * count_[cell][1] >= count_[cell][0]; }

 private:
  std::size_t per_beam_;
  std::vector<std::array<std::uint32_t, 2>> count_;
};

/// Plane through points by least squares of q·p = 1 in the distance's own measure; `flat`: q_z held at 0.
bool fit_plane(const std::vector<Eigen::Vector3d>& points, bool flat, Eigen::Vector3d& q) {
  if (points.size() < 3) return false;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& p : points) mean += p;
  mean /= static_cast<double>(points.size());
  Eigen::Matrix3d c = Eigen::Matrix3d::Zero();
  for (const auto& p : points) c += (p - mean) * (p - mean).transpose();
  Eigen::Vector3d n;
  if (flat) {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> e(Eigen::Matrix2d(c.topLeftCorner<2, 2>()));
    n << e.eigenvectors().col(0), 0;
  } else {
    n = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(c).eigenvectors().col(0);
  }
  const double d = n.dot(mean);
  // Seen from within itself a plane has no range.
  if (std::abs(d) < 1e-3 * mean.norm()) return false;
  q = n / d;
  return true;
}

}  // namespace

void beam_of(const models::LidarBeam& beam, double azimuth_rad, Eigen::Vector3d& direction,
             Eigen::Vector3d& origin_m) {
  const models::LidarAim aim = models::rotor_aim(beam, azimuth_rad);
  direction = {aim.direction[0], aim.direction[1], aim.direction[2]};
  origin_m = {aim.origin_m[0], aim.origin_m[1], aim.origin_m[2]};
}

bool scans_one_plane(const models::LidarScan& scan) {
  return std::all_of(scan.beams.begin(), scan.beams.end(), [&](const models::LidarBeam& b) {
    return b.elevation_rad == 0 && b.vertical_offset_m == scan.beams.front().vertical_offset_m;
  });
}

PlaneSearch find_planes(const LidarReturns& returns, const models::LidarScan& scan,
                        const PlaneSearchOptions& options) {
  PlaneSearch out;
  const std::size_t n = returns.all.size();
  out.label.assign(n, -1);
  if (n < 10) return out;
  const bool flat = scans_one_plane(scan);
  std::mt19937_64 random(options.seed);

  std::vector<Spot> spots;
  const std::size_t stride = std::max<std::size_t>(1, n / kMostSearched);
  std::vector<float> ranges;
  for (std::size_t i = 0; i < n; i += 1 + (stride > 1 ? random() % (2 * stride - 1) : 0)) {
    const LidarReturn& r = returns.all[i];
    Eigen::Vector3d u, o;
    beam_of(scan.beams[r.beam], r.azimuth_rad, u, o);
    spots.push_back(
        {o + static_cast<double>(r.range_m) * u, r.azimuth_rad, r.beam, static_cast<std::uint32_t>(i)});
    ranges.push_back(r.range_m);
  }
  std::nth_element(ranges.begin(), ranges.begin() + static_cast<std::ptrdiff_t>(ranges.size() / 2),
                   ranges.end());
  const double tolerance = out.tolerance_m =
      options.tolerance * static_cast<double>(ranges[ranges.size() / 2]);
  std::sort(spots.begin(), spots.end(), [](const Spot& a, const Spot& b) {
    return a.azimuth_rad != b.azimuth_rad ? a.azimuth_rad < b.azimuth_rad : a.index < b.index;
  });
  Cells cells(scan.beams.size());
  std::vector<char> free(spots.size(), 1);
  const auto least = std::max<std::size_t>(
      20, static_cast<std::size_t>(options.minimum_share * static_cast<double>(spots.size())));

  while (static_cast<int>(out.planes.size()) < options.most_planes) {
    std::vector<std::size_t> left;
    for (std::size_t i = 0; i < spots.size(); ++i)
      if (free[i]) left.push_back(i);
    if (left.size() < least) break;
    // A share of what is left is enough to rank hypotheses.
    std::vector<Spot> judges;
    const std::size_t every = std::max<std::size_t>(1, left.size() / 4000);
    for (std::size_t i = 0; i < left.size(); i += every) judges.push_back(spots[left[i]]);
    Eigen::Vector3d best;
    std::size_t most = 0;
    // Neighbours: within a window in the order of azimuth that is from 1/40 to 1/4 of all.
    for (int t = 0; t < kTries; ++t) {
      const std::size_t window = std::max<std::size_t>(8, left.size() / (t % 3 == 0   ? 4u
                                                                         : t % 3 == 1 ? 12u
                                                                                      : 40u));
      const std::size_t i0 = random() % left.size();
      const auto near = [&] { return (i0 + left.size() + random() % window - window / 2) % left.size(); };
      const Spot &a = spots[left[i0]], &b = spots[left[near()]], &c = spots[left[near()]];
      Eigen::Vector3d normal;
      if (flat)
        normal = (b.p - a.p).cross(Eigen::Vector3d::UnitZ());
      else
        normal = (b.p - a.p).cross(c.p - a.p);
      if (!(normal.norm() > 0)) continue;
      normal.normalize();
      const double d = normal.dot(a.p);
      if (std::abs(d) < 2 * tolerance) continue;
      std::size_t count = 0;
      for (const Spot& s : judges) count += std::abs(normal.dot(s.p) - d) < tolerance;
      if (count > most) most = count, best = normal / d;
    }
    if (most * every < least / 2) break;
    // Refined on the cells that it fills; twice, for what it is turned by.
    std::vector<std::size_t> members;
    bool good = true;
    for (int round = 0; round < 4 && good; ++round) {
      cells.clear();
      const double scale = 1 / best.norm();
      const auto inside = [&](const Spot& s) { return std::abs(best.dot(s.p) - 1) * scale < tolerance; };
      for (const Spot& s : spots) cells.add(cells.at(returns.all[s.index]), inside(s));
      members.clear();
      std::vector<Eigen::Vector3d> points;
      for (const std::size_t i : left)
        if (inside(spots[i]) && cells.filled(cells.at(returns.all[spots[i].index]))) {
          members.push_back(i);
          points.push_back(spots[i].p);
        }
      good = members.size() >= least && fit_plane(points, flat, best);
    }
    if (!good) {
      // Not a wall: its seeds are not tried again.
      if (members.empty()) break;
      for (const std::size_t i : members) free[i] = 0;
      continue;
    }
    for (const std::size_t i : members) free[i] = 0;
    LidarPlane plane;
    plane.q_per_m = best;
    out.planes.push_back(plane);
  }
  if (out.planes.empty()) return out;

  // All returns by the planes, cell by cell.
  auto found = assign_planes(returns, scan, out.planes, tolerance);
  // What is strewn evenly over the tolerance (median half of it) is no wall but what a plane cuts through.
  std::vector<LidarPlane> walls;
  for (std::size_t k = 0; k < found.planes.size(); ++k) {
    std::vector<double> off;
    const Eigen::Vector3d& q = found.planes[k].q_per_m;
    for (std::size_t i = 0; i < n; ++i) {
      if (found.label[i] != static_cast<std::int8_t>(k)) continue;
      Eigen::Vector3d u, o;
      beam_of(scan.beams[returns.all[i].beam], returns.all[i].azimuth_rad, u, o);
      off.push_back(std::abs(q.dot(o + static_cast<double>(returns.all[i].range_m) * u) - 1) / q.norm());
    }
    if (off.size() < 20) continue;
    const auto middle = off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2);
    std::nth_element(off.begin(), middle, off.end());
    if (*middle < 0.4 * tolerance) walls.push_back(found.planes[k]);
  }
  if (walls.size() != found.planes.size()) {
    out.planes = walls;
    if (walls.empty()) return out;
    found = assign_planes(returns, scan, walls, tolerance);
  }
  out.label = found.label;
  std::vector<std::size_t> order(out.planes.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return found.planes[a].returns > found.planes[b].returns;
  });
  std::vector<std::int8_t> place(order.size());
  std::vector<LidarPlane> sorted;
  for (std::size_t k = 0; k < order.size(); ++k) {
    place[order[k]] = static_cast<std::int8_t>(k);
    sorted.push_back(found.planes[order[k]]);
    sorted.back().name = "wall " + std::to_string(k);
  }
  for (auto& l : out.label)
    if (l >= 0) l = place[static_cast<std::size_t>(l)];
  out.planes = sorted;
  return out;
}

PlaneSearch assign_planes(const LidarReturns& returns, const models::LidarScan& scan,
                          const std::vector<LidarPlane>& planes, double tolerance_m) {
  PlaneSearch out;
  out.planes = planes;
  out.tolerance_m = tolerance_m;
  out.label.assign(returns.all.size(), -1);
  std::vector<double> scale;
  for (LidarPlane& p : out.planes) scale.push_back(1 / p.q_per_m.norm()), p.returns = 0;
  for (std::size_t i = 0; i < returns.all.size(); ++i) {
    const LidarReturn& r = returns.all[i];
    Eigen::Vector3d u, o;
    beam_of(scan.beams[r.beam], r.azimuth_rad, u, o);
    const Eigen::Vector3d p = o + static_cast<double>(r.range_m) * u;
    for (std::size_t k = 0; k < planes.size(); ++k) {
      // Seen from the side at less than 8 degrees a wall is where its own unevenness says.
      const double across = planes[k].q_per_m.dot(u) * scale[k];
      if (std::abs(planes[k].q_per_m.dot(p) - 1) * scale[k] >= tolerance_m || std::abs(across) < 0.14)
        continue;
      out.label[i] = out.label[i] == -1 ? static_cast<std::int8_t>(k) : std::int8_t{-2};
    }
    if (out.label[i] < 0) continue;
    // Whether another wall is near is judged by where the beam meets this one, not by what was measured: near
    // an edge the returns that noise took away from it would be kept and the others not.
    const Eigen::Vector3d& q = planes[static_cast<std::size_t>(out.label[i])].q_per_m;
    const Eigen::Vector3d met = o + (1 - q.dot(o)) / q.dot(u) * u;
    for (std::size_t k = 0; k < planes.size(); ++k)
      if (static_cast<std::int8_t>(k) != out.label[i] &&
          std::abs(planes[k].q_per_m.dot(met) - 1) * scale[k] < tolerance_m) {
        out.label[i] = -2;
        break;
      }
  }
  for (std::size_t k = 0; k < planes.size(); ++k) {
    Cells cells(scan.beams.size());
    for (std::size_t i = 0; i < returns.all.size(); ++i)
      cells.add(cells.at(returns.all[i]), out.label[i] == static_cast<std::int8_t>(k) || out.label[i] == -2);
    for (std::size_t i = 0; i < returns.all.size(); ++i)
      if (out.label[i] == static_cast<std::int8_t>(k)) {
        if (cells.filled(cells.at(returns.all[i])))
          ++out.planes[k].returns;
        else
          out.label[i] = -1;
      }
  }
  for (auto& l : out.label)
    if (l == -2) l = -1;  // where two walls meet, a return is of neither
  return out;
}

}  // namespace rigor::calibration

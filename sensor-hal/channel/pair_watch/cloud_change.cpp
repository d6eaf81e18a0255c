#include "sensor-hal/channel/pair_watch/cloud_change.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

namespace rigor::pair_watch {
namespace {

constexpr std::size_t kMostBeams = 16;
constexpr std::size_t kMostNeighbours = 4;
constexpr double kLeastCosine = 0.25;
/// Points of three rings that are farther off a straight line are not of one surface, in standard deviations
/// of a range: a floor and the wall beside it, taken for one surface, tilt its normal alike on both sides,
/// which no scatter tells of.
constexpr double kOffLine = 4;

LidarPoint point(const Sample& s, std::size_t i) noexcept {
  LidarPoint p;
  std::memcpy(&p, s.bytes().data() + i * sizeof p, sizeof p);
  return p;
}

/// Of the firing: what the two sides share.
bool before(const LidarPoint& a, const LidarPoint& b) noexcept { return a.t_offset_ns < b.t_offset_ns; }

bool has_range(const LidarPoint& p) noexcept {
  const double range = std::hypot(p.x_m, p.y_m, p.z_m);
  return std::isfinite(range) && range > 0;
}

void cross(const double (&a)[3], const double (&b)[3], double (&c)[3]) noexcept {
  c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

}  // namespace

Result<CloudChange> CloudChange::make(const CloudChangeOptions& o) {
  if (o.points < 16 || o.points > 4000000)
    return fail(ErrorCode::bad_input, "points", "expected 16 to 4000000, got " + std::to_string(o.points));
  if (o.rows < 64)
    return fail(ErrorCode::bad_input, "rows", "expected 64 or more, got " + std::to_string(o.rows));
  if (o.rings < 1 || o.rings > 1024)
    return fail(ErrorCode::bad_input, "rings", "expected 1 to 1024, got " + std::to_string(o.rings));
  if (!(o.sigma_m > 0) || !(o.remission_max > 0) || !(o.edge_m > 0))
    return fail(ErrorCode::bad_input, "cloud",
                "expected sigma_m, remission_max and edge_m above 0, got " + std::to_string(o.sigma_m) +
                    ", " + std::to_string(o.remission_max) + ", " + std::to_string(o.edge_m));
  return CloudChange(o);
}

/// How far a point is from the straight line through two others.
double CloudChange::off_line_m(const Point& a, const Point& p, const Point& b) noexcept {
  double line[3], to[3], area[3];
  for (std::size_t k = 0; k < 3; ++k) {
    line[k] = b.d[k] * b.range - a.d[k] * a.range;
    to[k] = p.d[k] * p.range - a.d[k] * a.range;
  }
  cross(line, to, area);
  return std::hypot(area[0], area[1], area[2]) / std::hypot(line[0], line[1], line[2]);
}

CloudChange::CloudChange(const CloudChangeOptions& o) : options_(o), remission_(1) {
  const bool plane = o.rings == 1;
  term_of_.assign(8, kMaxParameters);
  const auto name = [&](std::size_t k, const char* text, const char* unit) {
    term_of_[k] = parameters_.size();
    parameters_.push_back({text, unit, 0});
  };
  name(0, "range bias", "m");
  name(1, "range scale", "1");
  if (!plane) name(2, "mount x", "rad"), name(3, "mount y", "rad");
  name(4, "mount z", "rad");
  name(5, "mount move x", "m"), name(6, "mount move y", "m");
  if (!plane) name(7, "mount move z", "m");
  beams_ = std::min<std::size_t>(o.rings, kMostBeams);
  first_beam_ = parameters_.size();
  if (beams_ > 1)
    for (std::size_t k = 0; k < beams_; ++k) {
      const std::size_t from = (k * o.rings + beams_ - 1) / beams_,
                        to = ((k + 1) * o.rings + beams_ - 1) / beams_ - 1;
      parameters_.push_back(
          {"beam " + std::to_string(from) + (to > from ? "-" + std::to_string(to) : ""), "m", 0, 0});
    }
  rest_ = parameters_.size();
  for (const char* text : {"remission", "noise", "noise low remission", "noise middle remission",
                           "noise high remission", "lost", "gained"})
    parameters_.push_back({text, "1", 0});
  fit_ = RobustFit(rest_, {first_beam_, rest_ - first_beam_}, o.points);
  points_.reserve(o.points);
  rows_.reserve(o.points);
  ring_begin_.resize(o.rings + 1);
  ring_order_.resize(o.rings);
  ring_place_.resize(o.rings);
}

bool CloudChange::add(const Sample& real, const Sample& simulated) noexcept {
  const auto *a = real.as<PointCloudInfo>(), *b = simulated.as<PointCloudInfo>();
  if (!a || !b || ((real.stamp.validity | simulated.stamp.validity) & (kIncomplete | kCorrupt)) != 0)
    return false;
  if (real.size_bytes != a->count * sizeof(LidarPoint) ||
      simulated.size_bytes != b->count * sizeof(LidarPoint))
    return false;
  match(real, simulated);
  for (std::size_t r = 0; r < options_.rings; ++r) take_noise(ring_begin_[r], ring_begin_[r + 1]);
  regress();
  return true;
}

/// Simulated points with what the real side measured in the same firing; both in the order of firing.
void CloudChange::match(const Sample& real, const Sample& simulated) noexcept {
  const std::size_t n = std::min<std::size_t>(simulated.as<PointCloudInfo>()->count, options_.points);
  const std::size_t m = real.as<PointCloudInfo>()->count;
  const std::size_t rings = options_.rings;
  // By ring: counted, then placed.
  std::fill(ring_begin_.begin(), ring_begin_.end(), std::size_t{0});
  const auto counts = [&](const LidarPoint& p) {
    return p.ring < rings && p.return_index == 0 && has_range(p);
  };
  for (std::size_t i = 0; i < n; ++i)
    if (const LidarPoint p = point(simulated, i); counts(p)) ++ring_begin_[p.ring + std::size_t{1}];
  for (std::size_t r = 0; r < rings; ++r) ring_begin_[r + 1] += ring_begin_[r];
  points_.resize(ring_begin_[rings]);
  std::size_t first = 0;
  double matched = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const LidarPoint p = point(simulated, i);
    if (!counts(p)) continue;
    Point& q = points_[ring_begin_[p.ring]++];
    q.range = std::hypot(double{p.x_m}, double{p.y_m}, double{p.z_m});
    q.d[0] = p.x_m / q.range, q.d[1] = p.y_m / q.range, q.d[2] = p.z_m / q.range;
    q.azimuth_rad = std::atan2(q.d[1], q.d[0]);
    q.remission = p.remission;
    q.t_ns = p.t_offset_ns, q.ring = p.ring;
    q.residual = q.remission_residual = kNaN;
    while (first < m && before(point(real, first), p)) ++first;
    for (std::size_t k = first; k < m; ++k) {
      const LidarPoint r = point(real, k);
      if (r.t_offset_ns != p.t_offset_ns) break;
      if (r.ring != p.ring || r.return_index != p.return_index || !has_range(r)) continue;
      q.residual = std::hypot(double{r.x_m}, double{r.y_m}, double{r.z_m}) - q.range;
      q.remission_residual = double{r.remission} - q.remission;
      ++matched;
      break;
    }
  }
  for (std::size_t r = rings; r > 0; --r) ring_begin_[r] = ring_begin_[r - 1];
  ring_begin_[0] = 0;
  double answered = 0;
  for (std::size_t k = 0; k < m; ++k) answered += counts(point(real, k)) ? 1 : 0;
  both_ += matched;
  lost_ += static_cast<double>(points_.size()) - matched;
  gained_ += std::max(0.0, answered - matched);

  // Rings by elevation, from their first points. Rings without any keep their place at the end.
  for (std::size_t r = 0; r < rings; ++r) ring_order_[r] = static_cast<std::uint32_t>(r);
  const auto height = [&](std::uint32_t r) {
    return ring_begin_[r] < ring_begin_[r + 1] ? points_[ring_begin_[r]].d[2] : 2.0;
  };
  std::sort(ring_order_.begin(), ring_order_.end(), [&](std::uint32_t x, std::uint32_t y) {
    return height(x) != height(y) ? height(x) < height(y) : x < y;
  });
  for (std::size_t k = 0; k < rings; ++k) ring_place_[ring_order_[k]] = static_cast<std::uint32_t>(k);
}

/// Of another ring the point that was fired next to this one's firing and lies closest in azimuth.
const CloudChange::Point* CloudChange::beside(const Point& p, std::size_t ring) const noexcept {
  const auto begin = points_.begin() + static_cast<std::ptrdiff_t>(ring_begin_[ring]);
  const auto end = points_.begin() + static_cast<std::ptrdiff_t>(ring_begin_[ring + 1]);
  auto at = std::lower_bound(begin, end, p.t_ns, [](const Point& q, std::int32_t t) { return q.t_ns < t; });
  const Point* best = nullptr;
  double closest = 0.02;  // rad
  for (int k = -2; k <= 2; ++k) {
    if (at - begin + k < 0 || at - begin + k >= end - begin) continue;
    const Point& q = *(at + k);
    const double d = std::abs(std::remainder(q.azimuth_rad - p.azimuth_rad, 6.283185307179586));
    if (d < closest) closest = d, best = &q;
  }
  return best;
}

bool CloudChange::normal_at(std::size_t i, double (&n)[3]) const noexcept {
  const Point& p = points_[i];
  if (i == ring_begin_[p.ring] || i + 1 >= ring_begin_[p.ring + std::size_t{1}]) return false;
  const auto tangent = [&](const Point& a, const Point& b, double(&t)[3]) {
    double across = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      t[k] = b.d[k] * b.range - a.d[k] * a.range;
      across += (b.d[k] - a.d[k]) * (b.d[k] - a.d[k]);
    }
    const double apart = std::sqrt(across) * p.range;
    // Gaps, and steps in range that are more than the surface's own slope.
    return apart > 0 && std::sqrt(across) < 0.2 &&
           std::abs(a.range + b.range - 2 * p.range) < options_.edge_m * apart + 5 * options_.sigma_m;
  };
  // Over as many neighbours as it takes for their noise not to tilt the normal by much: a tilt that is noise
  // makes estimates of turns too small.
  const std::size_t begin = ring_begin_[p.ring], end = ring_begin_[p.ring + std::size_t{1}];
  double along[3], other[3];
  bool any = false;
  for (std::size_t m = 1; m <= kMostNeighbours && i >= begin + m && i + m < end; ++m) {
    double wider[3];
    if (!tangent(points_[i - m], points_[i + m], wider)) break;
    std::copy(wider, wider + 3, along);
    any = true;
    if (std::hypot(along[0], along[1], along[2]) > 40 * options_.sigma_m) break;
  }
  if (!any) return false;
  if (options_.rings == 1) {
    const double up[3] = {0, 0, 1};
    cross(along, up, n);
  } else {
    const std::size_t place = ring_place_[p.ring];
    const Point *below = &p, *above = &p;
    const auto ring = [&](std::ptrdiff_t step) -> const Point* {
      const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(place) + step;
      return at < 0 || at >= static_cast<std::ptrdiff_t>(options_.rings)
                 ? nullptr
                 : beside(p, ring_order_[static_cast<std::size_t>(at)]);
    };
    // Three rings in a line. At the lowest and the highest ring, which have neighbours to one side alone, the
    // next but one is the third.
    const auto one_surface = [&](const Point& l, const Point& u) {
      const double most = kOffLine * options_.sigma_m;
      if (&l != &p && &u != &p) return off_line_m(l, p, u) <= most;
      const bool up = &l == &p;
      const Point *middle = up ? above : below, *last = up ? &u : &l;
      if (middle == &p) middle = last, last = ring(up ? 2 : -2);
      return last ? off_line_m(p, *middle, *last) <= most : options_.rings < 3;
    };
    for (std::size_t m = 1; m <= kMostNeighbours; ++m) {
      const Point *lower = ring(-static_cast<std::ptrdiff_t>(m)),
                  *upper = ring(static_cast<std::ptrdiff_t>(m));
      const Point &l = lower ? *lower : *below, &u = upper ? *upper : *above;
      if (&l == &u) continue;
      double across = 0;
      for (std::size_t k = 0; k < 3; ++k) across += (u.d[k] - l.d[k]) * (u.d[k] - l.d[k]);
      // A step between rings is steeper than kLeastCosine lets a surface be.
      if (std::abs(u.range - l.range) > std::sqrt(across) * p.range / kLeastCosine) break;
      if (!one_surface(l, u)) break;
      below = &l, above = &u;
      if (std::sqrt(across) * p.range > 40 * options_.sigma_m) break;
    }
    if (below == above) return false;
    for (std::size_t k = 0; k < 3; ++k) other[k] = above->d[k] * above->range - below->d[k] * below->range;
    cross(along, other, n);
  }
  const double length = std::hypot(n[0], n[1], n[2]);
  if (!(length > 0)) return false;
  for (double& x : n) x /= length;
  return std::abs(n[0] * p.d[0] + n[1] * p.d[1] + n[2] * p.d[2]) > kLeastCosine;
}

void CloudChange::take_noise(std::size_t begin, std::size_t end) noexcept {
  // Three at a time, so that no residual counts twice.
  for (std::size_t i = begin; i + 2 < end; i += 3) {
    const Point &a = points_[i], &b = points_[i + 1], &c = points_[i + 2];
    const double second = a.residual - 2 * b.residual + c.residual;
    if (!std::isfinite(second)) continue;
    const double level = b.remission / options_.remission_max;
    noise_sums_.add(second * second / (6 * options_.sigma_m * options_.sigma_m), level < 1.0 / 3   ? 0
                                                                                 : level < 2.0 / 3 ? 1
                                                                                                   : 2);
  }
}

void CloudChange::regress() noexcept {
  rows_.clear();
  const std::size_t every = (points_.size() + options_.rows - 1) / options_.rows;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const Point& p = points_[i];
    if (std::isfinite(p.remission_residual)) {
      const WindowFit::Term t{0, p.remission};
      remission_.add({&t, 1}, p.remission_residual, 1);
    }
    double n[3];
    if (i % every != 0 || !std::isfinite(p.residual) || !normal_at(i, n)) continue;
    const double cosine = n[0] * p.d[0] + n[1] * p.d[1] + n[2] * p.d[2];
    double lever[3];
    cross(p.d, n, lever);
    Row row;
    // The point's own noise is in the residual, too.
    const double range = (points_[i - 1].range + points_[i + 1].range) / 2;
    row.derivative[0] = 1, row.derivative[1] = range;
    for (std::size_t k = 0; k < 3; ++k)
      row.derivative[2 + k] = -range * lever[k] / cosine, row.derivative[5 + k] = -n[k] / cosine;
    row.residual = p.residual;
    row.base_weight = row.weight = 1 / (2 * options_.sigma_m * options_.sigma_m);
    row.beam = static_cast<std::uint32_t>(p.ring * beams_ / options_.rings);
    row.direction = {p.d[0], p.d[1], p.d[2]}, row.normal = {n[0], n[1], n[2]};
    row.range = p.range, row.t_ns = p.t_ns, row.ring = p.ring;
    rows_.push_back(row);
  }
  if (rows_.size() < 16) return;
  fit_.add(std::span(rows_), [this](const Row& r, RobustFit::Terms& terms) {
    std::size_t n = 0;
    for (std::size_t k = 0; k < 8; ++k)
      if (term_of_[k] < rest_) terms[n++] = {term_of_[k], r.derivative[k]};
    if (beams_ > 1) terms[n++] = {first_beam_ + r.beam, 1};
    return n;
  });
}

void CloudChange::finish(Estimate& e) noexcept {
  e.value.fill(kNaN), e.sigma.fill(kNaN);
  fit_.finish(e);
  if (remission_.count() >= 16) {
    remission_.solve();
    e.value[rest_] = remission_.value(0), e.sigma[rest_] = remission_.sigma(0);
  }
  noise_sums_.finish(e, rest_ + 1);
  if (const double all = both_ + lost_ + gained_; all > 0) {
    e.value[rest_ + 5] = lost_ / all, e.value[rest_ + 6] = gained_ / all;
    const auto share = [&](double x) { return std::sqrt((x + 1) / all / all); };
    e.sigma[rest_ + 5] = share(lost_), e.sigma[rest_ + 6] = share(gained_);
  }
  e.shift_px = kNaN;
  remission_.clear();
  both_ = lost_ = gained_ = 0;
}

}  // namespace rigor::pair_watch

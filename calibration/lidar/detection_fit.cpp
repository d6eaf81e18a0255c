#include "calibration/lidar/detection_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace rigor::calibration {

std::optional<DetectionEdge> detection_edge(std::vector<double> values, double blur, double step) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  if (values.size() < 200) return std::nullopt;
  const auto at_share = [&](std::size_t part) {
    const auto i = values.begin() + static_cast<std::ptrdiff_t>(values.size() / part);
    std::nth_element(values.begin(), i, values.end());
    return *i;
  };
  // The few that lie lowest may be anything; the window begins there and is as wide as some blurs, or as the
  // lowest two hundredths of the values need.
  const double low = at_share(2000), span = at_share(50) - low;
  const double width = std::max({step, 0.5 * blur, span / 40, 1e-12 * std::abs(low)});
  const double begin = low - 4 * std::max(blur, width);
  constexpr int kBins = 48;
  std::array<double, kBins> count{};
  double total = 0;
  for (const double v : values) {
    const double at = (v - begin) / width;
    if (at < 0 || at >= kBins) continue;
    ++count[static_cast<std::size_t>(at)], ++total;
  }
  if (total < 50) return std::nullopt;
  const double s = std::sqrt(blur * blur + width * width / 12);
  const auto centre = [&](int j) { return begin + (j + 0.5) * width; };
  const auto likelihood = [&](const auto& shape) {
    std::array<double, kBins> mu;
    double sum = 0, l = 0;
    for (int j = 0; j < kBins; ++j) sum += mu[static_cast<std::size_t>(j)] = shape(centre(j));
    if (!(sum > 0)) return -1e300;
    for (std::size_t j = 0; j < kBins; ++j) {
      const double expected = std::max(1e-9, mu[j] * total / sum);
      l += count[j] * std::log(expected) - expected;
    }
    return l;
  };
  const auto edge = [&](double t, double slope) {
    return likelihood([&](double x) {
      return 0.5 * std::erfc(-(x - t) / s / std::numbers::sqrt2) *
             std::max(0.05, 1 + slope * (x - t) / (kBins * width));
    });
  };
  // A grid finer than the blur; the share of the blurred step is the same for all slopes.
  double best = -1e300, at = low, tilt = 0;
  constexpr int kPlaces = 150;
  for (int i = 0; i <= kPlaces; ++i) {
    const double t = begin + width * (kBins * 0.6) * i / kPlaces;
    std::array<double, kBins> share;
    for (int j = 0; j < kBins; ++j)
      share[static_cast<std::size_t>(j)] = 0.5 * std::erfc(-(centre(j) - t) / s / std::numbers::sqrt2);
    for (const double slope : {-0.9, -0.5, 0.0, 1.0, 3.0}) {
      const double l = likelihood([&](double x) {
        const auto j = static_cast<std::size_t>((x - begin) / width);
        return share[j] * std::max(0.05, 1 + slope * (x - t) / (kBins * width));
      });
      if (l > best) best = l, at = t, tilt = slope;
    }
  }
  const double h = 0.15 * s;
  for (int n = 0; n < 20; ++n) {
    const double left = edge(at - h, tilt), mid = edge(at, tilt), right = edge(at + h, tilt);
    const double curvature = left - 2 * mid + right;
    if (!(curvature < 0)) break;
    const double d = std::clamp(0.5 * h * (left - right) / curvature, -s, s);
    at += d;
    if (std::abs(d) < 1e-6 * s) break;
  }
  const double curvature = (edge(at - h, tilt) - 2 * edge(at, tilt) + edge(at + h, tilt)) / (h * h);
  // Without a threshold the values run out: a ramp, or a bell's foot.
  double smooth = -1e300;
  for (int i = 0; i <= 60; ++i) {
    const double x0 = begin - 10 * width + width * (kBins * 0.6 + 10) * i / 60;
    for (const double power : {1.0, 2.0, 3.0})
      smooth = std::max(smooth,
                        likelihood([&](double x) { return x > x0 ? std::pow((x - x0) / width, power) : 0; }));
  }
  DetectionEdge e;
  e.sharp = best > smooth + 6 && curvature < 0;
  e.gain = best - smooth;
  e.at = e.sharp ? at : low;
  e.sigma = e.sharp ? 1 / std::sqrt(-curvature) : 0;
  return e;
}

namespace {

/// What one kind of edge is looked for among.
class Sides {
 public:
  Sides(const std::vector<double>& remission, const std::vector<double>& range_m, double relative,
        double unit, double limit_range_m, double overlap_m)
      : e_(remission),
        r_(range_m),
        relative_(relative),
        unit_(unit),
        limit_range_m_(limit_range_m),
        overlap_m_(overlap_m) {}

  /// The floor, by returns nearer than `to_m`.
  [[nodiscard]] std::optional<DetectionEdge> floor(double to_m) const {
    std::vector<double> v, r;
    for (std::size_t i = 0; i < e_.size(); ++i)
      if (r_[i] < to_m) v.push_back(e_[i]), r.push_back(r_[i]);
    return edge(v, r, 1);
  }
  /// The limit, by returns from `from_m` on.
  [[nodiscard]] std::optional<DetectionEdge> limit(double from_m) const {
    std::vector<double> v, r;
    double mean = 0;
    for (std::size_t i = 0; i < e_.size(); ++i)
      if (r_[i] >= from_m) {
        const double k = limit_range_m_ / std::max(r_[i], overlap_m_);
        v.push_back(e_[i] * k * k), r.push_back(r_[i]), mean += k * k;
      }
    return edge(v, r, mean / std::max<double>(1, static_cast<double>(v.size())));
  }

 private:
  /// `unit`: of what the device tells, in these values.
  [[nodiscard]] std::optional<DetectionEdge> edge(const std::vector<double>& v, const std::vector<double>& r,
                                                  double unit) const {
    if (v.size() < 200) return std::nullopt;
    unit *= unit_;
    std::vector<double> low = v;
    const auto at = low.begin() + static_cast<std::ptrdiff_t>(low.size() / 2000);
    std::nth_element(low.begin(), at, low.end());
    auto e = detection_edge(v, relative_ * std::max(*at, unit), unit);
    // The blur is that of the edge, which is known now.
    if (e && e->sharp) e = detection_edge(v, relative_ * e->at, unit);
    if (e && e->sharp && !(e->at > 2 * unit && at_many_ranges(v, r, e->at))) e->sharp = false;
    return e;
  }
  /// Whether surfaces are dark and bright (a factor of two at least) and those at the edge at different
  /// ranges: else it is the edge of a surface's own remission, or of the room.
  [[nodiscard]] bool at_many_ranges(const std::vector<double>& v, const std::vector<double>& r,
                                    double edge) const {
    std::vector<double> near;
    const double width = std::max(3 * relative_, 0.1);
    for (std::size_t i = 0; i < v.size(); ++i)
      if (std::abs(v[i] - edge) < width * edge) near.push_back(r[i]);
    if (near.size() < 30) return false;
    std::vector<double> bright = v;
    const auto most = bright.begin() + static_cast<std::ptrdiff_t>(bright.size() * 49 / 50);
    std::nth_element(bright.begin(), most, bright.end());
    if (*most < 2 * edge) return false;
    std::sort(near.begin(), near.end());
    return near[near.size() * 9 / 10] > 1.5 * near[near.size() / 10];
  }

  const std::vector<double>&e_, &r_;
  double relative_, unit_, limit_range_m_, overlap_m_;
};

}  // namespace

DetectionFit fit_detection(const std::vector<double>& remission, const std::vector<double>& range_m,
                           double relative, double unit, const models::LidarDetection& sensor_model) {
  DetectionFit out;
  out.limit_range_m = sensor_model.limit_range_m > 0 ? sensor_model.limit_range_m : 10;
  if (remission.empty()) return out;
  std::vector<double> sorted = range_m;
  std::sort(sorted.begin(), sorted.end());
  out.farthest_m = sorted.back();
  const Sides sides(remission, range_m, relative, unit, out.limit_range_m, sensor_model.overlap_m);
  const auto gain = [](const std::optional<DetectionEdge>& e) { return e && e->sharp ? e->gain : 0.0; };
  // One of them alone, or both with the range where one takes over from the other.
  const auto all_floor = sides.floor(2 * out.farthest_m), all_limit = sides.limit(0);
  out.lowest = all_floor ? all_floor->at : *std::min_element(remission.begin(), remission.end());
  double best = std::max(gain(all_floor), gain(all_limit));
  if (gain(all_floor) > 0 && gain(all_floor) >= best)
    out.floor = all_floor;
  else if (gain(all_limit) > 0)
    out.limit = all_limit;
  // Two more numbers must be worth it (BIC).
  best += std::log(static_cast<double>(remission.size()));
  bool both = false;
  for (const int k : {2, 4, 6, 8}) {
    const double border = sorted[sorted.size() * static_cast<std::size_t>(k) / 10];
    const auto near = sides.floor(border), far = sides.limit(border);
    if (!(gain(near) > 0) || !(gain(far) > 0) || gain(near) + gain(far) <= best) continue;
    best = gain(near) + gain(far);
    out.floor = near, out.limit = far;
    both = true;
  }
  // The border follows from both. Where they are alike either edge is blurred by the other: it is left out.
  for (int round = 0; both && round < 2; ++round) {
    constexpr double kMargin = 1.05;
    const double border = out.limit_range_m * std::sqrt(out.floor->at / out.limit->at);
    if (!(border > sorted.front()) || !(border < out.farthest_m)) break;
    const auto near = sides.floor(border / kMargin), far = sides.limit(border * kMargin);
    if (!(gain(near) > 0) || !(gain(far) > 0)) break;
    out.floor = near, out.limit = far;
  }
  return out;
}

}  // namespace rigor::calibration

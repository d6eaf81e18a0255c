#include "sim/nature/sky/clouds.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "sensor-hal/models/philox.h"

namespace rigor::nature {
namespace {

constexpr int kLattice = 256;  // the field repeats after this many cells of the widest octave
constexpr int kOctaves = 7;
constexpr double kWidest_m = 2200;
constexpr double kDensest = 32;  // optical depth where the field is highest
constexpr models::PhiloxKey kCloudKey{0x636c6f75, 0x64730001};

const std::vector<float>& lattice() {
  static const std::vector<float> values = [] {
    std::vector<float> v(kLattice * kLattice);
    for (std::uint32_t i = 0; i < v.size(); i += 4) {
      const auto w = models::philox({i, 0, 0, 0}, kCloudKey);
      for (std::uint32_t k = 0; k < 4; ++k) v[i + k] = static_cast<float>(w[k] * 0x1p-32);
    }
    return v;
  }();
  return values;
}

double noise(double x, double y) {
  const auto& v = lattice();
  const double x0 = std::floor(x), y0 = std::floor(y);
  const double fx = x - x0, fy = y - y0;
  const double sx = fx * fx * fx * (fx * (fx * 6 - 15) + 10), sy = fy * fy * fy * (fy * (fy * 6 - 15) + 10);
  const auto cell = [](double c) { return static_cast<std::int64_t>(c) & (kLattice - 1); };
  const auto at = [&](double i, double j) {
    return static_cast<double>(v[static_cast<std::size_t>(cell(j) * kLattice + cell(i))]);
  };
  const double low = at(x0, y0) * (1 - sx) + at(x0 + 1, y0) * sx;
  const double high = at(x0, y0 + 1) * (1 - sx) + at(x0 + 1, y0 + 1) * sx;
  return low * (1 - sy) + high * sy;
}

/// 0 … 1 with mean 0.5; anything below `enough` where it is certain to stay below. Each octave is turned and
/// shifted, so that their lattices never line up.
double field(const Eigen::Vector2d& p_m, double footprint_m, double enough) {
  constexpr double kFade = 0.52, kFirst = 0.5;
  double x = p_m.x() / kWidest_m, y = p_m.y() / kWidest_m, weight = kFirst, wavelength_m = kWidest_m;
  double rest = kFirst * (1 - std::pow(kFade, kOctaves)) / (1 - kFade);  // weight of the octaves to come
  const double total = rest;
  double sum = 0;
  for (int octave = 0; octave < kOctaves; ++octave) {
    const double keep = std::clamp(2 - 2 * footprint_m / wavelength_m, 0.0, 1.0);
    sum += weight * (keep > 0 ? 0.5 + keep * (noise(x, y) - 0.5) : 0.5);
    rest -= weight;
    if (sum + rest < enough * total) return (sum + rest) / total;
    if (keep <= 0) return (sum + 0.5 * rest) / total;
    weight *= kFade;
    wavelength_m *= 0.5;
    const double turned = 1.6 * x - 1.2 * y + 17.3;
    y = 1.2 * x + 1.6 * y + 41.7;
    x = turned;
  }
  return sum / total;
}

/// Values of the field, sorted: the quantile 1 − cover is the threshold above which there is cloud.
const std::vector<double>& quantiles() {
  static const std::vector<double> sorted = [] {
    std::vector<double> v;
    for (int j = 0; j < 96; ++j)
      for (int i = 0; i < 96; ++i) v.push_back(field({i * 2311.0, j * 1933.0}, 0, 0));
    std::sort(v.begin(), v.end());
    return v;
  }();
  return sorted;
}

}  // namespace

CloudField::CloudField(double cover) : cover_(std::clamp(cover, 0.0, 1.0)) {
  const auto& q = quantiles();
  const double at = (1 - cover_) * static_cast<double>(q.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(at), q.size() - 2);
  threshold_ = q[i] + (at - static_cast<double>(i)) * (q[i + 1] - q[i]);
}

double CloudField::optical_depth(const Eigen::Vector2d& p_m, double footprint_m) const {
  if (cover_ <= 0) return 0;
  const double above = field(p_m, footprint_m, threshold_) - threshold_;
  if (above <= 0) return 0;
  return kDensest * std::min(above / 0.28, 1.0);
}

double cloud_transmittance(double optical_depth) { return 2 / (2 + (1 - 0.85) * optical_depth); }

}  // namespace rigor::nature

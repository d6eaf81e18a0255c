#include "calibration/pair/range_model.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>

#include "calibration/pair/clustered_fit.h"

namespace rigor::calibration {
namespace {

enum Column : std::size_t { kOffset, kScale, kAmplitude, kColumns };
constexpr std::size_t kPlace = 8;  // side of a place, px
constexpr std::size_t kNoiseLevels = 48;

struct Picture {
  std::size_t width = 0, height = 0;
  std::vector<float> range, amplitude;
};
bool take(const Sample& s, Picture& p) {
  const auto* info = s.as<RangeImageInfo>();
  if (!info || (s.stamp.validity & (kIncomplete | kCorrupt)) != 0) return false;
  p.width = info->width_px, p.height = info->height_px;
  const std::size_t n = p.width * p.height, plane = n * sizeof(float);
  if (p.width < 8 || p.height < 8 || s.size_bytes < plane) return false;
  p.range.resize(n), p.amplitude.clear();
  std::memcpy(p.range.data(), s.bytes().data(), plane);
  if (s.size_bytes >= 2 * plane) {
    p.amplitude.resize(n);
    std::memcpy(p.amplitude.data(), s.bytes().data() + plane, plane);
  }
  return true;
}

}  // namespace

Result<RangePairFit> fit_range_pair(const ForEachPair& pairs, const RangePairOptions& o) {
  RangePairFit fit;
  std::unique_ptr<ClusteredFit> rows;
  ClusteredFit::Solution solution;
  std::vector<bool> held(kColumns, false);
  held[kScale] = !o.scale;
  Picture real, simulated;
  NoiseByLevel noise(kNoiseLevels);
  double both = 0, lost = 0, gained = 0, limit = 0;
  std::array<double, kNoiseLevels> spread{};  ///< variance of the residual by level; 0: not known
  Eigen::VectorXd state = Eigen::VectorXd::Zero(kColumns);
  std::size_t width = 0, height = 0;
  const auto one_pass = [&]() -> Status {
    const std::uint64_t stretch = std::max<std::uint64_t>(1, fit.pairs / 50);
    fit.pairs = fit.unlike = 0, fit.after = {};
    noise = NoiseByLevel(kNoiseLevels);
    both = lost = gained = 0;
    if (rows) rows->clear();
    std::vector<double> sizes;
    auto said = pairs([&](const Sample& a, const Sample& b) {
      if (!take(a, real) || !take(b, simulated) || real.width != simulated.width ||
          real.height != simulated.height || (width > 0 && (real.width != width || real.height != height))) {
        ++fit.unlike;
        return;
      }
      const std::size_t w = width = real.width, h = height = real.height;
      const std::size_t across = (w + kPlace - 1) / kPlace;
      if (!rows)
        rows = std::make_unique<ClusteredFit>(std::size_t{kColumns}, across * ((h + kPlace - 1) / kPlace));
      ++fit.pairs;
      fit.amplitudes = !real.amplitude.empty() && !simulated.amplitude.empty();
      sizes.clear();
      for (std::size_t v = 1; v + 1 < h; ++v)
        for (std::size_t u = 1; u + 1 < w; ++u) {
          const std::size_t at = v * w + u;
          const double s = double(simulated.range[at]), r = double(real.range[at]);
          both += std::isfinite(r) && std::isfinite(s), lost += !std::isfinite(r) && std::isfinite(s);
          gained += std::isfinite(r) && !std::isfinite(s);
          if (!std::isfinite(r) || !std::isfinite(s)) continue;
          bool smooth = true;
          for (const std::size_t n : {at - 1, at + 1, at - w, at + w})
            smooth = smooth && std::abs(double(simulated.range[n]) - s) <= o.edge_m;
          if (!smooth) continue;
          const double residual = r - (1 + state[kScale]) * s - state[kOffset];
          const double as = fit.amplitudes ? double(simulated.amplitude[at]) : 1;
          if (!(as > 0)) continue;
          const auto level = std::size_t(std::clamp(3 * std::log2(as), 0.0, double(kNoiseLevels - 1)));
          // Dark pixels are far noisier than bright ones; the last pass has told by how much.
          if (fit.passes > 0 && !(spread[level] > 0)) continue;
          const double variance = fit.passes > 0 ? spread[level] : 2 * o.sigma_m * o.sigma_m;
          sizes.push_back(std::abs(residual) / std::sqrt(variance));
          if (fit.passes == 0) fit.before.add(residual);
          fit.after.add(residual);
          // Huber's weight by the last pass's spread; the first by what an edge may be.
          const double far =
              limit > 0 ? std::abs(residual) / std::sqrt(variance) / limit : std::abs(residual) / o.edge_m;
          const std::size_t place = v / kPlace * across + u / kPlace;
          // The range itself is noisy: that of the pixels beside is an instrument for the scale.
          const double beside = (double(simulated.range[at - 1]) + double(simulated.range[at + 1]) +
                                 double(simulated.range[at - w]) + double(simulated.range[at + w])) /
                                4;
          const std::array<double, kColumns> j{1, s, 0}, i{1, beside, 0};
          rows->add(place, i, j, residual, huber_weight(1 / variance, far));
          if (fit.amplitudes && std::isfinite(as) && std::isfinite(real.amplitude[at])) {
            const std::array<double, kColumns> d{0, 0, as}, z{0, 0, 1};
            rows->add(place, z, d, double(real.amplitude[at]) - (1 + state[kAmplitude]) * as, {1e-6, 1e-6});
          }
          if (u % 3 != 1 || u + 2 >= w) continue;
          const double second[2] = {
              double(real.range[at - 1]) - 2 * r + double(real.range[at + 1]),
              double(simulated.range[at - 1]) - 2 * s + double(simulated.range[at + 1])};
          if (!std::isfinite(second[0]) || !std::isfinite(second[1])) continue;
          const double most = std::max(o.edge_m, 5 * std::sqrt(3 * spread[level]));
          if (std::abs(second[1]) > most) continue;
          noise.add(level, as, std::min(second[0] * second[0], 4 * most * most) / 6,
                    second[1] * second[1] / 6);
        }
      if (fit.pairs % stretch == 0) rows->end_stretch();
    });
    if (!said) return said;
    if (!rows) return {};
    rows->end_stretch();
    spread.fill(0);
    for (const NoiseLevel& l : noise.levels())
      spread[std::size_t(std::clamp(3 * std::log2(l.level), 0.0, double(kNoiseLevels - 1)))] =
          std::max(1e-10, l.real + l.simulated);
    if (!sizes.empty()) {
      const auto middle = sizes.begin() + std::ptrdiff_t(sizes.size() / 2);
      std::nth_element(sizes.begin(), middle, sizes.end());
      limit = kHuberLimit * std::max(1.4826 * *middle, 1e-3);
    }
    solution = rows->solve(held);
    return {};
  };
  const auto solve = [&]() -> Status {
    fit.converged = false;
    for (int pass = 0; pass < o.most_passes; ++pass) {
      if (o.progress) o.progress(fit.passes + 1);
      if (auto s = one_pass(); !s) return s;
      if (!rows || fit.pairs < 2) return {};
      const bool first = fit.passes++ == 0;
      if (first) fit.one_step.assign(solution.step.data(), solution.step.data() + kColumns);
      const bool small = !first && solution.is_small(0.01);
      if (small || o.stop.stop_requested()) {
        fit.converged = small, fit.change.interrupted = o.stop.stop_requested();
        return {};
      }
      state += solution.step;
    }
    return {};
  };
  if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
  if (!rows) {
    fit.change.residuals.unit = "m";
    return fit;
  }
  // Without a scale worth the name the offset is known better.
  if (!held[kScale] && !fit.change.interrupted &&
      !(std::abs(state[kScale]) > 4 * std::sqrt(solution.covariance(kScale, kScale)))) {
    held[kScale] = true, state[kScale] = 0;
    if (auto s = solve(); !s) return tl::unexpected<Error>(s.error());
  }
  if (!fit.amplitudes) held[kAmplitude] = true;
  fit.offset_m = state[kOffset], fit.scale = state[kScale], fit.amplitude_gain = 1 + state[kAmplitude];
  if (const double all = both + lost + gained; all > 0) fit.lost = lost / all, fit.gained = gained / all;
  // Where noise reaches the width of an edge, what was taken for an edge makes it too small.
  for (const NoiseLevel& l : noise.levels())
    if (6 * std::max(l.real, l.simulated) < o.edge_m * o.edge_m / 6) fit.noise.push_back(l);
  fit.change.residuals.unit = "m";
  fit.change.model = held[kScale] ? "range offset, amplitude" : "range offset, range scale, amplitude";
  const std::string smooth = "there are too few smooth surfaces that both sides see";
  keep_solution(fit,
                {{.name = "range_offset_m", .resolution = 0.2},
                 {.name = "range_scale", .resolution = 0.05},
                 {.name = "amplitude_gain", .resolution = 0.2}},
                state, solution.covariance, held, {smooth, smooth, smooth});
  return fit;
}

RangeNoiseFit fit_range_noise(const RangePairFit& fit, double contrast) {
  RangeNoiseFit out;
  std::vector<double> x, of_simulated, of_device, sigma;
  const double g = fit.amplitude_gain;
  for (const NoiseLevel& l : fit.noise) {
    // σ² A² = κ (2A/C + B) + P A², P the variance of a pattern of offsets.
    const double a2 = l.level * l.level;
    x.push_back(2 * l.level / contrast);
    of_simulated.push_back(l.simulated * a2), of_device.push_back(l.real * a2 * g * g);
    sigma.push_back(l.sigma * a2);
  }
  out.levels = int(x.size());
  if (out.levels < 4) return out;
  const auto n = Eigen::Index(x.size());
  Eigen::MatrixXd design(n, 3);
  Eigen::VectorXd y(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double s = sigma[std::size_t(i)], light = x[std::size_t(i)];
    design.row(i) << 1 / s, light / s, light * light / s;
    y[i] = of_simulated[std::size_t(i)] / s;
  }
  const Eigen::Matrix3d inverse = (design.transpose() * design).inverse();
  const Eigen::Vector3d law = inverse * design.transpose() * y;
  const double kappa = law[1], var_kappa = inverse(1, 1);
  if (!(kappa > 3 * std::sqrt(var_kappa))) return out;
  out.kappa = kappa, out.background = law[0] / kappa;
  const auto expected = [&](std::size_t i) {
    return of_simulated[i] + kappa * (g - 1) * x[i] + law[2] * (g * g - 1) * x[i] * x[i];
  };
  // κ is the simulated side's own: the device differs by what it adds.
  double weights = 0, sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double w = 1 / (sigma[i] * sigma[i]);
    weights += w, sum += w * (of_device[i] - expected(i));
  }
  const double mean = sum / weights;
  for (std::size_t i = 0; i < x.size(); ++i)
    out.chi2 += std::pow((of_device[i] - expected(i) - mean) / sigma[i], 2);
  // Of κ's own error: what it scales, and what the light that was gained takes off.
  double light = 0;
  for (std::size_t i = 0; i < x.size(); ++i) light += (g - 1) * x[i] / (sigma[i] * sigma[i]) / weights;
  out.more_e2 = mean / kappa;
  out.sigma_e2 = std::hypot(1 / std::sqrt(weights), (mean / kappa + light) * std::sqrt(var_kappa)) / kappa;
  out.solved = true;
  return out;
}

}  // namespace rigor::calibration

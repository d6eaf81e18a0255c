#include "calibration/lidar/remission_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/lidar/rounded_values.h"

namespace rigor::calibration {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

struct Cell {
  int plane, beam;
  double log_units, count;
  double shot;      ///< variance of one shot
  double rounding;  ///< variance that rounding adds, the same in every shot of a spot
};

struct Linear {
  VectorXd x;
  MatrixXd information;
  double weighted = 0;
};
/// Walls' levels and, where wanted, gains against the first beam.
Linear solve(const std::vector<Cell>& cells, int planes, int beams, bool gains, double tau2) {
  const Index n = planes + (gains ? beams - 1 : 0);
  Linear l{VectorXd::Zero(n), MatrixXd::Zero(n, n), 0};
  VectorXd g = VectorXd::Zero(n);
  for (const Cell& c : cells) {
    const double w = 1 / (c.shot / c.count + tau2 + c.rounding);
    const Index k = c.plane, b = gains && c.beam > 0 ? planes + c.beam - 1 : -1;
    l.information(k, k) += w, g[k] += w * c.log_units;
    if (b < 0) continue;
    l.information(b, b) += w, l.information(k, b) += w, l.information(b, k) += w;
    g[b] += w * c.log_units;
  }
  l.x = l.information.completeOrthogonalDecomposition().solve(g);
  for (const Cell& c : cells) {
    const double e = c.log_units - l.x[c.plane] - (gains && c.beam > 0 ? l.x[planes + c.beam - 1] : 0);
    l.weighted += e * e / (c.shot / c.count + tau2 + c.rounding);
  }
  return l;
}

void add(FitResult& f, const Parameter& p, double variance) {
  const Index n = f.covariance.rows();
  f.parameters.push_back(p);
  f.covariance.conservativeResizeLike(MatrixXd::Zero(n + 1, n + 1));
  f.covariance(n, n) = variance;
}

void fit_gains(const LidarReturns& returns, const models::LidarModel& sensor_model, const PlaneSearch& search,
               const BiasFit& bias, double noise, FitResult& f) {
  struct Sum {
    double n = 0, units = 0, cosine = 0;
  };
  std::map<std::tuple<int, int, int>, Sum> sums;
  const double top = sensor_model.remission.maximum;
  for (std::size_t i = 0; i < returns.all.size(); ++i) {
    if (!bias.used[i]) continue;
    const LidarReturn& r = returns.all[i];
    if (!std::isfinite(r.remission) || (top > 0 && static_cast<double>(r.remission) >= top)) continue;
    const auto k = static_cast<std::size_t>(search.label[i]);
    const PredictedRange p = predict_range(sensor_model.scan.beams[r.beam], bias.errors[r.beam],
                                           r.azimuth_rad, 1, bias.planes[k].q_per_m);
    Sum& s = sums[{search.label[i], r.beam,
                   static_cast<int>(std::floor(r.azimuth_rad * 180 / std::numbers::pi_v<float>))}];
    ++s.n;
    s.units += static_cast<double>(r.remission);
    s.cosine += p.cos_incidence;
  }
  std::vector<Cell> cells;
  const double step = std::max(sensor_model.remission.step, 0.0);
  std::vector<bool> seen(sensor_model.scan.beams.size(), false);
  for (const auto& [key, s] : sums) {
    const double mean = s.units / s.n;
    // The logarithm of a rounded small number is no measurement.
    if (!(mean > 8 * step) || !(mean > 0)) continue;
    // Rounding is noise where the noise carries it from step to step, else an error that all shots share.
    const double in_steps = step > 0 ? noise * mean / step : 0, unit = step / mean;
    const double shot = step > 0 ? rounded_variance(in_steps) * unit * unit : noise * noise;
    const double shared =
        step > 0 ? std::max(0.0, in_steps * in_steps + 1.0 / 12 - rounded_variance(in_steps)) * unit * unit
                 : 0;
    cells.push_back({std::get<0>(key), std::get<1>(key), std::log(mean / (s.cosine / s.n)), s.n,
                     std::max(shot, 1e-10), shared});
    seen[static_cast<std::size_t>(std::get<1>(key))] = true;
  }
  const int planes = static_cast<int>(bias.planes.size()), beams = static_cast<int>(seen.size());
  const auto beams_seen = std::count(seen.begin(), seen.end(), true);
  if (cells.size() < static_cast<std::size_t>(3 * (planes + beams)) || beams_seen != beams) {
    f.not_identifiable.emplace_back("remission_gain",
                                    "too few returns of walls with a remission that the device tells well");
    return;
  }
  // τ² at which the weighted squares are what they should be.
  const auto spread = [&](bool gains) {
    double low = 0, high = 25;
    const double dof = static_cast<double>(cells.size()) - planes - (gains ? beams - 1 : 0);
    if (solve(cells, planes, beams, gains, 0).weighted <= dof) return 0.0;
    for (int n = 0; n < 50; ++n) {
      const double mid = 0.5 * (low + high);
      (solve(cells, planes, beams, gains, mid).weighted > dof ? low : high) = mid;
    }
    return 0.5 * (low + high);
  };
  const bool several = beams > 1;
  const double tau2 = spread(several);
  const Linear equal = solve(cells, planes, beams, false, tau2);
  const Linear free = several ? solve(cells, planes, beams, true, tau2) : equal;
  const double b_equal =
                   bic(equal.weighted, static_cast<double>(cells.size()), static_cast<std::size_t>(planes)),
               b_free = bic(free.weighted, static_cast<double>(cells.size()),
                            static_cast<std::size_t>(planes + beams - 1));
  const bool gains = several && b_free < b_equal;
  if (several) {
    Candidate a{"equal gains",
                planes,
                std::sqrt(equal.weighted / static_cast<double>(cells.size())),
                b_equal,
                std::numeric_limits<double>::quiet_NaN(),
                0,
                !gains};
    Candidate b{"gain of each beam",
                planes + beams - 1,
                std::sqrt(free.weighted / static_cast<double>(cells.size())),
                b_free,
                std::numeric_limits<double>::quiet_NaN(),
                0,
                gains};
    f.candidates = {a, b};
  }
  const Linear& l = gains ? free : equal;
  const MatrixXd c = l.information.completeOrthogonalDecomposition().pseudoInverse();
  if (gains) {
    // Against the mean of the logarithms: g − 1·mean.
    MatrixXd to = MatrixXd::Zero(beams, l.x.size());
    for (int i = 0; i < beams; ++i) {
      if (i > 0) to(i, planes + i - 1) += 1;
      for (int j = 1; j < beams; ++j) to(i, planes + j - 1) -= 1.0 / beams;
    }
    const VectorXd g = to * l.x;
    const MatrixXd cg = to * c * to.transpose();
    const Index first = f.covariance.rows();
    for (int i = 0; i < beams; ++i) {
      const double gain = std::exp(g[i]);
      add(f,
          {"remission_gain[" + std::to_string(i) + "]", gain, gain * std::sqrt(cg(i, i)), 0.1, false, false},
          0);
    }
    for (int i = 0; i < beams; ++i)
      for (int j = 0; j < beams; ++j) f.covariance(first + i, first + j) = cg(i, j) * std::exp(g[i] + g[j]);
  }
  // Scale: by walls of known reflectance, as the mean weighted by their uncertainty.
  double sum = 0, weight = 0;
  for (int k = 0; k < planes; ++k) {
    const double rho = bias.planes[static_cast<std::size_t>(k)].reflectance;
    if (!(rho > 0) || !(c(k, k) > 0)) continue;
    double level = l.x[k];
    if (gains)
      for (int j = 1; j < beams; ++j) level += l.x[planes + j - 1] / beams;
    sum += (level - std::log(rho)) / c(k, k), weight += 1 / c(k, k);
  }
  if (weight > 0) {
    const double scale = std::exp(sum / weight);
    add(f, {"remission_scale", scale, scale / std::sqrt(weight), 0.1 * scale, false, false},
        scale * scale / weight);
  } else {
    f.not_identifiable.emplace_back("remission_scale",
                                    "no wall of known reflectance: give it with --targets (reflectance: …)");
  }
  f.scale = std::sqrt(tau2);
}

}  // namespace

std::optional<RemissionNoise> remission_noise(const NoiseFit& noise, const models::LidarModel& sensor_model) {
  const double step = std::max(0.0, sensor_model.remission.step), top = sensor_model.remission.maximum;
  double sum = 0, weight = 0, square = 0;
  for (const NoiseCell& c : noise.cells) {
    if (!c.used || c.dof < 3 || !(c.units > 10 * step) || !(c.units > 0) || c.remission > 1) continue;
    if (top > 0 && c.units > 0.9 * top) continue;
    const double v = (c.units_variance - step * step / 12) / (c.units * c.units);
    sum += c.dof * v, weight += c.dof, square += c.dof * c.dof * v * v;
  }
  if (!(weight > 50)) return std::nullopt;
  RemissionNoise n;
  n.relative = std::sqrt(std::max(0.0, sum / weight));
  // By how much cells differ.
  n.sigma = std::sqrt(std::max(0.0, square / (weight * weight))) / (2 * std::max(1e-6, n.relative));
  return n;
}

RemissionFit fit_remission(const LidarReturns& returns, const models::LidarModel& sensor_model,
                           const PlaneSearch& search, const BiasFit& bias, const NoiseFit* noise) {
  RemissionFit out;
  FitResult& f = out.result;
  f.model = "lambert";
  f.covariance = MatrixXd::Zero(0, 0);
  bool any = false;
  for (const LidarReturn& r : returns.all) any = any || std::isfinite(r.remission);
  if (!any) {
    f.not_identifiable.emplace_back("remission", "the device tells no remission");
    return out;
  }
  const double step = std::max(0.0, sensor_model.remission.step);
  double relative = 0.05;
  if (noise) {
    if (const auto v = remission_noise(*noise, sensor_model)) {
      relative = v->relative;
      add(f, {"remission_noise", relative, v->sigma, relative, false, relative == 0}, v->sigma * v->sigma);
    } else {
      f.not_identifiable.emplace_back("remission_noise",
                                      "too few shots with a remission between ten steps and saturation");
    }
  }
  if (!bias.planes.empty()) fit_gains(returns, sensor_model, search, bias, relative, f);

  std::vector<double> e, range;
  const double unit = step / std::max(1e-300, sensor_model.remission.scale);
  for (const LidarReturn& r : returns.all)
    if (std::isfinite(r.remission)) {
      e.push_back(remission_from_units(sensor_model.remission, r.remission, r.range_m));
      range.push_back(r.range_m);
    }
  const DetectionFit d = fit_detection(e, range, relative, unit, sensor_model.detection);
  char text[240];
  if (d.floor) {
    add(f, {"minimum_remission", d.floor->at, d.floor->sigma, 0.3 * d.floor->at, false, false},
        d.floor->sigma * d.floor->sigma);
  } else {
    std::snprintf(
        text, sizeof text,
        "returns run out towards small remission without an edge, or at the device's smallest number: it "
        "is at most %.3g; record black surfaces at grazing incidence",
        d.lowest);
    f.not_identifiable.emplace_back("minimum_remission", text);
  }
  if (d.limit) {
    out.limit_range_m = d.limit_range_m;
    add(f, {"limit_remission", d.limit->at, d.limit->sigma, 0.3 * d.limit->at, false, false},
        d.limit->sigma * d.limit->sigma);
  } else {
    std::snprintf(text, sizeof text,
                  "the least remission that is seen does not grow with range in these data (to %.3g m): "
                  "record dark surfaces far away",
                  d.farthest_m);
    f.not_identifiable.emplace_back("limit_remission", text);
  }
  return out;
}

}  // namespace rigor::calibration

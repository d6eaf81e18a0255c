#include "calibration/photon/linearity.h"

#include <Eigen/Dense>
#include <cmath>
#include <cstdio>
#include <set>

namespace rigor::calibration {

void judge_linearity(const FrameStacks& stacks, PhotonFit& fit) {
  const auto& points = fit.statistics.points;
  const auto& levels = stacks.levels();
  // Dark level at an exposure time: of the dark frames of that time where there are some, else the fit's.
  const Parameter* dark = fit.result.find("dark_current_e_per_s");
  const Parameter* gain = fit.result.find("system_gain_dn_per_e");
  const auto black_at = [&](double exposure_s, int phase) {
    for (const LevelPoint& p : points)
      if (!levels[p.level].settings.light && p.usable && p.phase == phase &&
          levels[p.level].settings.exposure_s == exposure_s)
        return p.mean_dn;
    return fit.black_dn + (dark && gain ? dark->value * gain->value * exposure_s : 0);
  };
  double top = fit.saturation_signal_dn.value_or(0);
  for (const LevelPoint& p : points)
    if (!fit.saturation_signal_dn && levels[p.level].settings.light && p.usable)
      top = std::max(top, p.mean_dn - fit.black_dn);
  std::set<double> exposures;
  for (int phase = 0; phase < 4; ++phase) {
    Eigen::Matrix2d a = Eigen::Matrix2d::Zero();
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    std::vector<LinearityPoint> of_phase;
    for (const LevelPoint& p : points) {
      const PhotonFrame& s = levels[p.level].settings;
      if (p.phase != phase || !s.light || p.black_share > 1e-4 * p.frames || p.white_share > 1e-4 * p.frames)
        continue;
      LinearityPoint l{s.exposure_s, p.mean_dn - black_at(s.exposure_s, phase), 0, 0, phase};
      if (l.signal_dn < 0.05 * top || l.signal_dn > 0.95 * top * (fit.saturation_signal_dn ? 1 : 2)) continue;
      l.sigma = std::sqrt(std::max(0.0, p.variance_dn2) / (p.pixels * p.frames)) / l.signal_dn;
      const Eigen::Vector2d row(1 / l.signal_dn, l.exposure_s / l.signal_dn);
      a += row * row.transpose();
      b += row;
      of_phase.push_back(l);
    }
    if (of_phase.size() < 3) continue;
    const Eigen::Vector2d line = a.ldlt().solve(b);
    for (LinearityPoint& l : of_phase) {
      const double expected = line[0] + line[1] * l.exposure_s;
      l.deviation = (l.signal_dn - expected) / expected;
      fit.linearity.push_back(l);
      exposures.insert(l.exposure_s);
    }
  }
  if (exposures.size() < 3) {
    fit.linearity.clear();
    fit.result.not_identifiable.emplace_back(
        "linearity", "it needs three exposure times or more between 5 and 95 % of the saturation, got " +
                         std::to_string(exposures.size()));
    return;
  }
  double sum = 0;
  // ln signal = g ln t + c of each colour: an exponent other than 1 is a tone curve.
  double sxx = 0, sxy = 0, rest = 0;
  std::size_t colours = 0;
  for (const LinearityPoint& l : fit.linearity) sum += std::abs(l.deviation);
  std::vector<std::pair<double, double>> centred;
  for (int phase = 0; phase < 4; ++phase) {
    double x = 0, y = 0, n = 0;
    for (const LinearityPoint& l : fit.linearity)
      if (l.phase == phase) x += std::log(l.exposure_s), y += std::log(l.signal_dn), ++n;
    if (n == 0) continue;
    ++colours;
    for (const LinearityPoint& l : fit.linearity)
      if (l.phase == phase) {
        centred.emplace_back(std::log(l.exposure_s) - x / n, std::log(l.signal_dn) - y / n);
        sxx += centred.back().first * centred.back().first;
        sxy += centred.back().first * centred.back().second;
      }
  }
  fit.linearity_error = sum / static_cast<double>(fit.linearity.size());
  const double g = sxy / sxx;
  for (const auto& [x, y] : centred) rest += (y - g * x) * (y - g * x);
  fit.response_exponent = g;
  fit.response_exponent_sigma =
      std::sqrt(rest / static_cast<double>(std::max<std::size_t>(1, centred.size() - 1 - colours)) / sxx);
  if (std::abs(g - 1) > std::max(0.03, 4 * *fit.response_exponent_sigma)) {
    char text[240];
    std::snprintf(text, sizeof text,
                  "the signal grows with the exposure time to the power %.3f, not 1: pictures with a tone "
                  "curve (gamma), "
                  "or light that was not steady; photon transfer needs raw pictures",
                  g);
    fit.result.warnings.emplace_back(text);
  }
}

}  // namespace rigor::calibration

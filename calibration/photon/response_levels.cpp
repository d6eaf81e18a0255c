// The response within the joint fit: found in the levels' signals, taken out of them, and its uncertainty
// carried into the other parameters.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "calibration/photon/photon_problem.h"

namespace rigor::calibration {

namespace {

/// Standard uncertainty of a level's mean; where there is hardly noise, it stands on a step of the converter.
double mean_sigma(const LevelPoint& p) {
  const double noise = std::max(0.0, p.variance_dn2 - 1.0 / 12) + p.pixel_variance_dn2;
  const double step = std::exp(-2 * std::numbers::pi * std::numbers::pi * noise) * 0.29;
  return std::hypot(step, std::sqrt(std::max(1e-6, p.variance_dn2) / (p.pixels * p.frames)));
}

}  // namespace

void PhotonProblem::look_for_bend(double black_dn) {
  double top = out_.saturation_signal_dn.value_or(0);
  for (const LevelPoint& p : st_.points)
    if (!out_.saturation_signal_dn && stacks_.levels()[p.level].settings.light && p.usable)
      top = std::max(top, p.mean_dn - black_dn);
  const bool saturates = out_.saturation_signal_dn.has_value();
  double black_sigma = 0;
  for (const std::size_t k : of(false)) black_sigma = std::max(black_sigma, mean_sigma(st_.points[k]));
  std::set<double> exposures;
  for (const LevelPoint& p : st_.points) {
    const PhotonFrame& s = stacks_.levels()[p.level].settings;
    const double signal = p.mean_dn - black_dn;
    if (!s.light || !p.usable || signal < 0.05 * top || (saturates && signal > 0.9 * top)) continue;
    bend_.points.push_back({s.exposure_s, signal, std::hypot(black_sigma, mean_sigma(p)), p.phase});
    exposures.insert(s.exposure_s);
  }
  if (exposures.size() < 5 || !plan_.dark_level) return;
  // A power other than 1 is a tone curve, and no bend.
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for (const ResponsePoint& p : bend_.points) {
    const double t = std::log(p.exposure_s), s = std::log(p.signal_dn);
    ++n, x += t, y += s, xx += t * t, xy += t * s;
  }
  if (!st_.mosaic && std::abs((xy - x * y / n) / (xx - x * x / n) - 1) > 0.15) return;
  const double full = st_.max_dn - black_dn;
  bend_.flicker = 1;
  for (int terms = 0; terms <= 2; ++terms)
    if (exposures.size() >= 4u + static_cast<unsigned>(terms))
      bend_.flicker = std::min(bend_.flicker, flicker_of(bend_.points, terms, full));
  bend_.straight = fit_response(bend_.points, 0, full, bend_.flicker);
  const double cost = std::log(static_cast<double>(bend_.points.size()));
  double best = bend_.straight.chi2 - 10;
  for (int terms = 1; terms <= 2; ++terms) {
    if (exposures.size() < 4u + static_cast<unsigned>(terms)) continue;
    const ResponseFit f = fit_response(bend_.points, terms, full, bend_.flicker);
    if (!f.valid) continue;
    if (terms == 1) {
      bend_.bent = f;
      out_.response_c2_seen = f.response.c[0];
      out_.response_c2_seen_sigma = std::sqrt(f.response.covariance(0, 0));
    }
    if (f.chi2 + terms * cost > best) continue;
    best = f.chi2 + terms * cost - 6;
    bend_.bent = f;
    bend_.found = true;
  }
  out_.level_flicker = bend_.flicker;
}

void PhotonProblem::linearise(const PhotonResponse& response, double black_dn) {
  if (response_.terms > 0) {
    st_.points = raw_points_;
    st_.light_pattern = raw_light_pattern_;
    plateau_dn_ = raw_plateau_dn_;
  }
  response_ = response;
  if (response.terms == 0) return;
  raw_points_ = st_.points;
  raw_light_pattern_ = st_.light_pattern;
  raw_plateau_dn_ = plateau_dn_;
  double steeper = 0, signals = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    LevelPoint& p = st_.points[k];
    const double x = response.inverse(p.mean_dn - black_dn), slope = response.slope(x);
    // A gain pattern moves y by R'(x) x, of y = R(x): only the brighter levels count there.
    if (out_.in_range[k] && level(k).settings.light) steeper += slope * x, signals += p.mean_dn - black_dn;
    p.mean_dn = black_dn + x;
    p.variance_dn2 = (p.variance_dn2 - 1.0 / 12) / (slope * slope) + 1.0 / 12;
    p.fourth_dn4 /= std::pow(slope, 4);
    p.pixel_variance_dn2 /= slope * slope;
  }
  if (signals > 0) {
    const double square = std::pow(steeper / signals, 2);
    st_.light_pattern.value /= square, st_.light_pattern.sigma /= square;
  }
  if (plateau_dn_ > 0) plateau_dn_ = black_dn + response.inverse(plateau_dn_ - black_dn);
}

void PhotonProblem::add_response(const PhotonModel& m, LeastSquares::Outcome& outcome) {
  FitResult& r = outcome.fit;
  const PhotonResponse kept = response_;
  const auto p = static_cast<Eigen::Index>(r.parameters.size());
  const Eigen::Index terms = kept.terms;
  // What the others become where the response is another: by differences.
  Eigen::MatrixXd j = Eigen::MatrixXd::Zero(p, terms);
  for (Eigen::Index t = 0; t < terms; ++t) {
    const double step = std::sqrt(kept.covariance(t, t));
    for (const double side : {-1.0, 1.0}) {
      PhotonResponse moved = kept;
      moved.c[t] += side * step;
      PhotonModel other = m;
      linearise(moved, m.p[kBlack]);
      const auto fit = iterate(other, false, st_.points.size());
      for (Eigen::Index i = 0; fit && i < p; ++i)
        j(i, t) += side * fit->fit.parameters[static_cast<std::size_t>(i)].value / (2 * step);
    }
  }
  linearise(kept, m.p[kBlack]);
  const Eigen::MatrixXd c = kept.covariance.topLeftCorner(terms, terms);
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(p + terms, p + terms);
  all.topLeftCorner(p, p) = r.covariance + j * c * j.transpose();
  all.topRightCorner(p, terms) = j * c;
  all.bottomLeftCorner(terms, p) = (j * c).transpose();
  all.bottomRightCorner(terms, terms) = c;
  for (Eigen::Index i = 0; i < p; ++i) r.parameters[static_cast<std::size_t>(i)].sigma = std::sqrt(all(i, i));
  for (Eigen::Index t = 0; t < terms; ++t)
    r.parameters.push_back({t == 0 ? "response_c2" : "response_c3", kept.c[t], std::sqrt(c(t, t)), 0.05});
  r.covariance = all;
}

}  // namespace rigor::calibration

#include "calibration/photon/response.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "sensor-hal/models/one_source.h"

namespace rigor::calibration {
namespace {

using Noise = models::NoiseMath<double>;

double sigma_of(const ResponsePoint& p, double flicker) {
  return std::hypot(p.sigma_dn, flicker * p.signal_dn);
}

/// The light of each colour, by y = light · t.
std::map<int, double> start_lights(const std::vector<ResponsePoint>& points, double flicker) {
  std::map<int, std::pair<double, double>> sums;
  for (const ResponsePoint& p : points) {
    const double s = sigma_of(p, flicker), w = 1 / (s * s);
    sums[p.colour].first += w * p.signal_dn * p.exposure_s;
    sums[p.colour].second += w * p.exposure_s * p.exposure_s;
  }
  std::map<int, double> lights;
  for (const auto& [colour, s] : sums) lights[colour] = s.first / s.second;
  return lights;
}

}  // namespace

double PhotonResponse::value(double x) const { return Noise::emva_response(x, full_scale_dn, c[0], c[1]); }
double PhotonResponse::slope(double x) const {
  const double s = std::clamp(x / full_scale_dn, 0.0, 1.0);
  return x >= full_scale_dn ? 1 + c[0] + c[1] : 1 + s * (2 * c[0] + 3 * c[1] * s);
}
double PhotonResponse::inverse(double y) const {
  double x = y;
  for (int i = 0; i < 50; ++i) {
    const double step = (value(x) - y) / slope(x);
    x -= step;
    if (std::abs(step) < 1e-12 * (1 + std::abs(y))) break;
  }
  return x;
}
bool PhotonResponse::rising() const {
  if (std::abs(c[0]) > 1 || std::abs(c[1]) > 1) return false;  // the sensor model's bounds
  for (int i = 0; i <= 20; ++i)
    if (slope(full_scale_dn * i / 20 * 0.9999) < 0.05) return false;
  return true;
}

ResponseFit fit_response(const std::vector<ResponsePoint>& points, int terms, double full_scale_dn,
                         double flicker) {
  ResponseFit out;
  out.response.terms = terms;
  out.response.full_scale_dn = full_scale_dn;
  const auto lights = start_lights(points, flicker);
  const auto colours = static_cast<Eigen::Index>(lights.size());
  const Eigen::Index n = colours + terms;
  out.parameters = static_cast<int>(n);
  if (static_cast<Eigen::Index>(points.size()) <= n) return out;
  std::map<int, Eigen::Index> at;
  Eigen::VectorXd p = Eigen::VectorXd::Zero(n);
  for (const auto& [colour, light] : lights) {
    at[colour] = static_cast<Eigen::Index>(at.size());
    p[at[colour]] = light;
  }
  Eigen::MatrixXd information;
  for (int round = 0; round < 40; ++round) {
    information = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(n);
    PhotonResponse& r = out.response;
    for (int k = 0; k < terms; ++k) r.c[k] = p[colours + k];
    out.chi2 = 0;
    for (const ResponsePoint& q : points) {
      const double x = p[at[q.colour]] * q.exposure_s, s = std::clamp(x / full_scale_dn, 0.0, 1.0);
      const double w = 1 / sigma_of(q, flicker);
      Eigen::VectorXd row = Eigen::VectorXd::Zero(n);
      row[at[q.colour]] = w * r.slope(x) * q.exposure_s;
      if (terms > 0) row[colours] = w * x * s;
      if (terms > 1) row[colours + 1] = w * x * s * s;
      const double e = w * (q.signal_dn - r.value(x));
      information += row * row.transpose();
      gradient += row * e;
      out.chi2 += e * e;
    }
    const Eigen::VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::VectorXd step =
        scale.asDiagonal() *
        (scale.asDiagonal() * information * scale.asDiagonal()).ldlt().solve(scale.asDiagonal() * gradient);
    if (!step.allFinite()) return out;
    p += step;
    if (step.cwiseQuotient(scale).norm() < 1e-7) break;
  }
  if (terms > 0) {
    const Eigen::MatrixXd c = information.inverse();
    out.response.covariance.topLeftCorner(terms, terms) = c.bottomRightCorner(terms, terms);
  }
  out.valid = out.response.c.allFinite() && out.response.rising() && std::isfinite(out.chi2);
  return out;
}

double broken_response_chi2(const std::vector<ResponsePoint>& points, double break_dn, double ratio,
                            double flicker) {
  // In the linear range before the break: the inverse is exact.
  std::vector<ResponsePoint> straight = points;
  for (ResponsePoint& p : straight)
    if (p.signal_dn > break_dn) {
      p.signal_dn = break_dn + (p.signal_dn - break_dn) / ratio;
      p.sigma_dn /= ratio;
    }
  return fit_response(straight, 0, 1e300, flicker).chi2;
}

double flicker_of(const std::vector<ResponsePoint>& points, int terms, double full_scale_dn) {
  const ResponseFit plain = fit_response(points, terms, full_scale_dn, 0);
  const double dof = static_cast<double>(points.size()) - plain.parameters;
  if (dof < 1 || plain.chi2 <= dof) return 0;
  double low = 1e-7, high = 1;
  for (int i = 0; i < 40; ++i) {
    const double middle = std::sqrt(low * high);
    (fit_response(points, terms, full_scale_dn, middle).chi2 > dof ? low : high) = middle;
  }
  return std::sqrt(low * high);
}

}  // namespace rigor::calibration

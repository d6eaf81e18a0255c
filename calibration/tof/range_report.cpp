// What the range fit says: information, residuals, scenes, the curve of the wiggling.
#include <fmt/format.h>
#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/least_squares.h"
#include "calibration/tof/range_problem.h"
#include "calibration/tof/wiggling.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {

double RangeProblem::withheld_error_m(const RangeModel& m, const RangeState& state, std::size_t k,
                                      std::size_t stride) const {
  if (!scene_used_[k]) return kNaN;
  RangeState s = state;
  s.error_m[k] = 0;
  Cell c;
  const WigglingCurve w = wiggling(m, s);
  for (int round = 0;; ++round) {
    Eigen::Matrix2d h = Eigen::Matrix2d::Identity() * 1e-12;
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    double squares = 0, n = 0;
    for (std::size_t p = 0; p < all_.pixels(); p += stride) {
      if (!(s.weight[p] > 0)) continue;
      const Gathered& here = gathered_[k * all_.pixels() + p];
      if (!(here.count > 0)) continue;
      evaluate(m, s, w, k, p, c);
      const double r = here.mean_m - (c.value_m + s.pixel_m[p]);
      const Eigen::Vector2d j(c.scene[1], c.scene[2]);
      h += j * j.transpose();
      b += j * r;
      squares += r * r, n += 1;
    }
    if (n < 3) return kNaN;
    if (round == 3) return std::sqrt(squares / n);
    const Eigen::Vector2d move = h.ldlt().solve(b);
    s.tilt_x[k] += move[0], s.tilt_y[k] += move[1];
  }
}

RangeProblem::Information RangeProblem::information(const RangeModel& m, const RangeState& state) const {
  RangeState s = state;
  const Normal n = accumulate(m, s, 1, nullptr, 0);
  const Eigen::Index globals = parameters(m), rest = n.h.rows() - globals;
  const double s2 = s.scale * s.scale;
  Eigen::MatrixXd h = n.h / s2;
  add_priors(m, s, h, nullptr, nullptr);
  // o is the mean of the pixels' offsets. For given parameters it is as uncertain as their noise makes it and
  // as the pattern does, of which this camera's pixels are one draw; with the parameters it moves along g.
  double mean = 0, spread = 0, count = 0;
  for (std::size_t p = 0; p < all_.pixels(); ++p)
    if (s.weight[p] > 0) mean += s.pixel_m[p], count += 1;
  mean /= std::max(count, 1.0);
  for (std::size_t p = 0; p < all_.pixels(); ++p)
    if (s.weight[p] > 0) spread += std::pow(s.pixel_m[p] - mean, 2);
  const double of_pixels = count > 1 ? spread / (count - 1) / count : 0;  // noise and pattern together
  const double by_noise = n.inverse_weights * s2 / std::max(count * count, 1.0);
  const double certain = 1 / std::max({of_pixels, by_noise, 1e-30});
  const Eigen::Index size = n.h.rows() + 1;
  Eigen::MatrixXd full(size, size);
  full(0, 0) = certain;
  full.block(0, 1, 1, size - 1) = certain * n.g.transpose();
  full.block(1, 0, size - 1, 1) = certain * n.g;
  full.bottomRightCorner(size - 1, size - 1) = h + certain * n.g * n.g.transpose();
  Information out;
  const Eigen::Index wanted = globals + 1;
  const Eigen::MatrixXd nn = full.bottomRightCorner(rest, rest);
  const Eigen::MatrixXd nw = full.bottomLeftCorner(rest, wanted);
  const Eigen::LDLT<Eigen::MatrixXd> solver(nn);
  out.matrix = full.topLeftCorner(wanted, wanted) - nw.transpose() * solver.solve(nw);
  out.matrix = 0.5 * (out.matrix + out.matrix.transpose()).eval();
  // A thousandth of the unambiguous range, and what moves ranges by about as much, is of no use.
  out.parameters.push_back({"range_offset_m", mean, 0, 1e-3 * wrap_m_});
  if (m.spline) {
    for (std::size_t j = 1; j < s.spline.size(); ++j)
      out.parameters.push_back({fmt::format("spline_m[{}]", j), s.spline[j], 0, 1e-3 * wrap_m_});
  } else {
    for (int j = 0; j < m.harmonics; ++j)
      out.parameters.push_back(
          {fmt::format("harmonic_{}", 3 + 2 * j), s.harmonics[static_cast<std::size_t>(j)], 0, 0.02});
  }
  if (m.amplitude) {
    out.parameters.push_back(
        {"amplitude_error_m", s.amplitude_m * unit_amplitude_, 0, 1e-3 * wrap_m_ * unit_amplitude_});
    out.matrix.row(wanted - 1) /= unit_amplitude_;
    out.matrix.col(wanted - 1) /= unit_amplitude_;
  }
  return out;
}

Eigen::MatrixXd RangeProblem::with_next_harmonic(const RangeModel& m, const RangeState& s,
                                                 const RangeState& next,
                                                 const Eigen::MatrixXd& covariance) const {
  // No correlation of two signals of the square wave's kind has more of a harmonic n than the triangle's
  // 1/n², which stands for the standard deviation of what is not known.
  RangeModel both = m;
  ++both.harmonics;
  const Eigen::MatrixXd all = information(both, s).matrix;
  const Eigen::Index at = both.harmonics;  // after the offset
  const double order = 1 + 2.0 * both.harmonics, wide = 1 / (order * order);
  Eigen::VectorXd shared(covariance.rows());
  for (Eigen::Index i = 0; i < shared.size(); ++i) shared[i] = all(i < at ? i : i + 1, at);
  if (!covariance.allFinite()) return covariance;
  // How far the parameters move where the harmonic moves by 1, and what the data say of it beside them.
  const Eigen::VectorXd slope = -(covariance * shared);
  const double told = std::max(0.0, all(at, at) + shared.dot(slope));
  const double variance = 1 / (told + 1 / (wide * wide)),
               mean = told * variance * next.harmonics[static_cast<std::size_t>(m.harmonics)];
  return covariance + (mean * mean + variance) * slope * slope.transpose();
}

std::vector<double> RangeProblem::residuals(const RangeModel& m, const RangeState& s,
                                            std::vector<NoiseSample>& share) const {
  std::vector<double> out;
  Cell c;
  const WigglingCurve w = wiggling(m, s);
  std::size_t seen = 0;
  const std::size_t stride = std::max<std::size_t>(1, s.samples / 20000);
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    if (!scene_used_[k]) continue;
    for (std::size_t p = 0; p < all_.pixels(); ++p) {
      bool evaluated = false;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!used_[i][p]) continue;
        if (!evaluated) evaluate(m, s, w, k, p, c), evaluated = true;
        out.push_back(residual(all_.frames[i], p, c.value_m + s.pixel_m[p], nullptr));
        const double inverse = inverse_[k * all_.pixels() + p];
        if (seen++ % stride == 0) share.push_back({inverse > 0 ? unit_amplitude_ / inverse : 0, out.back()});
      }
    }
  }
  return out;
}

std::vector<SceneFit> RangeProblem::scene_fits(const RangeModel& m, const RangeState& s) const {
  std::vector<SceneFit> out;
  Cell c;
  const WigglingCurve w = wiggling(m, s);
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    SceneFit f;
    f.name = scenes_[k]->name;
    f.distance_m = scenes_[k]->distance_m;
    f.error_m = s.error_m[k], f.tilt_x = s.tilt_x[k], f.tilt_y = s.tilt_y[k];
    f.error_sigma_m = s.distance_sigma_m;
    f.used = scene_used_[k];
    double squares = 0, deviation = 0, range = 0;
    for (std::size_t p = 0; p < all_.pixels(); ++p) {
      bool evaluated = false;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!std::isfinite(all_.frames[i].range_m[p])) continue;
        if (!used_[i][p]) {
          ++f.rejected;
          continue;
        }
        if (!evaluated) evaluate(m, s, w, k, p, c), evaluated = true;
        bool wrapped = false;
        const double r = residual(all_.frames[i], p, c.value_m + s.pixel_m[p], &wrapped);
        f.wrapped += wrapped;
        squares += r * r;
        deviation += r + c.wiggling_m + s.error_m[k] * c.scene[0];
        range += c.range_m;
        ++f.samples;
      }
    }
    const auto n = static_cast<double>(std::max<std::size_t>(f.samples, 1));
    f.rms_m = std::sqrt(squares / n), f.deviation_m = deviation / n, f.range_m = range / n;
    if (f.samples == 0) f.range_m = f.deviation_m = kNaN;
    out.push_back(std::move(f));
  }
  return out;
}

std::vector<RangeFit::CurvePoint> RangeProblem::curve(const RangeModel& m, const RangeState& s,
                                                      const Eigen::MatrixXd& covariance) const {
  std::vector<RangeFit::CurvePoint> out;
  const Eigen::Index globals = parameters(m);
  for (int i = 0; i <= 200; ++i) {
    const double range = spline_.from + (spline_.to - spline_.from) * i / 200;
    double w = 0;
    Eigen::VectorXd j = Eigen::VectorXd::Zero(globals + 1);
    if (m.spline) {
      std::array<double, 4> value{}, slope{};
      const auto first = static_cast<std::size_t>(spline_.basis(range, value, slope));
      for (std::size_t k = 0; k < 4; ++k) {
        w += value[k] * s.spline[first + k];
        if (first + k > 0) j[static_cast<Eigen::Index>(first + k)] = value[k];
      }
    } else if (m.harmonics > 0) {
      using Jet = ceres::Jet<double, 4>;
      const Jet h[4] = {Jet(s.harmonics[0], 0), Jet(s.harmonics[1], 1), Jet(s.harmonics[2], 2),
                        Jet(s.harmonics[3], 3)};
      const Jet e = wiggling_error(turns_per_m_, h, Jet(range));
      w = e.a;
      for (int k = 0; k < m.harmonics; ++k) j[k + 1] = e.v[k];
    }
    const Eigen::MatrixXd c = covariance.topLeftCorner(globals + 1, globals + 1);
    const double variance = j.dot(c * j);
    out.push_back({range, w, variance >= 0 ? std::sqrt(variance) : kNaN});
  }
  return out;
}

}  // namespace rigor::calibration

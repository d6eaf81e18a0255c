// Gauss–Newton of the range fit, the pixels eliminated.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/tof/range_parts.h"
#include "calibration/tof/range_problem.h"

namespace rigor::calibration {
namespace {

constexpr double kTiltSigma = 0.2;  ///< planes stand square to the axis within about ten degrees

/// x of A·x = b in the directions that A has.
Eigen::VectorXd solve_symmetric(const Eigen::MatrixXd& a, const Eigen::VectorXd& b,
                                Eigen::MatrixXd* inverse) {
  const Eigen::VectorXd scale =
      a.diagonal().unaryExpr([](double d) { return d > 0 ? 1 / std::sqrt(d) : 0.0; });
  const Eigen::MatrixXd unit = scale.asDiagonal() * a * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (unit + unit.transpose()));
  const Eigen::VectorXd inv = eigen.eigenvalues().unaryExpr([](double l) { return l > 1e-11 ? 1 / l : 0.0; });
  const Eigen::MatrixXd i = scale.asDiagonal() *
                            (eigen.eigenvectors() * inv.asDiagonal() * eigen.eigenvectors().transpose()) *
                            scale.asDiagonal();
  if (inverse) *inverse = i;
  return i * b;
}

double log_determinant(const Eigen::MatrixXd& a) {
  const Eigen::LDLT<Eigen::MatrixXd> d(a);
  return d.vectorD().cwiseAbs().cwiseMax(1e-300).array().log().sum();
}

}  // namespace

RangeProblem::Normal RangeProblem::accumulate(const RangeModel& m, RangeState& s, std::size_t stride,
                                              const std::vector<bool>* take, double cauchy) const {
  const Eigen::Index globals = parameters(m);
  const auto scenes = static_cast<Eigen::Index>(scenes_.size()), n = globals + 3 * scenes;
  constexpr std::size_t kParts = 32;
  std::vector<Normal> parts(kParts);
  const double width2 = cauchy * cauchy;
  const WigglingCurve wiggle = wiggling(m, s);
  in_parts(kParts, [&](std::size_t part) {
    Normal& out = parts[part];
    out.h = Eigen::MatrixXd::Zero(n, n);
    out.b = out.g = Eigen::VectorXd::Zero(n);
    for (auto& run : out.run) run.uq = Eigen::VectorXd::Zero(n);
    Eigen::VectorXd q(n);
    std::vector<Cell> cells(scenes_.size());
    std::vector<double> ws(scenes_.size()), rs(scenes_.size());
    for (std::size_t p = part * stride; p < all_.pixels(); p += kParts * stride) {
      double w_all = 0, r_all = 0, plain = 0, squares = 0, squares_m = 0;
      std::size_t scenes_here = 0, samples = 0;
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        ws[k] = rs[k] = 0;
        if (!scene_used_[k] || (take && !(*take)[k])) continue;
        bool evaluated = false;
        const double sigma = sigma_m_[k * all_.pixels() + p], w = 1 / (sigma * sigma);
        if (cauchy == 0) {
          const Gathered& here = gathered_[k * all_.pixels() + p];
          if (!(here.count > 0)) continue;
          evaluate(m, s, wiggle, k, p, cells[k]);
          const double r = here.mean_m - (cells[k].value_m + s.pixel_m[p]), n_here = here.count;
          const double square = here.squares_m2 + n_here * r * r;
          ws[k] = n_here * w, rs[k] = n_here * w * r;
          plain += n_here * w, squares += w * square, squares_m += square;
          samples += static_cast<std::size_t>(n_here);
          w_all += ws[k], r_all += rs[k];
          ++scenes_here;
          continue;
        }
        for (const std::size_t i : scenes_[k]->frames) {
          if (!used_[i][p]) continue;
          if (!evaluated) evaluate(m, s, wiggle, k, p, cells[k]), evaluated = true;
          const double r = residual(all_.frames[i], p, cells[k].value_m + s.pixel_m[p], nullptr);
          const double z2 = r * r * w;
          const double share = 1 / (1 + z2 / width2);
          ws[k] += share * w, rs[k] += share * w * r;
          plain += w, squares += z2, squares_m += r * r;
          ++samples;
        }
        w_all += ws[k], r_all += rs[k];
        scenes_here += ws[k] > 0;
      }
      s.weight[p] = plain;
      if (!(w_all > 0)) continue;
      const double move = r_all / w_all;
      s.pixel_m[p] += move;
      // As the sums of squares are after that move.
      if (cauchy == 0) squares -= r_all * r_all / w_all;
      out.squares += squares, out.squares_m += squares_m, out.samples += samples;
      out.pixels += 1;
      out.inverse_weights += 1 / plain;
      q.setZero();
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        if (!(ws[k] > 0)) continue;
        const Eigen::Map<const Eigen::VectorXd> global(cells[k].global.data(), globals);
        const Eigen::Map<const Eigen::Vector3d> scene(cells[k].scene.data());
        q.head(globals) += ws[k] * global;
        q.segment<3>(globals + 3 * static_cast<Eigen::Index>(k)) = ws[k] * scene;
      }
      q /= w_all;
      out.g += q;
      for (std::size_t d = 0; d < 2; ++d) {
        Normal::Run& run = out.run[d];
        const double u = rays_[p][d], c = s.pixel_m[p];
        run.u += u, run.uu += u * u, run.c += c, run.cc += c * c, run.uc += u * c;
        run.uq += u * q;
      }
      // One scene alone says nothing beside its pixels' own offsets: exactly nothing.
      if (scenes_here < 2) continue;
      ++out.compared;
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        if (!(ws[k] > 0)) continue;
        const Eigen::Index at = globals + 3 * static_cast<Eigen::Index>(k);
        const auto& global = cells[k].global;
        const auto& scene = cells[k].scene;
        const double r = rs[k] - ws[k] * move;
        // The upper half alone, by hand: a few numbers at a time are too few for Eigen's products.
        for (Eigen::Index a = 0; a < globals; ++a) {
          const double ga = global[static_cast<std::size_t>(a)], wa = ws[k] * ga;
          if (ga == 0) continue;
          out.b[a] += r * ga;
          for (Eigen::Index c = 0; c <= a; ++c) out.h(c, a) += wa * global[static_cast<std::size_t>(c)];
          for (Eigen::Index d = 0; d < 3; ++d) out.h(a, at + d) += wa * scene[static_cast<std::size_t>(d)];
        }
        for (Eigen::Index d = 0; d < 3; ++d) {
          const double sd = scene[static_cast<std::size_t>(d)];
          out.b[at + d] += r * sd;
          for (Eigen::Index c = 0; c <= d; ++c)
            out.h(at + c, at + d) += ws[k] * sd * scene[static_cast<std::size_t>(c)];
        }
      }
      out.h.selfadjointView<Eigen::Upper>().rankUpdate(q, -w_all);
    }
  });
  Normal sum = std::move(parts[0]);
  for (std::size_t i = 1; i < kParts; ++i) {
    sum.h += parts[i].h, sum.b += parts[i].b, sum.g += parts[i].g;
    for (std::size_t d = 0; d < 2; ++d) {
      Normal::Run& a = sum.run[d];
      const Normal::Run& b = parts[i].run[d];
      a.u += b.u, a.uu += b.uu, a.c += b.c, a.cc += b.cc, a.uc += b.uc, a.uq += b.uq;
    }
    sum.squares += parts[i].squares, sum.squares_m += parts[i].squares_m;
    sum.inverse_weights += parts[i].inverse_weights;
    sum.samples += parts[i].samples, sum.pixels += parts[i].pixels;
    sum.compared += parts[i].compared;
  }
  sum.h = sum.h.selfadjointView<Eigen::Upper>();
  if (sum.pixels == 0) return sum;
  const auto count = static_cast<double>(sum.pixels);
  // Offsets that run evenly across the picture and tilts that go as 1/distance are the same to the data. That
  // the pixels' offsets run no further than chance makes them, is taken as known.
  const double s2 = s.scale * s.scale;
  for (const Normal::Run& run : sum.run) {
    const double uu = run.uu - run.u * run.u / count;
    if (!(uu > 1e-9 * run.uu) || count < 4 || sum.compared == 0) continue;
    const double slope = (run.uc - run.u * run.c / count) / uu;
    const double spread = std::max(0.0, run.cc - run.c * run.c / count - slope * slope * uu) / (count - 2);
    const double variance = std::max(spread, s2 * sum.inverse_weights / count) / uu;
    if (!(variance > 0)) continue;
    const Eigen::VectorXd v = (run.uq - run.u / count * sum.g) / uu;
    sum.h += s2 / variance * v * v.transpose();
    sum.b += s2 / variance * slope * v;
  }
  sum.g /= count;
  return sum;
}

void RangeProblem::add_priors(const RangeModel& m, const RangeState& s, Eigen::MatrixXd& h,
                              Eigen::VectorXd* b, const std::vector<bool>* take) const {
  const Eigen::Index globals = parameters(m);
  const double we = 1 / (s.distance_sigma_m * s.distance_sigma_m + 1e-24 * wrap_m_ * wrap_m_),
               wt = 1 / (kTiltSigma * kTiltSigma);
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    const Eigen::Index at = globals + 3 * static_cast<Eigen::Index>(k);
    h(at, at) += we, h(at + 1, at + 1) += wt, h(at + 2, at + 2) += wt;
    if (!b || (take && !(*take)[k])) continue;
    (*b)[at] -= we * s.error_m[k];
    (*b)[at + 1] -= wt * s.tilt_x[k];
    (*b)[at + 2] -= wt * s.tilt_y[k];
  }
}

double RangeProblem::step(const RangeModel& m, RangeState& s, const Normal& n, const std::vector<bool>* take,
                          double damping) const {
  const Eigen::Index globals = parameters(m);
  const double inverse = 1 / (s.scale * s.scale);
  double decrement = 0;
  Eigen::VectorXd move;
  double scenes = 0;
  for (std::size_t k = 0; k < scenes_.size(); ++k) scenes += scene_used_[k] && (!take || (*take)[k]);
  // How far the distances are off is estimated where it was not said, by scenes enough.
  const bool estimate = estimates_distance_sigma() && !take && scenes > 1;
  for (int round = 0; round < (estimate ? 60 : 1); ++round) {
    Eigen::MatrixXd h = n.h * inverse, c;
    Eigen::VectorXd b = n.b * inverse;
    add_priors(m, s, h, &b, take);
    h.diagonal() *= 1 + damping;
    move = solve_symmetric(h, b, &c);
    decrement = b.dot(move);
    if (!estimate) break;
    double squares = 0, trace = 0;
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      if (!scene_used_[k]) continue;
      const Eigen::Index at = globals + 3 * static_cast<Eigen::Index>(k);
      squares += std::pow(s.error_m[k] + move[at], 2);
      trace += c(at, at);
    }
    const double variance = s.distance_sigma_m * s.distance_sigma_m;
    s.distance_freedom = scenes - trace / variance;
    if (s.distance_freedom < 0.9) {
      s.distance_freedom = 0;
      const bool was = s.distance_sigma_m == assumed_distance_sigma_m_;
      s.distance_sigma_m = assumed_distance_sigma_m_;
      if (was) break;
      continue;
    }
    const double next = std::max(std::sqrt(squares / s.distance_freedom), 1e-8 * assumed_distance_sigma_m_);
    const bool stays = std::abs(next - s.distance_sigma_m) < 1e-4 * next;
    s.distance_sigma_m = next;
    if (stays) break;
  }
  // Along a direction that is hardly determined a step may lead anywhere: shorter, and the same way.
  double longest = 0;
  if (!m.spline && m.harmonics > 0) longest = move.head(m.harmonics).cwiseAbs().maxCoeff();
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    longest = std::max(longest,
                       move.segment<2>(globals + 3 * static_cast<Eigen::Index>(k) + 1).cwiseAbs().maxCoeff());
  if (longest > 0.1) move *= 0.1 / longest;
  Eigen::Index at = 0;
  if (m.spline) {
    for (std::size_t j = 1; j < s.spline.size(); ++j) s.spline[j] += move[at++];
  } else {
    for (std::size_t j = 0; j < static_cast<std::size_t>(m.harmonics); ++j)
      s.harmonics[j] = std::clamp(s.harmonics[j] + move[at++], -0.9, 0.9);
  }
  if (m.amplitude) s.amplitude_m += move[at++];
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    if (take && !(*take)[k]) {
      at += 3;
      continue;
    }
    s.error_m[k] += move[at++];
    s.tilt_x[k] = std::clamp(s.tilt_x[k] + move[at++], -0.9, 0.9);
    s.tilt_y[k] = std::clamp(s.tilt_y[k] + move[at++], -0.9, 0.9);
  }
  return decrement;
}

void RangeProblem::solve(const RangeModel& m, RangeState& s, int iterations, std::size_t stride,
                         const std::vector<bool>* take) const {
  double decrement = std::numeric_limits<double>::infinity(), damping = 0;
  RangeState best;
  Normal n_best;
  double least = std::numeric_limits<double>::infinity();
  const auto cost_of = [&](const Normal& n) {
    double errors = 0;
    for (const double e : s.error_m) errors += e * e;
    const double sigma = std::max(s.distance_sigma_m, 1e-12 * wrap_m_);
    return n.squares + s.scale * s.scale * errors / (sigma * sigma);
  };
  for (int i = 0;; ++i) {
    Normal n = accumulate(m, s, stride, take, 0);
    if (n.samples == 0) return;
    // A step that made it worse is taken back and made shorter (Levenberg and Marquardt).
    const double cost = cost_of(n);
    if (cost > 1.0001 * least) {
      s = best;
      if (i < iterations) {
        damping = std::max(1e-3, 10 * damping);
        step(m, s, n_best, take, damping);
        decrement = std::numeric_limits<double>::infinity();
        continue;
      }
      n = n_best;
    }
    damping = damping > 1e-3 ? damping / 10 : 0;
    const double freedom = static_cast<double>(n.samples) - static_cast<double>(n.pixels) - parameters(m);
    // With one sample a pixel nothing is left to take the scale from.
    s.scale = freedom > 0 ? std::sqrt(std::max(n.squares, 0.0) / freedom) : 1;
    if (!(s.scale > 1e-12)) s.scale = freedom > 0 ? 1e-12 : 1;
    s.rms_m = std::sqrt(n.squares_m / static_cast<double>(n.samples));
    s.scale_m = s.rms_m;
    s.samples = n.samples;
    const bool last = i >= iterations || decrement < 1e-4;
    if (last) {
      const Eigen::Index globals = parameters(m), rest = n.h.rows() - globals;
      Eigen::MatrixXd h = n.h / (s.scale * s.scale), prior = Eigen::MatrixXd::Zero(h.rows(), h.cols());
      add_priors(m, s, prior, nullptr, take);
      h += prior;
      const Eigen::VectorXd w = prior.diagonal().tail(rest);
      double quadratic = 0;
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        const auto at = 3 * static_cast<Eigen::Index>(k);
        quadratic += w[at] * s.error_m[k] * s.error_m[k] + w[at + 1] * s.tilt_x[k] * s.tilt_x[k] +
                     w[at + 2] * s.tilt_y[k] * s.tilt_y[k];
      }
      const auto count = static_cast<double>(n.samples);
      s.minus_two_log_likelihood = count * std::log(std::max(n.squares, 1e-300) / count) + quadratic +
                                   log_determinant(h.bottomRightCorner(rest, rest)) - w.array().log().sum();
      return;
    }
    best = s;
    least = cost;
    decrement = step(m, s, n, take, damping);
    if (damping > 0) decrement = std::numeric_limits<double>::infinity();
    n_best = std::move(n);
  }
}

}  // namespace rigor::calibration

#include "calibration/tof/range_problem.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <thread>

#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kLightSpeed_mps = 299792458.0;
constexpr double kTiltSigma = 0.2;   ///< planes stand square to the axis within about ten degrees
constexpr std::size_t kNamed = 200;  ///< rejected samples that are named one by one

/// The same parts on any number of threads, so that sums come out the same.
template <class F>
void in_parts(std::size_t parts, const F& f) {
  const std::size_t threads = std::min<std::size_t>(parts, std::max(1u, std::thread::hardware_concurrency()));
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t i = next++; i < parts; i = next++) f(i);
  };
  std::vector<std::jthread> pool;
  for (std::size_t t = 1; t < threads; ++t) pool.emplace_back(work);
  work();
}

double median_of(std::vector<double>& v) {
  if (v.empty()) return 0;
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

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

RangeProblem::RangeProblem(const TofScenes& scenes, const models::TofModel& model,
                           const NoiseCoefficients* noise, double distance_sigma_m, double reject_sigmas)
    : all_(scenes),
      model_(model),
      wrap_m_(model.unambiguous_range_m()),
      given_distance_sigma_m_(distance_sigma_m),
      reject_sigmas_(reject_sigmas) {
  for (const double f : model.modulation.frequencies_hz) turns_per_m_.push_back(2 * f / kLightSpeed_mps);
  std::vector<double> distances;
  for (const TofScene& s : scenes.scenes)
    if (std::isfinite(s.distance_m)) scenes_.push_back(&s), distances.push_back(s.distance_m);
  assumed_distance_sigma_m_ = distances.empty() ? 0 : 1e-3 * median_of(distances);
  const std::size_t pixels = scenes.pixels();
  const CameraModel camera = model.camera();
  rays_.resize(pixels);
  double shortest = 1e300, longest = 0, steepest = 1;
  for (std::size_t p = 0; p < pixels; ++p) {
    const auto ray =
        unproject_ray(camera, {static_cast<double>(p % static_cast<std::size_t>(model.width_px)),
                               static_cast<double>(p / static_cast<std::size_t>(model.width_px))});
    if (!ray || !(ray->z > 0.05)) {
      rays_[p] = {0, 0, 0};
      continue;
    }
    const double n = std::hypot(ray->x, ray->y, ray->z);
    rays_[p] = {static_cast<float>(ray->x / n), static_cast<float>(ray->y / n),
                static_cast<float>(ray->z / n)};
    steepest = std::min(steepest, ray->z / n);
  }
  for (const TofScene* s : scenes_) {
    shortest = std::min(shortest, s->distance_m);
    longest = std::max(longest, s->distance_m / steepest);
  }
  spline_.from = shortest, spline_.to = std::max(longest, shortest * (1 + 1e-6));
  spline_.count = std::clamp(static_cast<int>(scenes_.size()) - 1, 4, 24);

  used_.resize(scenes.frames.size());
  scene_used_.assign(scenes_.size(), true);
  scene_empty_.assign(scenes_.size(), false);
  sigma_m_.assign(scenes_.size() * pixels, 1);
  inverse_.assign(scenes_.size() * pixels, 0);
  std::vector<double> log_amplitudes;
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    for (std::size_t p = 0; p < pixels; ++p) {
      double sum = 0, n = 0;
      for (const std::size_t i : scenes_[k]->frames) {
        const TofFrame& f = scenes.frames[i];
        auto& used = used_[i];
        if (used.empty()) used.resize(pixels);
        used[p] = std::isfinite(f.range_m[p]) && rays_[p][2] > 0;
        if (!f.amplitude.empty() && f.amplitude[p] > 0 && used[p]) sum += f.amplitude[p], n += 1;
      }
      if (!(n > 0)) continue;
      inverse_[k * pixels + p] = static_cast<float>(n / sum);
      if (p % 17 == 0) log_amplitudes.push_back(std::log(sum / n));
    }
  amplitudes_ = !log_amplitudes.empty();
  unit_amplitude_ = amplitudes_ ? std::exp(median_of(log_amplitudes)) : 1;
  for (std::size_t c = 0; c < inverse_.size(); ++c) {
    if (!(inverse_[c] > 0)) continue;
    if (noise) sigma_m_[c] = static_cast<float>(noise->sigma_m(1 / inverse_[c]));
    inverse_[c] *= static_cast<float>(unit_amplitude_);
  }
  // A pixel without an amplitude has no noise that is known: among others that have, it does not count.
  if (noise && amplitudes_)
    for (std::size_t k = 0; k < scenes_.size(); ++k)
      for (std::size_t p = 0; p < pixels; ++p)
        if (!(inverse_[k * pixels + p] > 0))
          for (const std::size_t i : scenes_[k]->frames) used_[i][p] = 0;
}

double RangeProblem::samples_per_pixel() const {
  std::size_t samples = 0, pixels = 0;
  for (std::size_t p = 0; p < all_.pixels(); ++p) {
    std::size_t n = 0;
    for (const TofScene* s : scenes_)
      for (const std::size_t i : s->frames) n += used_[i][p];
    samples += n, pixels += n > 0;
  }
  return pixels > 0 ? static_cast<double>(samples) / static_cast<double>(pixels) : 0;
}

int RangeProblem::parameters(const RangeModel& m) const {
  return (m.spline ? spline_.count - 1 : m.harmonics) + (m.amplitude ? 1 : 0);
}

RangeState RangeProblem::start(const RangeModel& m) const {
  RangeState s;
  if (model_.modulation.waveform == models::TofWaveform::harmonics && !m.spline)
    s.harmonics = model_.modulation.harmonics;
  s.spline.assign(static_cast<std::size_t>(spline_.count), 0);
  s.error_m.assign(scenes_.size(), 0);
  s.tilt_x = s.tilt_y = s.error_m;
  s.pixel_m.assign(all_.pixels(), 0);
  s.weight.assign(all_.pixels(), 0);
  s.distance_sigma_m = estimates_distance_sigma() ? assumed_distance_sigma_m_ : given_distance_sigma_m_;
  s = start_from(m, s);
  // Each pixel from the median of its samples.
  in_parts(64, [&](std::size_t part) {
    std::vector<double> r;
    Cell c;
    for (std::size_t p = part; p < all_.pixels(); p += 64) {
      r.clear();
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        evaluate(m, s, k, p, c);
        for (const std::size_t i : scenes_[k]->frames)
          if (used_[i][p]) r.push_back(residual(all_.frames[i], p, c.value_m, nullptr));
      }
      s.pixel_m[p] = median_of(r);
    }
  });
  return s;
}

RangeState RangeProblem::start_from(const RangeModel& m, const RangeState& from) const {
  RangeState s = from;
  // Without any harmonic to fit there is none: `none` says so.
  for (std::size_t h = static_cast<std::size_t>(m.spline ? 0 : m.harmonics); h < 4; ++h) s.harmonics[h] = 0;
  if (!m.spline) std::fill(s.spline.begin(), s.spline.end(), 0);
  if (!m.amplitude) s.amplitude_m = 0;
  return s;
}

void RangeProblem::evaluate(const RangeModel& m, const RangeState& s, std::size_t k, std::size_t p,
                            Cell& c) const {
  const double ux = rays_[p][0], uy = rays_[p][1];
  const double slope = double(rays_[p][2]) + s.tilt_x[k] * ux + s.tilt_y[k] * uy;
  const double range = (scenes_[k]->distance_m + s.error_m[k]) / slope;
  double wiggling = 0, wiggling_slope = 0;
  std::size_t at = 0;
  if (m.spline) {
    std::array<double, 4> value{}, slopes{};
    const auto first = static_cast<std::size_t>(spline_.basis(range, value, slopes));
    const auto n = static_cast<std::size_t>(spline_.count);
    for (std::size_t j = 1; j < n; ++j) c.global[j - 1] = 0;
    for (std::size_t j = 0; j < 4; ++j) {
      wiggling += value[j] * s.spline[first + j];
      wiggling_slope += slopes[j] * s.spline[first + j];
      if (first + j > 0) c.global[first + j - 1] = value[j];
    }
    at = n - 1;
  } else if (m.harmonics > 0) {
    using Jet = ceres::Jet<double, 5>;
    const Jet h[4] = {Jet(s.harmonics[0], 0), Jet(s.harmonics[1], 1), Jet(s.harmonics[2], 2),
                      Jet(s.harmonics[3], 3)};
    const Jet w = wiggling_error(turns_per_m_, h, Jet(range, 4));
    wiggling = w.a;
    wiggling_slope = w.v[4];
    at = static_cast<std::size_t>(m.harmonics);
    for (std::size_t j = 0; j < at; ++j) c.global[j] = w.v[static_cast<Eigen::Index>(j)];
  }
  double amplitude = 0;
  if (m.amplitude) {
    const double inverse = inverse_[k * all_.pixels() + p];
    amplitude = s.amplitude_m * inverse;
    c.global[at] = inverse;
  }
  c.range_m = range;
  c.wiggling_m = wiggling;
  c.value_m = range + wiggling + amplitude;
  c.scene = {(1 + wiggling_slope) / slope, -(1 + wiggling_slope) * range * ux / slope,
             -(1 + wiggling_slope) * range * uy / slope};
}

double RangeProblem::residual(const TofFrame& f, std::size_t pixel, double predicted, bool* wrapped) const {
  const double r = f.range_m[pixel] - predicted, turns = std::round(r / wrap_m_);
  if (wrapped) *wrapped = turns != 0;
  return r - turns * wrap_m_;
}

RangeProblem::Normal RangeProblem::accumulate(const RangeModel& m, RangeState& s, std::size_t stride,
                                              const std::vector<bool>* take, double cauchy) const {
  const Eigen::Index globals = parameters(m);
  const auto scenes = static_cast<Eigen::Index>(scenes_.size()), n = globals + 3 * scenes;
  constexpr std::size_t kParts = 32;
  std::vector<Normal> parts(kParts);
  const double width2 = cauchy * cauchy;
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
        for (const std::size_t i : scenes_[k]->frames) {
          if (!used_[i][p]) continue;
          if (!evaluated) evaluate(m, s, k, p, cells[k]), evaluated = true;
          const double r = residual(all_.frames[i], p, cells[k].value_m + s.pixel_m[p], nullptr);
          const double z2 = r * r * w;
          const double share = cauchy > 0 ? 1 / (1 + z2 / width2) : 1;
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
        const Eigen::Map<const Eigen::VectorXd> global(cells[k].global.data(), globals);
        const Eigen::Map<const Eigen::Vector3d> scene(cells[k].scene.data());
        const double r = rs[k] - ws[k] * move;
        out.h.topLeftCorner(globals, globals).noalias() += ws[k] * global * global.transpose();
        out.h.block(0, at, globals, 3).noalias() += ws[k] * global * scene.transpose();
        out.h.block<3, 3>(at, at).noalias() += ws[k] * scene * scene.transpose();
        out.b.head(globals) += r * global;
        out.b.segment<3>(at) += r * scene;
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

void RangeProblem::step(const RangeModel& m, RangeState& s, const Normal& n,
                        const std::vector<bool>* take) const {
  const Eigen::Index globals = parameters(m);
  const double inverse = 1 / (s.scale * s.scale);
  Eigen::VectorXd move;
  double scenes = 0;
  for (std::size_t k = 0; k < scenes_.size(); ++k) scenes += scene_used_[k] && (!take || (*take)[k]);
  // How far the distances are off is estimated where it was not said, by scenes enough.
  const bool estimate = estimates_distance_sigma() && !take && scenes > 1;
  for (int round = 0; round < (estimate ? 60 : 1); ++round) {
    Eigen::MatrixXd h = n.h * inverse, c;
    Eigen::VectorXd b = n.b * inverse;
    add_priors(m, s, h, &b, take);
    move = solve_symmetric(h, b, &c);
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
  Eigen::Index at = 0;
  if (m.spline) {
    for (std::size_t j = 1; j < s.spline.size(); ++j) s.spline[j] += move[at++];
  } else {
    for (std::size_t j = 0; j < static_cast<std::size_t>(m.harmonics); ++j)
      s.harmonics[j] = std::clamp(s.harmonics[j] + std::clamp(move[at++], -0.1, 0.1), -0.9, 0.9);
  }
  if (m.amplitude) s.amplitude_m += move[at++];
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    if (take && !(*take)[k]) {
      at += 3;
      continue;
    }
    s.error_m[k] += move[at++];
    s.tilt_x[k] = std::clamp(s.tilt_x[k] + std::clamp(move[at++], -0.1, 0.1), -0.9, 0.9);
    s.tilt_y[k] = std::clamp(s.tilt_y[k] + std::clamp(move[at++], -0.1, 0.1), -0.9, 0.9);
  }
}

void RangeProblem::solve(const RangeModel& m, RangeState& s, int iterations, std::size_t stride,
                         const std::vector<bool>* take) const {
  double before = std::numeric_limits<double>::infinity();
  for (int i = 0;; ++i) {
    const Normal n = accumulate(m, s, stride, take, 0);
    if (n.samples == 0) return;
    const double freedom = static_cast<double>(n.samples) - static_cast<double>(n.pixels) - parameters(m);
    // With one sample a pixel nothing is left to take the scale from.
    s.scale = freedom > 0 ? std::sqrt(std::max(n.squares, 0.0) / freedom) : 1;
    if (!(s.scale > 1e-12)) s.scale = freedom > 0 ? 1e-12 : 1;
    s.rms_m = std::sqrt(n.squares_m / static_cast<double>(n.samples));
    s.scale_m = s.rms_m;
    s.samples = n.samples;
    const bool last = i >= iterations || std::abs(before - n.squares) <= 1e-10 * n.squares;
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
    before = n.squares;
    step(m, s, n, take);
  }
}

double RangeProblem::robust_scale(const RangeModel& m, const RangeState& s) const {
  std::vector<double> z;
  Cell c;
  const std::size_t stride = std::max<std::size_t>(1, all_.pixels() / 2000);
  for (std::size_t p = 0; p < all_.pixels(); p += stride)
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      if (!scene_used_[k]) continue;
      bool evaluated = false;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!used_[i][p]) continue;
        if (!evaluated) evaluate(m, s, k, p, c), evaluated = true;
        z.push_back(std::abs(residual(all_.frames[i], p, c.value_m + s.pixel_m[p], nullptr)) /
                    sigma_m_[k * all_.pixels() + p]);
      }
    }
  return 1.4826 * median_of(z);
}

void RangeProblem::reject(const RangeModel& m, RangeState& s, const StopToken& stop) {
  // Everything that has a range begins anew.
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    for (const std::size_t i : scenes_[k]->frames)
      for (std::size_t p = 0; p < all_.pixels(); ++p)
        used_[i][p] = std::isfinite(all_.frames[i].range_m[p]) && rays_[p][2] > 0 &&
                      (!amplitudes_ || inverse_[k * all_.pixels() + p] > 0);
  std::fill(scene_used_.begin(), scene_used_.end(), true);
  double scale = robust_scale(m, s), narrow = 1;
  for (int round = 0; round < 10 && scale > 0 && !stop.stop_requested(); ++round) {
    s.scale = scale;
    Normal n;
    for (int i = 0; i < 2; ++i) {
      n = accumulate(m, s, 1, nullptr, 2.385 * scale * narrow);
      step(m, s, n, nullptr);
    }
    const double now = robust_scale(m, s);
    const bool falls = now < 0.98 * scale;
    scale = now;
    if (!falls && narrow < 0.6) break;
    narrow = falls ? narrow : narrow / 2;
  }
  const double crowd = std::max(1.0, samples_per_pixel());
  double limit = reject_sigmas_ * scale * std::sqrt(crowd / std::max(0.5, crowd - 1));
  std::size_t before = std::numeric_limits<std::size_t>::max();
  std::vector<bool> dropped(scenes_.size(), false);
  for (int round = 0; round < 10; ++round) {
    left_.clear();
    left_count_ = 0;
    Cell c;
    std::vector<std::size_t> all(scenes_.size(), 0), out(scenes_.size(), 0);
    for (std::size_t k = 0; k < scenes_.size(); ++k)
      for (std::size_t p = 0; p < all_.pixels(); ++p) {
        if (!(rays_[p][2] > 0)) continue;
        bool evaluated = false;
        for (const std::size_t i : scenes_[k]->frames) {
          const TofFrame& f = all_.frames[i];
          if (!std::isfinite(f.range_m[p]) || (amplitudes_ && !(inverse_[k * all_.pixels() + p] > 0)))
            continue;
          if (!evaluated) evaluate(m, s, k, p, c), evaluated = true;
          const double r = residual(f, p, c.value_m + s.pixel_m[p], nullptr);
          const double z = std::abs(r) / sigma_m_[k * all_.pixels() + p];
          used_[i][p] = scale == 0 || z <= limit;
          ++all[k];
          if (used_[i][p]) continue;
          ++out[k];
          ++left_count_;
          left_.push_back({i, p, r, z / std::max(limit / reject_sigmas_, 1e-300)});
          if (left_.size() > 20 * kNamed) {
            std::nth_element(left_.begin(), left_.begin() + kNamed, left_.end(),
                             [](const Left& a, const Left& b) { return a.sigmas > b.sigmas; });
            left_.resize(kNamed);
          }
        }
      }
    // A plane of which most does not fit was not where it was said to be.
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      scene_empty_[k] = all[k] == 0;
      scene_used_[k] = !dropped[k] && all[k] > 0 && 2 * out[k] <= all[k];
    }
    std::sort(left_.begin(), left_.end(), [](const Left& a, const Left& b) {
      return a.sigmas != b.sigmas ? a.sigmas > b.sigmas
                                  : std::make_pair(a.frame, a.pixel) < std::make_pair(b.frame, b.pixel);
    });
    if (left_.size() > kNamed) left_.resize(kNamed);
    if (left_count_ == before || stop.stop_requested()) break;
    before = left_count_;
    solve(m, s, 4, 1, nullptr);
    limit = reject_sigmas_ * s.scale;
    scale = s.scale;
    // Nor was one whose distance is off by far more than the others' are: the worst first, as it pulls them.
    std::vector<double> errors;
    std::size_t worst = 0;
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      if (!scene_used_[k]) continue;
      errors.push_back(std::abs(s.error_m[k]));
      if (!scene_used_[worst] || errors.back() > std::abs(s.error_m[worst])) worst = k;
    }
    if (errors.size() < 5) continue;
    const double typical = estimates_distance_sigma()
                               ? std::max(1.4826 * median_of(errors), 0.1 * assumed_distance_sigma_m_)
                               : given_distance_sigma_m_;
    if (std::abs(s.error_m[worst]) > 6 * typical) {
      dropped[worst] = true;
      scene_used_[worst] = false;
      s.error_m[worst] = 0;
      solve(m, s, 6, 1, nullptr);
      limit = reject_sigmas_ * s.scale;
      before = std::numeric_limits<std::size_t>::max();
    }
  }
}

double RangeProblem::withheld_error_m(const RangeModel& m, const RangeState& state, std::size_t k,
                                      std::size_t stride) const {
  if (!scene_used_[k]) return kNaN;
  RangeState s = state;
  s.error_m[k] = 0;
  Cell c;
  for (int round = 0;; ++round) {
    Eigen::Matrix2d h = Eigen::Matrix2d::Identity() * 1e-12;
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    double squares = 0, n = 0;
    for (std::size_t p = 0; p < all_.pixels(); p += stride) {
      if (!(s.weight[p] > 0)) continue;
      double sum = 0, count = 0;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!used_[i][p]) continue;
        if (count == 0) evaluate(m, s, k, p, c);
        sum += residual(all_.frames[i], p, c.value_m + s.pixel_m[p], nullptr);
        count += 1;
      }
      if (count == 0) continue;
      const double r = sum / count;
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

void RangeProblem::report_rejected(const RangeState&, FitResult& r) const {
  r.residuals.rejected = left_count_;
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    if (scene_empty_[k])
      r.warnings.push_back(scenes_[k]->name + ": no range in it: saturated, or nothing came back");
    else if (!scene_used_[k])
      r.rejected.push_back(
          {scenes_[k]->name + ": all of it; it does not agree with the other distances", 0, 0});
  for (const Left& l : left_) {
    const auto width = static_cast<std::size_t>(all_.width_px);
    r.rejected.push_back(
        {fmt::format("{} pixel ({}, {})", all_.frames[l.frame].name, l.pixel % width, l.pixel / width),
         std::abs(l.residual_m), l.sigmas});
  }
  if (left_count_ > left_.size())
    r.warnings.push_back(fmt::format("{} samples were rejected; the {} that are farthest off are named",
                                     left_count_, left_.size()));
}

std::vector<double> RangeProblem::residuals(const RangeModel& m, const RangeState& s,
                                            std::vector<NoiseSample>& share) const {
  std::vector<double> out;
  Cell c;
  std::size_t seen = 0;
  const std::size_t stride = std::max<std::size_t>(1, s.samples / 20000);
  for (std::size_t k = 0; k < scenes_.size(); ++k) {
    if (!scene_used_[k]) continue;
    for (std::size_t p = 0; p < all_.pixels(); ++p) {
      bool evaluated = false;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!used_[i][p]) continue;
        if (!evaluated) evaluate(m, s, k, p, c), evaluated = true;
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
        if (!evaluated) evaluate(m, s, k, p, c), evaluated = true;
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

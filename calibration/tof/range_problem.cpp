#include "calibration/tof/range_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/tof/range_parts.h"
#include "calibration/tof/wiggling.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {
namespace {

constexpr double kLightSpeed_mps = 299792458.0;

/// The wiggling of the first N harmonics, its derivatives by them and by the range.
template <int N>
double of_harmonics(const std::vector<double>& turns_per_m, const std::array<double, 4>& harmonics,
                    double range_m, double* by_harmonic, double& by_range) {
  using Jet = ceres::Jet<double, N + 1>;
  Jet h[4];
  for (int k = 0; k < 4; ++k) h[k] = k < N ? Jet(harmonics[static_cast<std::size_t>(k)], k) : Jet(0);
  const Jet w = wiggling_error(turns_per_m, h, Jet(range_m, N));
  for (int k = 0; k < N; ++k) by_harmonic[k] = w.v[k];
  by_range = w.v[N];
  return w.a;
}

double of_harmonics(std::size_t count, const std::vector<double>& turns_per_m,
                    const std::array<double, 4>& harmonics, double range_m, double* by_harmonic,
                    double& by_range) {
  const auto evaluate = count == 1   ? of_harmonics<1>
                        : count == 2 ? of_harmonics<2>
                        : count == 3 ? of_harmonics<3>
                                     : of_harmonics<4>;
  return evaluate(turns_per_m, harmonics, range_m, by_harmonic, by_range);
}

}  // namespace

WigglingCurve::WigglingCurve(const std::vector<double>& turns_per_m, const std::array<double, 4>& harmonics,
                             int count, double from_m, double to_m)
    : turns_per_m_(turns_per_m),
      harmonics_(harmonics),
      count_(static_cast<std::size_t>(count)),
      from_m_(from_m),
      per_m_(0) {
  if (count == 0) return;
  // The shortest wave that counts is that of harmonic 16 or so: 60 nodes for each.
  double turns = 0;
  for (const double t : turns_per_m) turns = std::max(turns, t * (to_m - from_m));
  const auto nodes = static_cast<std::size_t>(std::clamp(1000 * turns, 100.0, 20000.0));
  per_m_ = static_cast<double>(nodes - 1) / (to_m - from_m);
  samples_.resize(nodes * (count_ + 2));
  for (std::size_t i = 0; i < nodes; ++i) {
    double* at = samples_.data() + i * (count_ + 2);
    at[0] = of_harmonics(count_, turns_per_m_, harmonics_, from_m_ + static_cast<double>(i) / per_m_, at + 2,
                         at[1]);
  }
}

double WigglingCurve::at(double range_m, double* by_harmonic, double& by_range) const {
  const double x = (range_m - from_m_) * per_m_;
  const std::size_t width = count_ + 2, nodes = samples_.size() / width;
  if (!(x >= 1 && x < static_cast<double>(nodes - 2)))
    return of_harmonics(count_, turns_per_m_, harmonics_, range_m, by_harmonic, by_range);
  const auto i = static_cast<std::size_t>(x);
  const double t = x - static_cast<double>(i);
  // Lagrange's cubic through four nodes.
  const double w[4] = {-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2,
                       -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6};
  const double* node = samples_.data() + (i - 1) * width;
  const auto value = [&](std::size_t k) {
    return w[0] * node[k] + w[1] * node[width + k] + w[2] * node[2 * width + k] + w[3] * node[3 * width + k];
  };
  by_range = value(1);
  for (std::size_t k = 0; k < count_; ++k) by_harmonic[k] = value(2 + k);
  return value(0);
}

WigglingCurve RangeProblem::wiggling(const RangeModel& m, const RangeState& s) const {
  // Distances and tilts move ranges by a little.
  const double margin = 0.02 * (spline_.to - spline_.from) + 0.01 * spline_.to;
  return {turns_per_m_, s.harmonics, m.spline ? 0 : m.harmonics, std::max(0.0, spline_.from - margin),
          spline_.to + margin};
}

int Spline::basis(double x, std::array<double, 4>& value, std::array<double, 4>& slope) const {
  using Jet = ceres::Jet<double, 1>;
  Jet first, b[4];
  models::TofMath<Jet>::tof_spline(Jet(x, 0), Jet(from), Jet(to), Jet(count - 3), first, b[0], b[1], b[2],
                                   b[3]);
  for (std::size_t k = 0; k < 4; ++k) value[k] = b[k].a, slope[k] = b[k].v[0];
  return static_cast<int>(first.a);
}

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
  const WigglingCurve w = wiggling(m, s);
  in_parts(64, [&](std::size_t part) {
    std::vector<double> r;
    Cell c;
    for (std::size_t p = part; p < all_.pixels(); p += 64) {
      r.clear();
      for (std::size_t k = 0; k < scenes_.size(); ++k) {
        evaluate(m, s, w, k, p, c);
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

void RangeProblem::evaluate(const RangeModel& m, const RangeState& s, const WigglingCurve& curve,
                            std::size_t k, std::size_t p, Cell& c) const {
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
    at = static_cast<std::size_t>(m.harmonics);
    wiggling = curve.at(range, c.global.data(), wiggling_slope);
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

}  // namespace rigor::calibration

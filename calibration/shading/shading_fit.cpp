#include "calibration/shading/shading_fit.h"

#include <ceres/autodiff_cost_function.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "calibration/core/held_parameters.h"
#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "rt-core/numbers.h"
#include "sensor-hal/models/one_source.h"

namespace rigor::calibration {
namespace {

enum : std::size_t { kScale, kCos4, kA2, kA4, kA6, kDu, kDv, kCount };
constexpr const char* kNames[kCount] = {"scale", "cos4_weight",  "a2",          "a4",
                                        "a6",    "centre_du_px", "centre_dv_px"};

bool fits(ShadingModel m, std::size_t i) {
  switch (i) {
    case kScale:
      return true;
    case kCos4:
      return m == ShadingModel::cos4;
    case kA2:
      return m >= ShadingModel::r2;
    case kA4:
      return m >= ShadingModel::r4;
    case kA6:
      return m >= ShadingModel::r6;
    default:
      return false;
  }
}

/// Modelled less measured light over `sigma`. The light of a cell is the mean over its area: by the four
/// points of Gauss' rule, exact for a cubic.
struct CellResidual {
  double x[4], y[4], light, sigma, per_px_x, per_px_y;
  int points;
  template <class T>
  bool operator()(const T* p, T* r) const {
    T v = T(0);
    for (int i = 0; i < points; ++i)
      v += models::LensMath<T>::vignetting_factor(
          T(x[i]) - p[kDu] * T(per_px_x), T(y[i]) - p[kDv] * T(per_px_y), p[kCos4], p[kA2], p[kA4], p[kA6]);
    r[0] = (p[kScale] * v / T(points) - T(light)) / T(sigma);
    return true;
  }
};

class Problem {
 public:
  Problem(const std::vector<ShadingCell>& cells, const CameraModel& camera, const ShadingFitOptions& options)
      : cells_(cells), camera_(camera), options_(options) {
    std::vector<double> sigmas;
    for (const ShadingCell& c : cells)
      if (c.sigma > 0) sigmas.push_back(c.sigma);
    if (!sigmas.empty()) {
      std::nth_element(sigmas.begin(), sigmas.begin() + static_cast<std::ptrdiff_t>(sigmas.size() / 2),
                       sigmas.end());
      typical_ = sigmas[sigmas.size() / 2];
    }
    for (const ShadingCell& c : cells) {
      brightest_ = std::max(brightest_, c.light);
      const auto ray = unproject(camera, {c.u_px, c.v_px});
      rays_.push_back(ray ? *ray : NormalisedPosition{kNaN, kNaN});
      if (ray) r_max_ = std::max(r_max_, std::hypot(ray->x, ray->y));
      without_ += !ray;
    }
  }
  [[nodiscard]] std::size_t without() const { return without_; }
  [[nodiscard]] double r_max() const { return r_max_; }
  [[nodiscard]] bool has_ray(std::size_t i) const { return std::isfinite(rays_[i].x); }
  /// Sector of the picture, 0 … n − 1.
  [[nodiscard]] int sector(std::size_t i, int n) const {
    const double turn = std::atan2(rays_[i].y, rays_[i].x) / (2 * std::numbers::pi) + 0.5;
    return std::min(n - 1, static_cast<int>(turn * n));
  }
  /// Uncertainties count in units of the typical one, so that residuals read as shares of the brightest
  /// light.
  [[nodiscard]] CellResidual cell(std::size_t i, bool plain) const {
    const ShadingCell& c = cells_[i];
    const double s = plain || typical_ == 0 ? 1 : c.sigma / typical_;
    CellResidual r{{rays_[i].x},      {rays_[i].y},      c.light, s * brightest_,
                   1 / camera_.fx_px, 1 / camera_.fy_px, 1};
    if (!(c.size_px > 0)) return r;
    const double step = c.size_px / std::sqrt(12.0);
    int n = 0;
    for (const auto& [du, dv] : {std::pair{-1, -1}, {1, -1}, {-1, 1}, {1, 1}})
      if (const auto ray = unproject(camera_, {c.u_px + du * step, c.v_px + dv * step})) {
        r.x[n] = ray->x, r.y[n] = ray->y;
        ++n;
      }
    if (n == 4) r.points = 4;
    if (n != 4) r.x[0] = rays_[i].x, r.y[0] = rays_[i].y;
    return r;
  }
  /// Measured less modelled, in units of the light on the axis.
  [[nodiscard]] double residual(const double* p, std::size_t i) const {
    double r;
    cell(i, true)(p, &r);
    return -r * brightest_ / p[kScale];
  }

  Result<LeastSquares::Outcome> fit(ShadingModel m, double* p, bool robust, bool centre,
                                    const std::function<bool(std::size_t)>& take) const {
    LeastSquares problem;
    std::vector<ParameterInfo> infos;
    const double r2 = r_max_ * r_max_;
    for (std::size_t i = 0; i < kCount; ++i) {
      ParameterInfo info;
      info.name = kNames[i];
      info.held = !fits(m, i) && !(centre && i >= kDu);
      // What changes the corners by five percent.
      const double cos2 = 1 / (1 + r2);
      info.resolution = i == kScale  ? 0.05 * std::abs(p[kScale])
                        : i == kCos4 ? 0.05 / std::max(1e-6, 1 - cos2 * cos2)
                        : i <= kA6   ? 0.05 / std::pow(r2, static_cast<double>(i - kA2 + 1))
                                     : 0.05 * camera_.fx_px;
      if (i == kCos4) info.lower = 0, info.upper = 1;
      infos.push_back(info);
    }
    problem.add_block(p, infos);
    for (std::size_t i = 0; i < cells_.size(); ++i)
      if (has_ray(i) && take(i))
        problem.add(
            new ceres::AutoDiffCostFunction<CellResidual, 1, kCount>(new CellResidual(cell(i, false))), {p},
            static_cast<std::uint32_t>(i));
    FitOptions o;
    o.robust = robust;
    o.reject_sigmas = options_.reject_sigmas;
    o.threads = 1;
    o.unit = "of the brightest light";
    o.stop = options_.stop;
    return problem.solve(o);
  }

 private:
  const std::vector<ShadingCell>& cells_;
  const CameraModel& camera_;
  const ShadingFitOptions& options_;
  std::vector<NormalisedPosition> rays_;
  double r_max_ = 0, typical_ = 0, brightest_ = 0;
  std::size_t without_ = 0;
};

}  // namespace

std::string_view shading_model_name(ShadingModel m) {
  static constexpr std::string_view kModelNames[] = {"none", "cos4", "r2", "r4", "r6"};
  return kModelNames[static_cast<std::size_t>(m)];
}

Result<ShadingModel> parse_shading_model(const std::string& name) {
  for (const ShadingModel m :
       {ShadingModel::none, ShadingModel::cos4, ShadingModel::r2, ShadingModel::r4, ShadingModel::r6})
    if (shading_model_name(m) == name) return m;
  return fail(ErrorCode::bad_input, "--model", "expected auto, none, cos4, r2, r4 or r6, got " + name);
}

Result<ShadingFit> fit_shading(const std::vector<ShadingCell>& cells, const CameraModel& camera,
                               const ShadingFitOptions& options) {
  std::vector<ShadingModel> models = options.models;
  const bool fisheye = camera.projection == Projection::kannala_brandt;
  if (models.empty())
    models = fisheye ? std::vector<ShadingModel>{ShadingModel::none, ShadingModel::cos4}
                     : std::vector<ShadingModel>{ShadingModel::none, ShadingModel::cos4, ShadingModel::r2,
                                                 ShadingModel::r4, ShadingModel::r6};
  if (fisheye && *std::max_element(models.begin(), models.end()) > ShadingModel::cos4)
    return fail(ErrorCode::bad_input, "--model",
                "expected none or cos4 for a fisheye (tan of the angle has no end at 90 degrees), got " +
                    std::string(shading_model_name(models.back())));
  Problem problem(cells, camera, options);
  if (cells.size() - problem.without() < 16)
    return fail(ErrorCode::bad_input, "",
                "expected 16 cells or more with a ray, got " +
                    std::to_string(cells.size() - problem.without()) +
                    ": does the base sensor model's picture size fit the flat field?");
  if (problem.r_max() < 0.02)
    return fail(ErrorCode::bad_input, "",
                "expected a picture that reaches at least 1 degree off the axis, got " +
                    std::to_string(problem.r_max()) + " rad: no fall-off can be seen there");
  double light = 0;
  for (const ShadingCell& c : cells) light = std::max(light, c.light);
  const auto fresh = [&](double* p) {
    std::fill(p, p + kCount, 0.0);
    p[kScale] = light;
  };
  const auto all = [](std::size_t) { return true; };

  ShadingFit out;
  // Outliers are what the most flexible model cannot explain; it may not bend for them.
  double flexible[kCount];
  fresh(flexible);
  const ShadingModel largest = *std::max_element(models.begin(), models.end());
  auto judged = problem.fit(largest, flexible, true, false, all);
  if (!judged) return tl::unexpected<Error>(judged.error());
  std::vector<bool> used(cells.size(), true);
  for (const std::uint32_t id : judged->rejected_ids) used[id] = false;
  const auto kept = [&](std::size_t i) { return static_cast<bool>(used[i]); };

  std::vector<Candidate> candidates;
  constexpr int kSectors = 8;
  for (const ShadingModel m : models) {
    double p[kCount];
    fresh(p);
    auto fitted = problem.fit(m, p, false, false, kept);
    if (!fitted) return tl::unexpected<Error>(fitted.error());
    Candidate c;
    c.name = std::string(shading_model_name(m));
    for (std::size_t i = 0; i < kCount; ++i) c.parameters += fits(m, i);
    double sum = 0;
    for (const double r : fitted->residuals) sum += r * r;
    c.rms = fitted->fit.residuals.rms;
    c.bic = bic(sum, static_cast<double>(fitted->residuals.size()), static_cast<std::size_t>(c.parameters));
    c.cross_validation = kNaN;
    std::vector<double> squares(kSectors, kNaN), counts(kSectors, 0);
    for (int k = 0; models.size() > 1 && k < kSectors && !options.stop.stop_requested(); ++k) {
      double q[kCount];
      fresh(q);
      if (!problem.fit(m, q, false, false,
                       [&](std::size_t i) { return used[i] && problem.sector(i, kSectors) != k; }))
        continue;
      double square = 0, number = 0;
      for (std::size_t i = 0; i < cells.size(); ++i) {
        if (!problem.has_ray(i) || !used[i] || problem.sector(i, kSectors) != k) continue;
        const double r = problem.residual(q, i);
        square += r * r, ++number;
      }
      if (number == 0) continue;
      squares[static_cast<std::size_t>(k)] = square / number;
      counts[static_cast<std::size_t>(k)] = number;
    }
    if (models.size() > 1) set_cross_validation(c, std::move(squares), std::move(counts));
    candidates.push_back(c);
  }
  const std::size_t chosen = choose_model(candidates);
  out.model = models[chosen];
  double p[kCount];
  fresh(p);
  auto final_fit = problem.fit(out.model, p, false, false, kept);
  if (!final_fit) return tl::unexpected<Error>(final_fit.error());
  FitResult& r = out.result;
  r = final_fit->fit;
  r.model = std::string(shading_model_name(out.model));
  r.candidates = candidates;
  r.interrupted = options.stop.stop_requested();
  for (WeakDirection& w : r.weak)
    w.cure =
        "record flat fields that reach the picture's corners, with less noise, or take a smaller model (r4)";
  out.vignetting = {p[kCos4], p[kA2], p[kA4], p[kA6]};
  for (std::size_t k = 0; k < judged->rejected_ids.size(); ++k) {
    const ShadingCell& c = cells[judged->rejected_ids[k]];
    char text[80];
    std::snprintf(text, sizeof text, "cell at (%.0f, %.0f) px", c.u_px, c.v_px);
    r.rejected.push_back({text, judged->fit.rejected[k].residual, judged->fit.rejected[k].sigmas});
  }
  r.residuals.rejected = r.rejected.size();
  drop_held(r);

  double square = 0, relative = 0, number = 0;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const double e = problem.has_ray(i) ? problem.residual(p, i) : kNaN;
    out.residual.push_back(e);
    out.fitted.push_back(cells[i].light / p[kScale] - e);
    if (!std::isfinite(e) || !used[i]) continue;
    square += e * e, relative += std::pow(e / out.fitted.back(), 2), ++number;
  }
  out.rms = std::sqrt(square / std::max(1.0, number));
  out.rms_relative = std::sqrt(relative / std::max(1.0, number));
  r.validity = {{"off_axis_tangent", 0, problem.r_max()}};
  if (problem.without() > 0)
    r.warnings.push_back(std::to_string(problem.without()) +
                         " cells lie where the lens has no ray: left out");

  // Where the light is centred: the model has it on the axis.
  if (out.model != ShadingModel::none) {
    double q[kCount];
    std::copy(p, p + kCount, q);
    if (auto centred = problem.fit(out.model, q, false, true, kept)) {
      out.centre_du_px = q[kDu], out.centre_dv_px = q[kDv];
      const Parameter* du = centred->fit.find(kNames[kDu]);
      const Parameter* dv = centred->fit.find(kNames[kDv]);
      out.centre_sigma_px = std::max(du->sigma, dv->sigma);
      double s = 0;
      for (std::size_t i = 0; i < cells.size(); ++i)
        if (used[i] && problem.has_ray(i)) s += std::pow(problem.residual(q, i), 2);
      out.centred_rms = std::sqrt(s / std::max(1.0, number));
      const double off = std::hypot(out.centre_du_px, out.centre_dv_px);
      if (off > 4 * out.centre_sigma_px && off > 0.005 * camera.width_px) {
        char text[300];
        std::snprintf(text, sizeof text,
                      "the light is centred %+.1f, %+.1f px (± %.1f) off the principal point, and the "
                      "simulator's model "
                      "has it there: RMS %.2f %%, with a centre of its own it would be %.2f %%",
                      out.centre_du_px, out.centre_dv_px, out.centre_sigma_px, 100 * out.rms,
                      100 * out.centred_rms);
        r.warnings.emplace_back(text);
      }
    }
  }
  // A polynomial may turn up again, or below zero, beyond the cells: the picture's corner is a little farther
  // out.
  const double corner = problem.r_max() * 1.05;
  const auto value = [&](double t) {
    return models::LensMath<double>::vignetting_factor(t, 0, p[kCos4], p[kA2], p[kA4], p[kA6]);
  };
  double last = value(0);
  for (int i = 1; i <= 50; ++i) {
    const double v = value(corner * i / 50);
    if (v > last + 0.01 || v <= 0) {
      r.warnings.emplace_back(
          v <= 0 ? "the fitted light is 0 before the corner of the picture"
                 : "the fitted light rises again towards the corners: that is the polynomial, not "
                   "the lens");
      break;
    }
    last = v;
  }
  return out;
}

}  // namespace rigor::calibration

#include "calibration/lidar/lidar_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/philox.h"

namespace rigor::calibration {
namespace {

using Eigen::Index;

void append(FitResult& to, const FitResult& from) {
  const Index n = to.covariance.rows(), m = static_cast<Index>(from.parameters.size());
  to.parameters.insert(to.parameters.end(), from.parameters.begin(), from.parameters.end());
  to.covariance.conservativeResizeLike(Eigen::MatrixXd::Zero(n + m, n + m));
  if (m > 0) to.covariance.bottomRightCorner(m, m) = from.covariance;
  const auto join = [](auto& a, const auto& b) { a.insert(a.end(), b.begin(), b.end()); };
  join(to.weak, from.weak);
  join(to.candidates, from.candidates);
  join(to.warnings, from.warnings);
  join(to.not_identifiable, from.not_identifiable);
  join(to.validity, from.validity);
  join(to.rejected, from.rejected);
  to.interrupted = to.interrupted || from.interrupted;
}

/// Draws of the simulator's noise and rounding, one for each return.
class Twin {
 public:
  explicit Twin(const models::LidarModel& model)
      : m_(model), key_(models::channel_key(1, models::channel_id_from_name("twin"))) {}
  [[nodiscard]] double remission(const LidarReturn& r) const {
    const double e =
        remission_from_units(m_.remission, static_cast<double>(r.remission), static_cast<double>(r.range_m));
    return std::isfinite(e) ? e : 1;
  }
  [[nodiscard]] double noise_m(std::size_t i, double e) const {
    const double sigma =
        e > 1 && m_.noise.retro_sigma_m > 0
            ? m_.noise.retro_sigma_m
            : (m_.noise.scale_m > 0
                   ? Math::lidar_range_sigma_m(std::max(e, 1e-9), m_.noise.floor_m, m_.noise.scale_m,
                                               m_.noise.offset, m_.noise.exponent)
                   : m_.noise.floor_m);
    return sigma * Draws::normal_quantile(Draws::unit_from_bits(words(i)[0]));
  }
  [[nodiscard]] double rounded(double range_m) const {
    return m_.range.step_m > 0 ? Math::lidar_quantise(range_m, m_.range.step_m) : range_m;
  }
  /// Anywhere between two steps.
  [[nodiscard]] double place_m(std::size_t i) const {
    return Draws::unit_from_bits(words(i)[1]) * m_.range.step_m;
  }

 private:
  using Draws = models::NoiseMath<double>;
  using Math = models::LidarMath<double>;
  [[nodiscard]] std::array<std::uint32_t, 4> words(std::size_t i) const {
    const auto w =
        models::draw_words(key_, models::NoiseEffect::lidar_echo, i >> 32, static_cast<std::uint32_t>(i));
    return {w[0], w[1], w[2], w[3]};
  }
  const models::LidarModel& m_;
  models::PhiloxKey key_;
};

/// The device's noise and its twin's at the same remissions, each about the mean of its cell: what both lose
/// by that mean is the same.
void draw_twin(const LidarReturns& returns, LidarFit& fit) {
  const Twin twin(fit.model);
  const auto& e = fit.noise->shot_residual_m;
  const std::size_t every = std::max<std::size_t>(1, e.size() / 100'000);
  double dof = 0, shots = 0;
  for (const NoiseCell& c : fit.noise->cells)
    if (c.used) dof += c.dof;
  for (const float x : e) shots += std::isfinite(x);
  const double lost = shots > 0 ? std::sqrt(std::min(1.0, dof / shots)) : 1;
  for (std::size_t i = 0; i < e.size(); i += every) {
    if (!std::isfinite(e[i])) continue;
    const double at = twin.place_m(i);
    fit.shots_m.push_back(static_cast<double>(e[i]));
    fit.twin_m.push_back(twin.rounded(at + lost * twin.noise_m(i, twin.remission(returns.all[i]))) - at);
  }
  if (!fit.bias) return;
  for (std::size_t i = 0; i < returns.all.size(); i += every) {
    if (!fit.bias->used[i] || fit.planes.label[i] < 0) continue;
    const LidarReturn& r = returns.all[i];
    // By the device's own remission: a twin's on the fitted wall, whose reflectance is not told, has none.
    const double told = twin.remission(r);
    const double range = static_cast<double>(r.range_m) - static_cast<double>(fit.bias->residual_m[i]);
    fit.walls_m.push_back(static_cast<double>(fit.bias->residual_m[i]));
    fit.walls_twin_m.push_back(twin.rounded(range + twin.noise_m(i, told)) - range);
  }
}

/// Values by parameters' names into the model.
void put_into(models::LidarModel& m, const FitResult& f, const std::optional<BiasFit>& bias,
              double limit_range_m) {
  const auto value = [&](const std::string& name, double& to) {
    if (const Parameter* p = f.find(name); p && std::isfinite(p->value)) to = p->value;
  };
  value("noise_floor_m", m.noise.floor_m);
  value("noise_scale_m", m.noise.scale_m);
  value("noise_offset", m.noise.offset);
  value("noise_exponent", m.noise.exponent);
  value("retro_sigma_m", m.noise.retro_sigma_m);
  value("remission_noise", m.remission.noise);
  value("remission_scale", m.remission.scale);
  value("minimum_remission", m.detection.minimum_remission);
  value("limit_remission", m.detection.limit_remission);
  if (limit_range_m > 0) m.detection.limit_range_m = limit_range_m;
  for (std::size_t b = 0; b < m.scan.beams.size(); ++b)
    value("remission_gain[" + std::to_string(b) + "]", m.scan.beams[b].remission_gain);
  if (!bias) return;
  const BiasModel& k = bias->model;
  value("remission_bias_m", m.range.remission_bias_m);
  value("incidence_bias_m", m.range.incidence_bias_m);
  value("range_scale", m.range.scale);
  // Errors in the mean that the model has not were taken as none.
  if (!k.walk) m.range.remission_bias_m = 0;
  if (!k.oblique) m.range.incidence_bias_m = 0;
  if (k.offset || k.beams) m.range.bias_m = 0;
  for (std::size_t b = 0; b < m.scan.beams.size(); ++b) {
    models::LidarBeam& beam = m.scan.beams[b];
    const Parameter* p = f.find("beam_bias_m[" + std::to_string(b) + "]");
    if (k.offset) beam.range_bias_m = bias->errors[b].bias_m;
    if (p && std::isfinite(p->sigma)) beam.range_bias_m = bias->errors[b].bias_m;
    beam.elevation_rad += bias->errors[b].elevation_rad;
    beam.azimuth_rad += bias->errors[b].azimuth_rad;
  }
}

}  // namespace

Result<LidarFit> fit_lidar(const LidarReturns& returns, const models::LidarModel& sensor_model,
                           const LidarFitOptions& options) {
  if (returns.all.empty())
    return fail(ErrorCode::bad_input, "", "expected returns, got a recording without any");
  if (sensor_model.scan.kind != models::LidarScanKind::rotor)
    return fail(
        ErrorCode::bad_input, "--base",
        "expected a LiDAR whose beams turn about one axis (scan.kind rotor), got a rosette or a pattern");
  LidarFit out;
  out.model = sensor_model;
  FitResult& f = out.result;
  f.covariance = Eigen::MatrixXd::Zero(0, 0);
  if (returns.duplicate_scans > 0)
    f.warnings.push_back(std::to_string(returns.duplicate_scans) +
                         " scans were equal to others to the last bit and left out: they tell nothing new");
  if (returns.unknown_beams > 0)
    f.warnings.push_back(std::to_string(returns.unknown_beams) +
                         " returns of beams that the sensor model does not have (" +
                         std::to_string(sensor_model.scan.beams.size()) +
                         " beams) were left out: is it the right sensor model?");
  if (returns.scans < 2)
    f.warnings.push_back(
        "one scan: the noise is that of neighbouring shots on smooth surfaces, whose unevenness is in it");

  NoiseFitOptions noise_options;
  noise_options.model = options.noise_model;
  auto noise = fit_range_noise(returns, sensor_model, noise_options);
  if (noise)
    out.noise = std::move(*noise);
  else if (noise.error().where == "--noise-model")
    return tl::unexpected<Error>(noise.error());
  else
    f.not_identifiable.emplace_back("noise", noise.error().message);
  if (options.progress) options.progress(0.2, out.noise ? out.noise->sigma_m : 0);

  out.planes =
      options.surveyed.empty() ? find_planes(returns, sensor_model.scan, options.search) : PlaneSearch{};
  if (!options.surveyed.empty()) {
    std::vector<float> ranges;
    for (const LidarReturn& r : returns.all) ranges.push_back(r.range_m);
    std::nth_element(ranges.begin(), ranges.begin() + static_cast<std::ptrdiff_t>(ranges.size() / 2),
                     ranges.end());
    out.planes = assign_planes(returns, sensor_model.scan, options.surveyed,
                               options.search.tolerance * static_cast<double>(ranges[ranges.size() / 2]));
  }
  if (options.progress) options.progress(0.3, 0);

  BiasFitOptions bias_options;
  bias_options.surveyed = !options.surveyed.empty();
  bias_options.stop = options.stop;
  if (options.progress)
    bias_options.progress = [&](double share, double rms) { options.progress(0.3 + 0.7 * share, rms); };
  if (out.noise)
    bias_options.sigma_m = [m = out.noise->model, step = sensor_model.range.step_m](double e) {
      const double s = m.sigma_m(e);
      return std::sqrt(s * s + step * step / 12);
    };
  if (out.noise)
    if (const auto v = remission_noise(*out.noise, sensor_model))
      bias_options.remission_sigma = [relative = v->relative, unit = sensor_model.remission.step /
                                                                     sensor_model.remission.scale](double e) {
        return std::sqrt(relative * relative * e * e + unit * unit / 12);
      };
  if (options.model != "auto") {
    std::string names;
    for (const BiasModel& m : bias_models(sensor_model.scan.beams.size(), scans_one_plane(sensor_model.scan),
                                          bias_options.surveyed)) {
      if (m.name == options.model) bias_options.models = {m};
      names += (names.empty() ? "" : ", ") + m.name;
    }
    if (bias_options.models.empty())
      return fail(ErrorCode::bad_input, "--model",
                  "expected auto or one of " + names + ", got " + options.model);
  }
  double limit_range_m = 0;
  auto bias = fit_biases(returns, sensor_model, out.planes, bias_options);
  if (bias) {
    out.bias = std::move(*bias);
    append(f, out.bias->result);
    f.model = out.bias->model.name;
    f.residuals = out.bias->result.residuals;
    f.scale = out.bias->result.scale;
    const RemissionFit remission =
        fit_remission(returns, sensor_model, out.planes, *out.bias, out.noise ? &*out.noise : nullptr);
    if (out.noise) append(f, out.noise->result);
    append(f, remission.result);
    limit_range_m = remission.limit_range_m;
  } else {
    if (!out.noise) return tl::unexpected<Error>(bias.error());
    f.not_identifiable.emplace_back(sensor_model.scan.beams.size() > 1 ? "beam_bias_m" : "range_bias_m",
                                    bias.error().message);
    append(f, out.noise->result);
    f.model = "noise only";
    f.residuals = out.noise->result.residuals;
    f.scale = out.noise->result.scale;
  }
  if (options.surveyed.empty())
    f.not_identifiable.emplace_back(
        "range_scale", "walls that are found in the data scale with the ranges: survey them (--targets)");
  if (out.noise && f.model != "noise only") f.model += ", noise " + out.noise->result.model;
  put_into(out.model, f, out.bias, limit_range_m);
  if (out.noise) draw_twin(returns, out);
  return out;
}

}  // namespace rigor::calibration

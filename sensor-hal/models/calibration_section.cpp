#include "sensor-hal/models/calibration_section.h"

#include <array>
#include <cmath>
#include <cstdio>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"

namespace rigor {
namespace {

std::string exact(double v) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", v);
  return text;
}

}  // namespace

CalibrationSection read_calibration(const ConfigNode& sensor_model) {
  CalibrationSection s;
  if (!sensor_model.has("calibration")) return s;
  const ConfigNode n = sensor_model.map("calibration");
  (void)n.integer("version", {.min = 1, .max = 1});
  s.kind = n.text("kind");
  s.model = n.text("model");
  for (const ConfigNode& p : n.list("parameters")) {
    CalibrationSection::Parameter parameter;
    parameter.name = p.text("name");
    parameter.value = p.number("value");
    parameter.sigma = p.number("sigma", {.min = 0});
    parameter.path = p.text_or("path", "");
    parameter.scale = p.number_or("scale", 1);
    p.finish();
    s.parameters.push_back(std::move(parameter));
  }
  const std::size_t count = s.parameters.size();
  s.covariance = n.numbers("covariance", count * (count + 1) / 2);
  for (std::size_t i = 0; i < count; ++i)
    if (!(s.covariance_of(i, i) >= 0))
      throw n.error("covariance", "expected a variance of 0 or more for " + s.parameters[i].name + ", got " +
                                      exact(s.covariance_of(i, i)));
  const ConfigNode r = n.map_or_absent("residuals");
  s.residual_unit = r.text_or("unit", "");
  s.residual_rms = r.number_or("rms", 0, {.min = 0});
  for (const char* key : {"count", "rejected", "median_absolute", "p95_absolute", "largest"})
    (void)r.number_or(key, 0);
  r.finish();
  const ConfigNode v = n.map_or_absent("validity");
  for (const std::string& key : v.keys()) {
    const auto span = v.numbers(key, 2);
    s.validity[key] = {span[0], span[1]};
  }
  v.finish();
  for (const ConfigNode& f : n.list_or_empty("recordings")) {
    s.recordings.push_back({f.text("file"), f.text("sha256")});
    f.finish();
  }
  const ConfigNode u = n.map_or_absent("not_identifiable");
  for (const std::string& key : u.keys()) s.not_identifiable[key] = u.text(key);
  u.finish();
  for (const ConfigNode& w : n.list_or_empty("warnings")) s.warnings.push_back(w.as_text());
  s.interrupted = n.flag_or("interrupted", false);
  n.finish();
  return s;
}

Result<std::vector<ConfigOverride>> draw_parameters(const CalibrationSection& section, std::uint64_t seed) {
  const std::size_t n = section.parameters.size();
  // Cholesky of the correlation matrix: a parameter without variance, or one that others fix, gets a zero
  // row. Rounding may leave a pivot just below zero.
  std::vector<double> l(n * n, 0);
  for (std::size_t j = 0; j < n; ++j) {
    const double sj = std::sqrt(section.covariance_of(j, j));
    if (sj == 0) continue;
    for (std::size_t i = j; i < n; ++i) {
      const double si = std::sqrt(section.covariance_of(i, i));
      if (si == 0) continue;
      double sum = section.covariance_of(i, j) / (si * sj);
      for (std::size_t k = 0; k < j; ++k) sum -= l[i * n + k] * l[j * n + k];
      if (i == j) {
        if (sum < -1e-6)
          return fail(ErrorCode::bad_input, "calibration.covariance",
                      "expected a covariance matrix, got one that is not positive semi-definite at " +
                          section.parameters[j].name);
        l[j * n + j] = sum > 1e-12 ? std::sqrt(sum) : 0;
      } else if (l[j * n + j] > 0) {
        l[i * n + j] = sum / l[j * n + j];
      }
    }
  }
  std::vector<double> z(n);
  const models::PhiloxKey key = models::channel_key(seed, models::channel_id_from_name(section.kind));
  using Noise = models::NoiseMath<double>;
  for (std::size_t i = 0; i < n; ++i) {
    const auto words =
        models::draw_words(key, models::NoiseEffect::calibration_draw, 0, static_cast<std::uint32_t>(i));
    z[i] = Noise::normal_quantile(Noise::unit_from_bits(words[0]));
  }
  std::vector<ConfigOverride> out;
  for (std::size_t i = 0; i < n; ++i) {
    const auto& p = section.parameters[i];
    if (p.path.empty()) continue;
    double step = 0;
    for (std::size_t k = 0; k <= i; ++k) step += l[i * n + k] * z[k];
    const double value = p.value + std::sqrt(section.covariance_of(i, i)) * step;
    out.push_back({p.path, exact(p.scale * value)});
  }
  return out;
}

Result<ConfigNode> load_sensor_model(const std::filesystem::path& file, std::uint64_t draw) {
  auto root = ConfigDocument::load(file);
  if (!root || draw == 0) return root;
  auto section = catch_config([&] { return read_calibration(*root); });
  if (!section) return tl::unexpected<Error>(section.error());
  if (section->kind.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected a section `calibration` with a covariance to draw a device from, found none: fit "
                "the sensor model with `rigor calibrate`");
  auto overrides = draw_parameters(*section, draw);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  return ConfigDocument::load(file, *overrides);
}

}  // namespace rigor

#include "calibration/procedures/photon_calibration.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "bench/console/progress.h"
#include "calibration/photon/photon_fit.h"
#include "calibration/procedures/photon_figures.h"
#include "calibration/procedures/photon_input.h"
#include "sensor-hal/models/camera_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

/// The sensor that the sensor model describes: what was fitted, and the base for what was not.
EmvaNoise noise_of(const PhotonFit& fit, const EmvaNoise* base) {
  EmvaNoise n = base ? *base : EmvaNoise{};
  if (base) {
    n.black_level_dn = std::ldexp(n.black_level_dn, fit.statistics.bits - n.adc_bits);
  } else {
    n.read_noise_e = n.dark_current_e_per_s = n.dsnu_e = n.prnu = n.black_level_dn = 0;
    n.full_well_e = 1e9;
  }
  n.adc_bits = fit.statistics.bits;
  const auto take = [&](const char* name, double& to) {
    if (const Parameter* p = fit.result.find(name)) to = p->value;
  };
  take("system_gain_dn_per_e", n.system_gain_dn_per_e);
  take("black_level_dn", n.black_level_dn);
  take("read_noise_e", n.read_noise_e);
  take("dark_current_e_per_s", n.dark_current_e_per_s);
  take("dsnu_e", n.dsnu_e);
  take("prnu", n.prnu);
  take("full_well_e", n.full_well_e);
  if (fit.response_c2_seen) n.response_c2 = n.response_c3 = 0;
  take("response_c2", n.response_c2);
  take("response_c3", n.response_c3);
  if (fit.converter_saturates && n.system_gain_dn_per_e > 0)
    n.full_well_e =
        std::max(n.full_well_e, (fit.statistics.max_dn - n.black_level_dn) / n.system_gain_dn_per_e);
  return n;
}

Result<SensorModelRecipe> recipe_of(const PhotonCalibrationOptions& options, const FrameStacks& stacks,
                                    PhotonFit& fit) {
  SensorModelRecipe r;
  r.kind = "camera";
  if (!options.sensor_model) return r;
  const auto base = load_camera(options.base);
  if (!base) return tl::unexpected<Error>(base.error());
  const EmvaNoise& old = base->model.noise;
  const double gain_db = stacks.levels().front().settings.gain_db;
  const auto put = [&](const std::string& key, double value) {
    r.set.emplace_back("noise." + key, exact_text(value));
  };
  r.set.emplace_back("noise.adc_bits", std::to_string(fit.statistics.bits));
  for (const Parameter& p : fit.result.parameters) {
    static const std::set<std::string> keys{"system_gain_dn_per_e",
                                            "black_level_dn",
                                            "read_noise_e",
                                            "dark_current_e_per_s",
                                            "dark_doubling_k",
                                            "dsnu_e",
                                            "prnu",
                                            "full_well_e",
                                            "hot_pixel_share",
                                            "hot_pixel_dark_e_per_s",
                                            "response_c2",
                                            "response_c3"};
    if (keys.count(p.name) == 0) continue;
    const double scale = p.name == "system_gain_dn_per_e" ? std::pow(10, -gain_db / 20) : 1;
    put(p.name, scale * p.value);
    r.places.push_back({p.name, "noise." + p.name, scale});
  }
  const double black = fit.result.find("black_level_dn")
                           ? fit.result.find("black_level_dn")->value
                           : std::ldexp(old.black_level_dn, fit.statistics.bits - old.adc_bits);
  if (!fit.result.find("black_level_dn")) put("black_level_dn", black);
  // Found straight: what the base says of a bend holds no more.
  if (fit.response_c2_seen && fit.response.terms < 2) {
    if (fit.response.terms < 1 && old.response_c2 != 0) put("response_c2", 0);
    if (old.response_c3 != 0) put("response_c3", 0);
  }
  if (fit.result.find("dark_current_e_per_s")) {
    put("dark_reference_c", fit.temperature_reference_c);
    put("temperature_c", fit.temperature_reference_c);
  }
  if (const Parameter* k = fit.result.find("system_gain_dn_per_e"); k && !fit.result.find("full_well_e")) {
    const double least = (fit.statistics.max_dn - black) / k->value;
    if (fit.converter_saturates && old.full_well_e < least) {
      put("full_well_e", least);
      fit.result.warnings.push_back(
          "the sensor model's full well is the least that it can be: the converter is full first");
    }
  }
  return r;
}

}  // namespace

Result<CalibrationResult> calibrate_photon(const PhotonCalibrationOptions& options, const StopToken& stop) {
  if (options.sensor_model && options.base.empty())
    return fail(
        ErrorCode::bad_input, "--base",
        "expected the sensor model of the camera, whose lens and size a photon transfer does not know: "
        "give it with "
        "--base, as in --base configs/sensors/industrial-global-shutter.yaml");
  ProgressTask reading("read", 0, "frames");
  FrameStacks stacks;
  int bits = options.bits;
  bool mosaic = options.mosaic;
  std::size_t number = 0;
  const auto input = read_photon_pictures(options, options.input, [&](const PhotonPicture& p) -> Status {
    reading.set(static_cast<double>(++number));
    if (options.bits > p.bits && p.bits > 0)
      return fail(
          ErrorCode::bad_input, "--bits",
          fmt::format("expected at most the {} bits of {}, got {}", p.bits, p.frame.name, options.bits));
    if (options.bits == 0) bits = std::max(bits, p.bits);
    mosaic = mosaic || (p.mosaic && !options.grey);
    return stacks.add(p.frame, p.pixels, p.width_px, p.height_px);
  });
  if (!input) return tl::unexpected<Error>(input.error());
  reading.finish();
  PhotonFitOptions fit_options;
  fit_options.model = options.model;
  fit_options.bits = bits;
  fit_options.mosaic = options.grey ? 0 : mosaic ? 1 : -1;
  fit_options.stop = stop;
  std::optional<ProgressTask> fitting(std::in_place, "fit");
  auto fit = fit_photon(stacks, fit_options);
  fitting.reset();
  if (!fit) return tl::unexpected<Error>(fit.error());
  if (bits == 0 && fit->statistics.bits > 8)
    fit->result.warnings.push_back(
        fmt::format("the converter's bits are taken from the largest value, {}: {} bits (--bits says it)",
                    stacks.largest() / fit->statistics.step, fit->statistics.bits));
  for (const std::string& w : input->warnings) fit->result.warnings.push_back(w);

  CalibrationResult result;
  result.title = "Photon transfer";
  result.inputs = input->files;
  auto recipe = recipe_of(options, stacks, *fit);
  if (!recipe) return tl::unexpected<Error>(recipe.error());
  result.recipe = std::move(*recipe);
  result.fit = fit->result;
  std::optional<EmvaNoise> base;
  if (!options.base.empty())
    if (const auto sensor_model = load_camera(options.base)) base = sensor_model->model.noise;
  const std::vector<NoisePair> twins = noise_twins(stacks, *fit, noise_of(*fit, base ? &*base : nullptr), 1);
  result.figures = photon_figures(stacks, *fit, twins);
  nlohmann::json& more = result.details.json();
  more["adc_bits"] = fit->statistics.bits;
  if (fit->linearity_error) more["linearity_error_percent"] = 100 * *fit->linearity_error;
  if (fit->response_exponent) {
    more["response_exponent"] = *fit->response_exponent;
    more["response_exponent_sigma"] = *fit->response_exponent_sigma;
  }
  if (fit->response_c2_seen) {
    more["response_c2_alone"] = {{"value", *fit->response_c2_seen}, {"sigma", *fit->response_c2_seen_sigma}};
    more["level_flicker_percent"] = 100 * *fit->level_flicker;
  }
  for (const bool light : {false, true}) {
    // EMVA 1288 release 4: of rows, of columns, of pixels.
    const PatternSplit& split = light ? fit->statistics.light_split : fit->statistics.dark_split_dn2;
    if (!split.pixel.valid) continue;
    auto& to = more[light ? "prnu_split_percent" : "dsnu_split_dn"];
    for (const auto& [name, v] :
         {std::pair{"row", split.row}, {"column", split.column}, {"pixel", split.pixel}}) {
      const double value = std::sqrt(std::max(0.0, v.value)) * (light ? 100 : 1);
      // Below its noise it is an upper bound and no value.
      if (v.valid && v.value > 3 * v.sigma)
        to[name] = {{"value", value}, {"sigma", value * 0.5 * v.sigma / v.value}};
      else if (v.valid)
        to[name] = {{"value", nullptr},
                    {"below", std::sqrt(std::max(0.0, v.value) + 2 * v.sigma) * (light ? 100 : 1)}};
    }
  }
  for (const NoisePair& t : twins)
    more["twin"].push_back({{"level", t.level},
                            {"signal_dn", t.signal_dn},
                            {"sigma_dn", t.real_sigma_dn},
                            {"twin_sigma_dn", t.twin_sigma_dn},
                            {"quantiles", kNoiseQuantiles},
                            {"deviations_dn", t.real_quantiles_dn},
                            {"twin_deviations_dn", t.twin_quantiles_dn}});
  const Parameter* gain = fit->result.find("system_gain_dn_per_e");
  const Parameter* read = fit->result.find("read_noise_e");
  if (gain && fit->saturation_signal_dn) {
    const double capacity = *fit->saturation_signal_dn / gain->value;
    more["saturation_capacity_e"] = capacity;
    more["snr_max"] = std::sqrt(capacity);
    if (read)
      more["dynamic_range_db"] =
          20 * std::log10(capacity / std::hypot(read->value, 1 / (std::sqrt(12.0) * gain->value)));
  }
  if (gain && read) {
    // Foi et al.: var = a x + b of x in [0, 1].
    const double range = fit->statistics.max_dn - fit->black_dn;
    more["poisson_gaussian"] = {{"a", gain->value / range},
                                {"b", (std::pow(gain->value * read->value, 2) + 1.0 / 12) / (range * range)}};
  }
  more["levels"] = nlohmann::json::array();
  for (std::size_t k = 0; k < fit->statistics.points.size(); ++k) {
    const LevelPoint& p = fit->statistics.points[k];
    const PhotonLevel& l = stacks.levels()[p.level];
    more["levels"].push_back(
        {{"light", l.settings.light},
         {"exposure_s", l.settings.exposure_s},
         {"phase", p.phase},
         {"frames", p.frames},
         {"mean_dn", p.mean_dn},
         {"variance_dn2", p.frames > 1 ? nlohmann::json(p.variance_dn2) : nlohmann::json(nullptr)},
         {"used", !fit->in_range.empty() && static_cast<bool>(fit->in_range[k])},
         {"why_not", p.why}});
  }
  if (!read)
    result.record_next.push_back(
        "dark frames with the lens closed, the black level raised until no pixel reads 0, two or more at "
        "each of several "
        "exposure times");
  if (!fit->result.find("full_well_e") && !fit->converter_saturates)
    result.record_next.push_back(
        "even light at exposures up to and beyond saturation, two frames or more of each");
  result.base = options.base;
  return result;
}

}  // namespace rigor

#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <set>

#include "calibration/photon/photon_fit.h"
#include "cli/calibrate/calibrate.h"
#include "cli/calibrate/photon_input.h"
#include "rt-core/stop.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/philox.h"

namespace rigor {
namespace {

using namespace calibration;

struct CalibratePhotonOptions : CalibrateOptions {
  PhotonInputOptions input;
  int bits = 0;
  bool mosaic = false, grey = false;
};

/// The sensor that the sheet describes, as far as the fit knows it.
EmvaNoise noise_of(const PhotonFit& fit) {
  EmvaNoise n{};
  n.read_noise_e = n.dark_current_e_per_s = n.dsnu_e = n.prnu = 0;
  n.adc_bits = fit.statistics.bits;
  n.full_well_e = 1e9;
  n.black_level_dn = fit.black_dn;
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
  return n;
}

/// Temporal mean and variance of a simulated level whose mean is that of a measured one.
std::pair<double, double> twin_of(const EmvaNoise& n, double electrons, int frames, std::uint64_t index) {
  using Noise = models::NoiseMath<double>;
  const models::PhiloxKey key = models::channel_key(1, models::channel_id_from_name("twin"));
  const double max_dn = std::ldexp(1.0, n.adc_bits) - 1;
  constexpr std::uint32_t kPixels = 4096;
  double mean = 0, variance = 0;
  for (std::uint32_t i = 0; i < kPixels; ++i) {
    const auto fixed = models::draw_words(key, models::NoiseEffect::camera_fixed_pattern, 0, i);
    const double gain = 1 + n.prnu * Noise::normal_quantile(Noise::unit_from_bits(fixed[0]));
    const double offset = n.dsnu_e * Noise::normal_quantile(Noise::unit_from_bits(fixed[1]));
    double sum = 0, square = 0;
    for (int f = 0; f < frames; ++f) {
      const auto w = models::draw_words(key, models::NoiseEffect::camera_shot_and_read,
                                        index * 1000 + static_cast<std::uint64_t>(f), i);
      const double shot =
          Noise::poisson_quantile(std::max(0.0, electrons * gain), Noise::unit_from_bits(w[0]));
      const double e = Noise::emva_collected_electrons(shot, n.full_well_e, offset, n.read_noise_e,
                                                       Noise::normal_quantile(Noise::unit_from_bits(w[1])));
      const double y =
          Noise::emva_quantise(Noise::emva_analogue_dn(e, n.system_gain_dn_per_e, n.black_level_dn), max_dn);
      sum += y, square += y * y;
    }
    mean += sum / frames / kPixels;
    variance += (square - sum * sum / frames) / (frames - 1) / kPixels;
  }
  return {mean, variance};
}

std::vector<Figure> figures_of(const FrameStacks& stacks, const PhotonFit& fit) {
  std::vector<Figure> figures;
  const auto& st = fit.statistics;
  const bool transfer = !fit.curve_signal_dn.empty();
  if (transfer) {
    Figure ptc{.kind = Figure::Kind::series,
               .title = "Photon transfer",
               .caption =
                   "Temporal variance over the signal. The line is the fit, the thin ones two standard "
                   "uncertainties beside it; its slope is the gain K. Beyond 70 % of the saturation nothing "
                   "counts.",
               .x_label = "signal above black [DN]",
               .y_label = "temporal variance [DN²]"};
    Series used{"measured", {}, {}, false}, out{"left out", {}, {}, false},
        twin{"simulated twin", {}, {}, false};
    Series line{"fit", {}, {}, true}, low{"", {}, {}, true}, high{"± 2 sigma", {}, {}, true};
    Figure twins{
        .kind = Figure::Kind::series,
        .title = "Simulated twin beside the sensor",
        .caption =
            "Noise of a simulated sensor with the fitted parameters at the same levels, over the noise "
            "that was measured. 1: alike.",
        .x_label = "signal above black [DN]",
        .y_label = "noise of the twin / of the sensor"};
    Series ratio{"", {}, {}, false}, one{"", {}, {}, true};
    const EmvaNoise noise = noise_of(fit);
    const bool complete = fit.result.find("read_noise_e") != nullptr;
    for (std::size_t k = 0; k < st.points.size(); ++k) {
      const LevelPoint& p = st.points[k];
      if (p.frames < 2 || p.pixels < 1) continue;
      Series& s = fit.in_range[k] ? used : out;
      const double signal = p.mean_dn - fit.black_dn;
      s.x.push_back(signal), s.y.push_back(p.variance_dn2);
      if (!fit.in_range[k] || !complete) continue;
      const auto [m, v] =
          twin_of(noise, std::max(0.0, signal) / noise.system_gain_dn_per_e, std::min(p.frames, 16), k);
      twin.x.push_back(m - fit.black_dn), twin.y.push_back(v);
      if (p.variance_dn2 > 0) ratio.x.push_back(signal), ratio.y.push_back(std::sqrt(v / p.variance_dn2));
    }
    line.x = low.x = high.x = fit.curve_signal_dn;
    line.y = fit.curve_variance_dn2;
    for (std::size_t i = 0; i < line.y.size(); ++i) {
      low.y.push_back(line.y[i] - 2 * fit.curve_sigma_dn2[i]);
      high.y.push_back(line.y[i] + 2 * fit.curve_sigma_dn2[i]);
    }
    ptc.series = {used, out, line, low, high, twin};
    figures.push_back(ptc);
    if (!ratio.x.empty()) {
      one.x = {0, *std::max_element(ratio.x.begin(), ratio.x.end())};
      one.y = {1, 1};
      twins.series = {ratio, one};
      figures.push_back(twins);
    }
  }
  if (!fit.pairs.empty()) {
    Figure pairs{
        .kind = Figure::Kind::series,
        .title = "Scatter between exposures",
        .caption =
            "Variance between two exposures of the same pixel, for pixels alike in brightness, over "
            "their sum; the lines are the fit. Photon noise alone would be straight, and the same for "
            "all pairs.",
        .x_label = "sum of both [DN]",
        .y_label = "variance [DN²]"};
    std::set<std::string> names;
    for (const PairBin& b : fit.pairs) names.insert(b.pair);
    for (const std::string& name : names) {
      Series at{name, {}, {}, false}, line{"", {}, {}, true};
      std::vector<std::pair<double, double>> expected;
      for (const PairBin& b : fit.pairs) {
        if (b.pair != name) continue;
        at.x.push_back(b.first_dn + b.second_dn), at.y.push_back(b.variance_dn2);
        expected.emplace_back(b.first_dn + b.second_dn, b.expected_dn2);
      }
      std::sort(expected.begin(), expected.end());
      for (const auto& [x, y] : expected) line.x.push_back(x), line.y.push_back(y);
      pairs.series.push_back(at);
      pairs.series.push_back(line);
    }
    figures.push_back(pairs);
  }
  if (!fit.linearity.empty()) {
    Figure f{.kind = Figure::Kind::series,
             .title = "Linearity",
             .caption = fit.pairs.empty()
                            ? "Deviation of the signal from the line over exposure time."
                            : "Ratio of two exposures of the same pixels over the ratio of their exposure "
                              "times, less 1. A black level that is cut off shows in the dark parts.",
             .x_label = "signal [DN]",
             .y_label = "deviation [%]"};
    Series s{"", {}, {}, false};
    for (const LinearityPoint& p : fit.linearity)
      s.x.push_back(p.signal_dn), s.y.push_back(100 * p.deviation);
    f.series = {s};
    figures.push_back(f);
  }
  Figure dark{.kind = Figure::Kind::series,
              .title = "Dark level",
              .caption = "Mean of the dark frames over exposure time: its slope is K times the dark current.",
              .x_label = "exposure [s]",
              .y_label = "mean [DN]"};
  Series at{"measured", {}, {}, false}, clipped{"clipped: not used", {}, {}, false};
  for (const LevelPoint& p : st.points) {
    const PhotonLevel& l = stacks.levels()[p.level];
    if (l.settings.light) continue;
    (p.usable ? at : clipped).x.push_back(l.settings.exposure_s);
    (p.usable ? at : clipped).y.push_back(p.mean_dn);
  }
  if (!at.x.empty() || !clipped.x.empty()) {
    dark.series = {at, clipped};
    figures.push_back(dark);
  }
  if (fit.whitened.size() > 5) {
    Figure quantiles{
        .kind = Figure::Kind::quantiles,
        .title = "Q–Q plot",
        .caption = "Residuals of the levels in standard deviations of their own. On the line: normal."};
    quantiles.series = {{"", {}, fit.whitened, false}};
    figures.push_back(quantiles);
  }
  return figures;
}

Result<SheetRecipe> recipe_of(const CalibratePhotonOptions& options, const FrameStacks& stacks,
                              PhotonFit& fit) {
  SheetRecipe r;
  r.kind = "camera";
  if (options.output.empty()) return r;
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
                                            "hot_pixel_dark_e_per_s"};
    if (keys.count(p.name) == 0) continue;
    const double scale = p.name == "system_gain_dn_per_e" ? std::pow(10, -gain_db / 20) : 1;
    put(p.name, scale * p.value);
    r.places.push_back({p.name, "noise." + p.name, scale});
  }
  const double black = fit.result.find("black_level_dn")
                           ? fit.result.find("black_level_dn")->value
                           : std::ldexp(old.black_level_dn, fit.statistics.bits - old.adc_bits);
  if (!fit.result.find("black_level_dn")) put("black_level_dn", black);
  if (fit.result.find("dark_current_e_per_s")) {
    put("dark_reference_c", fit.temperature_reference_c);
    put("temperature_c", fit.temperature_reference_c);
  }
  if (const Parameter* k = fit.result.find("system_gain_dn_per_e"); k && !fit.result.find("full_well_e")) {
    const double least = (fit.statistics.max_dn - black) / k->value;
    if (fit.converter_saturates && old.full_well_e < least) {
      put("full_well_e", least);
      fit.result.warnings.push_back(
          "the sheet's full well is the least that it can be: the converter is full first");
    }
  }
  return r;
}

int calibrate_photon(const CalibratePhotonOptions& options) {
  const auto wrong = [&](const Error& e) { return report_error(e, options.json); };
  if (auto s = check_outputs(options); !s) return wrong(s.error());
  if (!options.output.empty() && options.base.empty())
    return wrong({ErrorCode::bad_input, "--base",
                  "expected the sheet of the camera, whose lens and size a photon transfer does not know: "
                  "give it with "
                  "--base, as in --base configs/sensors/industrial-global-shutter.yaml"});
  StopSource stop;
  SignalStop signals(stop);
  LiveLine line;
  FrameStacks stacks;
  int bits = options.bits;
  bool mosaic = options.mosaic;
  std::size_t number = 0;
  const auto input = read_photon_pictures(options, options.input, [&](const PhotonPicture& p) -> Status {
    if (!options.json) line.show(fmt::format("reading: {} frames", ++number));
    if (options.bits == 0) bits = std::max(bits, p.bits);
    mosaic = mosaic || (p.mosaic && !options.grey);
    return stacks.add(p.frame, p.pixels, p.width_px, p.height_px);
  });
  if (!options.json) line.done();
  if (!input) return wrong(input.error());
  PhotonFitOptions fit_options;
  fit_options.model = options.model;
  fit_options.bits = bits;
  fit_options.mosaic = options.grey ? 0 : mosaic ? 1 : -1;
  fit_options.stop = stop.token();
  auto fit = fit_photon(stacks, fit_options);
  if (!fit) return wrong(fit.error());
  if (bits == 0 && fit->statistics.bits > 8)
    fit->result.warnings.push_back(
        fmt::format("the converter's bits are taken from the largest value, {}: {} bits (--bits says it)",
                    stacks.largest() / fit->statistics.step, fit->statistics.bits));
  for (const std::string& w : input->warnings) fit->result.warnings.push_back(w);

  CalibrationProduct product;
  product.title = "Photon transfer";
  product.inputs = input->files;
  auto recipe = recipe_of(options, stacks, *fit);
  if (!recipe) return wrong(recipe.error());
  product.recipe = std::move(*recipe);
  product.fit = fit->result;
  product.figures = figures_of(stacks, *fit);
  auto& more = product.more;
  more["adc_bits"] = fit->statistics.bits;
  if (fit->linearity_error) more["linearity_error_percent"] = 100 * *fit->linearity_error;
  if (fit->response_exponent) {
    more["response_exponent"] = *fit->response_exponent;
    more["response_exponent_sigma"] = *fit->response_exponent_sigma;
  }
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
    product.record_next.push_back(
        "dark frames with the lens closed, the black level raised until no pixel reads 0, two or more at "
        "each of several "
        "exposure times");
  if (!fit->result.find("full_well_e") && !fit->converter_saturates)
    product.record_next.push_back(
        "even light at exposures up to and beyond saturation, two frames or more of each");
  return finish_calibration(options, std::move(product));
}

}  // namespace

CalibrateSubcommand add_calibrate_photon(CLI::App& calibrate) {
  CommandOptions app(calibrate, "photon", "Gain, noise and saturation of a sensor, by EMVA 1288");
  auto options = std::make_shared<CalibratePhotonOptions>();
  add_common_options(
      app, *options,
      "Pictures or folders of them (exposure and `dark` in their names: flat_20ms_1.png, "
      "dark_20ms_1.png), lists (.csv: file, exposure_ms, light|dark[, temperature_c[, gain_db]]), "
      "recordings");
  app.add_option("--dark", options->input.dark, "Pictures, folders or recordings without light");
  app.add_option("--temperature", options->input.temperature_c,
                 "Of the sensor, in °C, where a frame says none");
  app.add_option("--bits", options->bits, "Of the converter").between(8, 16);
  const auto mosaic = app.add_flag("--mosaic", options->mosaic, "The pixels are a 2x2 mosaic of colours");
  app.add_flag("--grey", options->grey, "They are not, though they differ").excludes(mosaic);
  app.footer(
      "Example: rigor calibrate photon flats/ --dark darks/ --base "
      "configs/sensors/industrial-global-shutter.yaml -o "
      "mine.yaml --report report");
  return {app, [options] { return calibrate_photon(*options); }};
}

}  // namespace rigor

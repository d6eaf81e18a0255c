#include "calibration/procedures/tof_figures.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace rigor {
namespace {

using namespace calibration;

/// Values of the twin as the curve over a histogram of the recording: in bars of the same width.
Series as_counts(const std::vector<double>& real, const std::vector<double>& twin) {
  Series s{"twin", {}, {}, true};
  std::vector<double> v;
  for (const double x : real)
    if (std::isfinite(x)) v.push_back(x);
  if (v.size() < 8 || twin.empty()) return s;
  std::sort(v.begin(), v.end());
  const auto at = [&](double q) {
    return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
  };
  const double a = at(0.002), b = at(0.998), margin = 0.04 * (b - a);
  const auto bars = static_cast<double>(std::clamp<std::size_t>(v.size() / 8, 8, 80));
  const double width = (b - a + 2 * margin) / bars;
  std::vector<double> count(static_cast<std::size_t>(bars), 0);
  for (const double x : twin) {
    const double k = (x - a + margin) / width;
    if (k >= 0 && k < bars) count[static_cast<std::size_t>(k)] += 1;
  }
  const double scale = static_cast<double>(v.size()) / static_cast<double>(twin.size());
  for (std::size_t k = 0; k < count.size(); ++k) {
    s.x.push_back(a - margin + (static_cast<double>(k) + 0.5) * width);
    s.y.push_back(count[k] * scale);
  }
  return s;
}

Figure against_twin(std::vector<double> real, std::vector<double> twin) {
  Figure f{.kind = Figure::Kind::series,
           .title = "Quantiles, recording against twin",
           .caption =
               "On the line the simulated twin's deviations are as large, and as often, as the recording's.",
           .x_label = "twin [mm]",
           .y_label = "recording [mm]"};
  std::sort(real.begin(), real.end());
  std::sort(twin.begin(), twin.end());
  Series points{"quantiles", {}, {}, false}, line{"equal", {}, {}, true};
  if (real.size() > 10 && twin.size() > 10)
    for (int i = 1; i < 400; ++i) {
      const double q = i / 400.0;
      points.x.push_back(1e3 * twin[static_cast<std::size_t>(q * static_cast<double>(twin.size() - 1))]);
      points.y.push_back(1e3 * real[static_cast<std::size_t>(q * static_cast<double>(real.size() - 1))]);
    }
  if (!points.x.empty()) line.x = line.y = {points.x.front(), points.x.back()};
  f.series = {points, line};
  return f;
}

double scale_of(const std::vector<double>& real, const std::vector<double>& twin) {
  return twin.empty() ? 1 : static_cast<double>(real.size()) / static_cast<double>(twin.size());
}

Series by_step(const std::string& name, const std::vector<double>& values_m, double step_m, double scale) {
  std::map<long, double> count;
  for (const double v : values_m)
    if (std::isfinite(v)) count[std::lround(v / step_m)] += scale;
  Series s{name, {}, {}, false};
  for (const auto& [at, n] : count) s.x.push_back(1e3 * step_m * static_cast<double>(at)), s.y.push_back(n);
  return s;
}

}  // namespace

void about_own_mean(std::vector<double>& values, double step) {
  double mean = 0;
  for (const double v : values) mean += v / static_cast<double>(values.size());
  if (step > 0) mean = step * std::round(mean / step);
  for (double& v : values) v -= mean;
}

std::vector<Figure> noise_figures(const LocalNoise& noise, const NoiseLawFit& law,
                                  const std::vector<double>& twin_m) {
  std::vector<Figure> figures;
  Figure curve{
      .kind = Figure::Kind::series,
      .title = "Noise against amplitude",
      .caption = "Groups of samples and all laws that were tried; the first is the one that was chosen. " +
                 noise.estimator,
      .x_label = "log10 of the amplitude",
      .y_label = "log10 of the standard deviation [mm]"};
  Series points{"measured", {}, {}, false};
  double least = 1e300, most = 0;
  for (const NoiseBin& b : noise.bins) {
    points.x.push_back(std::log10(b.amplitude));
    points.y.push_back(std::log10(1e3 * std::sqrt(b.variance_m2)));
    least = std::min(least, b.amplitude), most = std::max(most, b.amplitude);
  }
  curve.series.push_back(points);
  const auto add = [&](const NoiseCoefficients& c) {
    Series line{std::string(noise_law_name(c.law)), {}, {}, true};
    for (int i = 0; i <= 100; ++i) {
      const double a = least * std::pow(most / least, i / 100.0);
      line.x.push_back(std::log10(a));
      line.y.push_back(std::log10(1e3 * c.sigma_m(a)));
    }
    curve.series.push_back(line);
  };
  add(law.noise);
  for (const NoiseCoefficients& c : law.all)
    if (c.law != law.noise.law) add(c);
  figures.push_back(curve);
  std::vector<double> real;
  for (const NoiseSample& s : noise.samples) real.push_back(s.deviation_m);
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Noise of the recording and of its simulated twin",
                   .caption =
                       "Deviations of single ranges (bars), and what the fitted model makes of the same "
                       "amplitudes (line).",
                   .x_label = "deviation [mm]",
                   .y_label = "number"};
  histogram.series = {{"recording", {}, in_mm(real), false}, as_counts(in_mm(real), in_mm(twin_m))};
  figures.push_back(histogram);
  figures.push_back(against_twin(real, twin_m));
  Figure quantiles{
      .kind = Figure::Kind::quantiles,
      .title = "Q–Q plot of the noise",
      .caption =
          "Deviations over the law's standard deviation at their amplitude. On the line they are "
          "normal; ends that bend away are outliers that stayed."};
  Series unit;
  for (const NoiseSample& s : noise.samples)
    if (const double sigma = law.noise.sigma_m(s.amplitude); sigma > 0)
      unit.y.push_back(s.deviation_m / sigma);
  quantiles.series = {unit};
  figures.push_back(quantiles);
  return figures;
}

std::vector<Figure> range_figures(const RangeFit& fit, int width_px) {
  std::vector<Figure> figures;
  Figure wiggling{.kind = Figure::Kind::series,
                  .title = "Wiggling",
                  .caption =
                      "Error of the range against the range: the fitted model with twice its standard "
                      "uncertainty, and the scenes' means (their distances as they were given).",
                  .x_label = "range [m]",
                  .y_label = "error [mm]"};
  Series line{fit.model.name(), {}, {}, true}, low{"±2 sigma", {}, {}, true}, high{"", {}, {}, true},
      scenes{"scenes", {}, {}, false};
  for (const auto& p : fit.curve) {
    line.x.push_back(p.range_m), line.y.push_back(1e3 * p.error_m);
    low.x.push_back(p.range_m), low.y.push_back(1e3 * (p.error_m - 2 * p.sigma_m));
    high.x.push_back(p.range_m), high.y.push_back(1e3 * (p.error_m + 2 * p.sigma_m));
  }
  for (const SceneFit& s : fit.scenes)
    if (s.used && s.samples > 0) {
      scenes.x.push_back(s.range_m);
      scenes.y.push_back(1e3 * s.deviation_m);
    }
  wiggling.series = {line, low, scenes, high};
  figures.push_back(wiggling);
  std::vector<double> map(fit.pixel_offset_m.begin(), fit.pixel_offset_m.end());
  for (double& v : map) v *= 1e3;
  // A page is to be read: blocks of pixels where there are many.
  int columns = width_px, rows = width_px > 0 ? static_cast<int>(map.size()) / width_px : 0;
  const int block = std::max(1, std::max(columns, rows) / 120);
  std::vector<double> small;
  for (int v = 0; v < rows; v += block)
    for (int u = 0; u < columns; u += block) small.push_back(map[static_cast<std::size_t>(v * columns + u)]);
  figures.push_back({.kind = Figure::Kind::map,
                     .title = "Offsets of the pixels",
                     .caption = "Fixed pattern: each pixel's own offset less their mean.",
                     .x_label = "u [px]",
                     .y_label = "v [px]",
                     .values = small,
                     .columns = (columns + block - 1) / block,
                     .x_to = static_cast<double>(columns),
                     .y_to = static_cast<double>(rows),
                     .value_label = "mm"});
  Figure rms{.kind = Figure::Kind::series,
             .title = "Residuals by scene",
             .caption =
                 "RMS of what the model leaves, and how far each plane seems to stand from where it was said "
                 "to be.",
             .x_label = "distance [m]",
             .y_label = "[mm]"};
  Series r{"RMS of samples", {}, {}, false}, e{"distance's error", {}, {}, false};
  for (const SceneFit& s : fit.scenes) {
    r.x.push_back(s.distance_m), r.y.push_back(1e3 * s.rms_m);
    e.x.push_back(s.distance_m), e.y.push_back(1e3 * s.error_m);
  }
  rms.series = {r, e};
  figures.push_back(rms);
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Residuals",
                   .caption = "Of samples at all distances, after the fit.",
                   .x_label = "residual [mm]",
                   .y_label = "number"};
  Series all;
  for (const NoiseSample& s : fit.samples) all.y.push_back(1e3 * s.deviation_m);
  histogram.series = {all};
  figures.push_back(histogram);
  return figures;
}

std::vector<Figure> drift_figures(const DriftFit& fit, const std::vector<double>& twin_m) {
  std::vector<Figure> figures;
  Figure allan{
      .kind = Figure::Kind::series,
      .title = "Allan deviation",
      .caption =
          "Overlapping, with 95 % intervals; the model; and white noise alone, which averaging beats "
          "down as 1/sqrt(N). Where the points leave that line it does so no longer.",
      .x_label = "log10 of the averaging time [s]",
      .y_label = "log10 of the deviation [mm]"};
  Series points{"measured", {}, {}, false}, low{"95 %", {}, {}, true}, high{"", {}, {}, true},
      model{"model", {}, {}, true}, white{"white noise alone", {}, {}, true};
  for (const AllanPoint& p : fit.allan) {
    const double x = std::log10(p.tau_s);
    points.x.push_back(x), points.y.push_back(std::log10(1e3 * p.deviation));
    low.x.push_back(x), low.y.push_back(std::log10(1e3 * p.low));
    high.x.push_back(x), high.y.push_back(std::log10(1e3 * p.high));
    model.x.push_back(x), model.y.push_back(std::log10(1e3 * model_allan(fit, p.tau_s)));
    white.x.push_back(x);
    white.y.push_back(std::log10(1e3 * fit.white_m / std::sqrt(static_cast<double>(p.averaged))));
  }
  allan.series = {points, low, model, white, high};
  figures.push_back(allan);
  Figure over_time{.kind = Figure::Kind::series,
                   .title = "Over time",
                   .caption = "Means of a two-hundredth of the recording each, and the straight drift.",
                   .x_label = "time [s]",
                   .y_label = "range less its mean [mm]"};
  Series means{"means", {}, {}, true};
  const std::size_t block = std::max<std::size_t>(1, fit.series.size() / 200);
  for (std::size_t i = 0; i + block <= fit.series.size(); i += block) {
    double sum = 0;
    for (std::size_t k = i; k < i + block; ++k) sum += fit.series[k];
    means.x.push_back((static_cast<double>(i) + 0.5 * static_cast<double>(block)) * fit.period_s);
    means.y.push_back(1e3 * (sum / static_cast<double>(block) - fit.mean_m));
  }
  Series line{"drift", {}, {}, true};
  const double length = static_cast<double>(fit.series.size()) * fit.period_s;
  line.x = {0, length};
  line.y = {-500 * fit.drift_mps * length, 500 * fit.drift_mps * length};
  over_time.series = {means, line};
  figures.push_back(over_time);
  std::vector<double> real(fit.series), twin(twin_m);
  // About their own means: where a random walk happens to be is not what is compared.
  about_own_mean(real, fit.step_m);
  about_own_mean(twin, fit.step_m);
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Readings of the recording and of its simulated twin",
                   .caption =
                       "Readings less their mean (bars), and those of the fitted noise with the device's "
                       "rounding (line).",
                   .x_label = "reading [mm]",
                   .y_label = "number"};
  if (fit.step_m > 0) {
    // Between the device's steps there is nothing to count.
    histogram.kind = Figure::Kind::series;
    histogram.caption =
        "How many readings lie at each step of the device about their mean: the recording's (points), and "
        "those "
        "of the fitted noise with the same rounding (line).";
    histogram.series = {by_step("recording", real, fit.step_m, 1),
                        by_step("twin", twin, fit.step_m, scale_of(real, twin))};
    histogram.series[1].line = true;
  } else {
    histogram.series = {{"recording", {}, in_mm(real), false}, as_counts(in_mm(real), in_mm(twin))};
  }
  figures.push_back(histogram);
  figures.push_back(against_twin(real, twin));
  Figure quantiles{.kind = Figure::Kind::quantiles,
                   .title = "Q–Q plot of the innovations",
                   .caption = "What each reading brings that the ones before it do not foretell."};
  Series z;
  for (const double v : fit.innovation)
    if (std::isfinite(v)) z.y.push_back(v);
  quantiles.series = {z};
  figures.push_back(quantiles);
  return figures;
}

}  // namespace rigor

#include "calibration/core/twin_figures.h"

#include <algorithm>
#include <cmath>

namespace rigor::calibration {
namespace {

std::vector<double> sorted(const std::vector<double>& values) {
  std::vector<double> v;
  for (const double x : values)
    if (std::isfinite(x)) v.push_back(x);
  std::sort(v.begin(), v.end());
  return v;
}
double at(const std::vector<double>& v, double q) {
  return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
}

}  // namespace

Figure twin_histogram(const TwinValues& values, double step) {
  Figure f{
      .kind = Figure::Kind::series,
      .title = "Noise, recording and twin: " + values.what,
      .caption =
          "Share of the pixels. Points: the recording; line: the simulated sensor with the sensor model's "
          "values at the same level.",
      .x_label = "deviation [" + values.unit + "]",
      .y_label = "share per " + values.unit};
  const auto real = sorted(values.real), twin = sorted(values.twin);
  if (real.size() < 20 || twin.size() < 20) return f;
  const double a = std::min(at(real, 0.002), at(twin, 0.002)), b = std::max(at(real, 0.998), at(twin, 0.998));
  const double spread = std::max(b - a, 1e-12);
  double width =
      spread / std::clamp(std::sqrt(static_cast<double>(std::min(real.size(), twin.size()))) / 2, 8.0, 26.0);
  if (step > 0) width = step * std::max(1.0, std::round(width / step));
  const double from = step > 0 ? std::floor(a / width) * width - 0.5 * width : a;
  const auto bars = static_cast<std::size_t>(std::ceil((b - from) / width)) + 1;
  Series recording{"recording", {}, {}, false}, simulated{"twin", {}, {}, true};
  for (const bool is_twin : {false, true}) {
    std::vector<double> count(bars, 0);
    const auto& v = is_twin ? twin : real;
    for (const double x : v) {
      const double k = std::floor((x - from) / width);
      if (k >= 0 && k < static_cast<double>(bars)) count[static_cast<std::size_t>(k)] += 1;
    }
    Series& s = is_twin ? simulated : recording;
    for (std::size_t k = 0; k < bars; ++k) {
      s.x.push_back(from + (static_cast<double>(k) + 0.5) * width);
      s.y.push_back(count[k] / static_cast<double>(v.size()) / width);
    }
  }
  f.series = {recording, simulated};
  return f;
}

Figure twin_quantiles(const std::vector<TwinValues>& values) {
  Figure f{.kind = Figure::Kind::series,
           .title = "Quantiles, recording against twin",
           .caption =
               "From the thousandth to the 999th. On the line the twin's deviations are as large, and as "
               "often, as the recording's.",
           .x_label = "twin" + (values.empty() ? "" : " [" + values.front().unit + "]"),
           .y_label = "recording" + (values.empty() ? "" : " [" + values.front().unit + "]")};
  double low = 0, high = 0;
  for (const TwinValues& v : values) {
    const auto real = sorted(v.real), twin = sorted(v.twin);
    if (real.size() < 20 || twin.size() < 20) continue;
    Series points{v.what, {}, {}, false};
    for (int i = 0; i <= 60; ++i) {
      // Even steps of a normal distribution, so that the tails are seen.
      const double q = 0.5 * (1 + std::erf((i - 30) / 30.0 * 3.09 / std::sqrt(2.0)));
      points.x.push_back(at(twin, q)), points.y.push_back(at(real, q));
    }
    low = std::min(low, points.x.front()), high = std::max(high, points.x.back());
    f.series.push_back(points);
  }
  if (!f.series.empty()) f.series.push_back({"equal", {low, high}, {low, high}, true});
  return f;
}

}  // namespace rigor::calibration

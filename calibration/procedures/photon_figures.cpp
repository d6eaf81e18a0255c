#include "calibration/procedures/photon_figures.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "calibration/core/twin_figures.h"

namespace rigor {
namespace {

using namespace calibration;

/// The darkest level, one in the middle and the brightest, beside their twins; and all of their sizes.
void twin_figures(const std::vector<NoisePair>& twins, bool levels, std::vector<Figure>& figures) {
  if (twins.empty()) return;
  std::vector<const NoisePair*> in_order;
  for (const NoisePair& t : twins) in_order.push_back(&t);
  std::sort(in_order.begin(), in_order.end(),
            [](const NoisePair* a, const NoisePair* b) { return a->signal_dn < b->signal_dn; });
  std::set<std::size_t> shown{0, in_order.size() / 2, in_order.size() - 1};
  std::vector<TwinValues> values;
  for (const std::size_t i : shown) {
    values.push_back({in_order[i]->level, "DN", in_order[i]->real_dn, in_order[i]->twin_dn});
    // Differences of whole numbers from a mean of several lie on no raster of one step.
    figures.push_back(twin_histogram(values.back()));
    if (!levels)
      figures.back().caption =
          "Deviation of the longer exposure from what both together say, of pixels alike in brightness. "
          "Points: the "
          "recording; line: the same scene before the simulated sensor.";
  }
  figures.push_back(twin_quantiles(values));
  Figure f{
      .kind = Figure::Kind::series,
      .title = "Simulated twin beside the sensor",
      .caption = "Standard deviation of the twin's noise over the recording's, level by level. 1: alike.",
      .x_label = levels ? "signal above black [DN]" : "brightest signal of the pair [DN]",
      .y_label = "noise of the twin / of the sensor"};
  Series ratio{"", {}, {}, false}, one{"", {}, {1, 1}, true};
  for (const NoisePair* t : in_order)
    if (t->real_sigma_dn > 0)
      ratio.x.push_back(t->signal_dn), ratio.y.push_back(t->twin_sigma_dn / t->real_sigma_dn);
  if (ratio.x.empty()) return;
  one.x = {std::min(0.0, ratio.x.front()), ratio.x.back()};
  f.series = {ratio, one};
  figures.push_back(f);
}

}  // namespace

std::vector<Figure> photon_figures(const FrameStacks& stacks, const PhotonFit& fit,
                                   const std::vector<NoisePair>& twins) {
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
    Series used{"measured", {}, {}, false}, out{"left out", {}, {}, false};
    Series line{"fit", {}, {}, true}, low{"", {}, {}, true}, high{"± 2 sigma", {}, {}, true};
    for (std::size_t k = 0; k < st.points.size(); ++k) {
      const LevelPoint& p = st.points[k];
      if (p.frames < 2 || p.pixels < 1) continue;
      Series& s = fit.in_range[k] ? used : out;
      const double signal = p.mean_dn - fit.black_dn;
      s.x.push_back(signal), s.y.push_back(p.variance_dn2);
    }
    line.x = low.x = high.x = fit.curve_signal_dn;
    line.y = fit.curve_variance_dn2;
    for (std::size_t i = 0; i < line.y.size(); ++i) {
      low.y.push_back(line.y[i] - 2 * fit.curve_sigma_dn2[i]);
      high.y.push_back(line.y[i] + 2 * fit.curve_sigma_dn2[i]);
    }
    Series twin{"simulated twin", {}, {}, false};
    for (const NoisePair& t : twins)
      twin.x.push_back(t.signal_dn), twin.y.push_back(t.twin_sigma_dn * t.twin_sigma_dn);
    ptc.series = {used, out, line, low, high, twin};
    figures.push_back(ptc);
  }
  twin_figures(twins, fit.pairs.empty(), figures);
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

}  // namespace rigor

#include "cli/svg.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "cli/terminal.h"

namespace rigor {
namespace {

constexpr double kWidth = 560, kHeight = 180, kLeft = 56, kBottom = 34, kTop = 10, kRight = 12;
constexpr double kPlotW = kWidth - kLeft - kRight, kPlotH = kHeight - kTop - kBottom;

std::string open_svg(double height = kHeight) {
  return fmt::format(R"(<svg viewBox="0 0 {} {}" xmlns="http://www.w3.org/2000/svg" role="img">)", kWidth,
                     height);
}
std::string text_at(double x, double y, const std::string& anchor, const std::string& text) {
  return fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>)", x, y, anchor, text);
}
std::string frame() {
  return fmt::format(R"(<path class="axis" d="M{0} {1}V{2}H{3}"/>)", kLeft, kTop, kTop + kPlotH,
                     kLeft + kPlotW);
}

}  // namespace

std::vector<double> axis_ticks(double a, double b, int parts) {
  const double raw = (b - a) / parts;
  if (!(raw > 0) || !std::isfinite(raw)) return {a};
  const double power = std::pow(10, std::floor(std::log10(raw)));
  const double step = raw / power > 5   ? 10 * power
                      : raw / power > 2 ? 5 * power
                      : raw / power > 1 ? 2 * power
                                        : power;
  std::vector<double> out;
  for (double v = std::ceil(a / step) * step; v <= b + step * 1e-9; v += step)
    out.push_back(std::abs(v) < step * 1e-9 ? 0 : v);
  return out;
}

std::string svg_histogram(const nlohmann::json& histogram, const std::string& label) {
  const auto& buckets = histogram["buckets"];
  if (buckets.empty()) return "<p class=\"none\">nothing to show</p>";
  const double lo = std::log10(std::max(100.0, buckets.front()[0].get<double>()));
  const double hi = std::max(lo + 0.3, std::log10(std::max(101.0, buckets.back()[1].get<double>())));
  const auto x_of = [&](double ns) {
    return kLeft + kPlotW * (std::log10(std::max(ns, std::pow(10, lo))) - lo) / (hi - lo);
  };
  // The linear parts of the buckets differ in width: draw the share per decade by regrouping into equal bars
  // on the log axis.
  constexpr std::size_t kBars = 90;
  std::vector<double> bar(kBars, 0.0);
  for (const auto& b : buckets) {
    const double middle = 0.5 * (b[0].get<double>() + b[1].get<double>());
    const auto i =
        static_cast<std::size_t>(std::clamp((x_of(middle) - kLeft) / kPlotW * kBars, 0.0, kBars - 1.0));
    bar[i] += b[2].get<double>();
  }
  const double peak = *std::max_element(bar.begin(), bar.end());
  const double top = std::log10(peak) + 0.15;
  std::string s = open_svg() + frame();
  for (std::size_t i = 0; i < kBars; ++i)
    if (bar[i] > 0) {
      const double h = kPlotH * (std::log10(bar[i]) + 0.15) / top;
      s += fmt::format(
          R"(<rect class="bar" x="{:.2f}" y="{:.2f}" width="{:.2f}" height="{:.2f}"><title>{:.0f}</title></rect>)",
          kLeft + kPlotW * static_cast<double>(i) / kBars, kTop + kPlotH - h, kPlotW / kBars - 0.6, h,
          bar[i]);
    }
  // Every power of ten; on a narrow axis two and five times it as well.
  for (double e = std::floor(lo); e <= hi; ++e)
    for (double step : {1.0, 2.0, 5.0}) {
      const double ns = step * std::pow(10, e);
      if (std::log10(ns) < lo || std::log10(ns) > hi || (step > 1 && hi - lo > 2)) continue;
      s += text_at(x_of(ns), kTop + kPlotH + 14, "middle", text_of(Duration(std::llround(ns))));
    }
  for (double e = 0; e <= std::log10(peak); ++e)
    s += text_at(kLeft - 6, kTop + kPlotH - kPlotH * (e + 0.15) / top + 4, "end",
                 fmt::format("{:.0f}", std::pow(10, e)));
  double label_y = kTop + 9;
  for (const auto& [key, name] : {std::pair{"p50_ns", "p50"}, std::pair{"p99_ns", "p99"}}) {
    const double x = x_of(histogram[key].get<double>());
    s += fmt::format(R"(<path class="mark" d="M{0:.1f} {1}V{2}"/>)", x, kTop, kTop + kPlotH);
    s += text_at(x + 3, label_y, "start", name);
    label_y += 12;
  }
  return s + text_at(kLeft + kPlotW / 2, kHeight - 4, "middle", label) + "</svg>";
}

std::string svg_lines(const std::vector<SvgSeries>& series, const std::string& x_label,
                      const std::string& y_label) {
  double x0 = INFINITY, x1 = -INFINITY, y0 = INFINITY, y1 = -INFINITY;
  for (const SvgSeries& l : series)
    for (std::size_t i = 0; i < l.x.size(); ++i) {
      x0 = std::min(x0, l.x[i]);
      x1 = std::max(x1, l.x[i]);
      y0 = std::min(y0, l.y[i]);
      y1 = std::max(y1, l.y[i]);
    }
  if (!(x1 >= x0)) return "<p class=\"none\">nothing to show</p>";
  if (x1 == x0) x1 = x0 + 1;
  const double pad = std::max((y1 - y0) * 0.08, 1e-6 + std::abs(y1) * 0.01);
  y0 -= pad;
  y1 += pad;
  const auto px = [&](double x) { return kLeft + kPlotW * (x - x0) / (x1 - x0); };
  const auto py = [&](double y) { return kTop + kPlotH - kPlotH * (y - y0) / (y1 - y0); };
  std::string s = open_svg() + frame();
  for (double t : axis_ticks(x0, x1, 5))
    s += text_at(px(t), kTop + kPlotH + 14, "middle", fmt::format("{:g}", t));
  for (double t : axis_ticks(y0, y1, 5)) s += text_at(kLeft - 6, py(t) + 4, "end", fmt::format("{:g}", t));
  double legend = kLeft + 8;
  for (const SvgSeries& l : series) {
    s += fmt::format(R"(<polyline fill="none" stroke="{}" stroke-width="1.4" points=")", l.colour);
    for (std::size_t i = 0; i < l.x.size(); ++i) s += fmt::format("{:.1f},{:.1f} ", px(l.x[i]), py(l.y[i]));
    s += "\"/>";
    s += fmt::format(R"(<text x="{:.1f}" y="{}" style="fill:{}">{}</text>)", legend, kTop + 10, l.colour,
                     l.name);
    legend += 14 + 7.0 * static_cast<double>(l.name.size());
  }
  return s + text_at(kLeft + kPlotW / 2, kHeight - 4, "middle", x_label + " · " + y_label) + "</svg>";
}

std::string svg_status(const nlohmann::json& spans, double duration_s) {
  const auto colour = [](const std::string& status) {
    return status == "late"    ? "#e8a33d"
           : status == "lost"  ? "#c0392b"
           : status == "never" ? "#bbb"
                               : "#3a9a5b";
  };
  std::string s = open_svg(18);
  for (std::size_t i = 0; i < spans.size(); ++i) {
    const double from = spans[i]["t_s"],
                 to = i + 1 < spans.size() ? spans[i + 1]["t_s"].get<double>() : duration_s;
    const std::string status = spans[i]["status"];
    s += fmt::format(
        R"(<rect x="{:.2f}" y="2" width="{:.2f}" height="14" fill="{}"><title>{} from {:.3f} s</title></rect>)",
        kLeft + kPlotW * from / duration_s, std::max(0.5, kPlotW * (to - from) / duration_s), colour(status),
        status, from);
  }
  return s + "</svg>";
}

}  // namespace rigor

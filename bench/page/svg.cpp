#include "bench/page/svg.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/page/page.h"

namespace rigor {
namespace {

std::string text_at(double x, double y, const std::string& anchor, const std::string& text) {
  return fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>)", x, y, anchor, text);
}
std::string axes(const PlotFrame& f) {
  return fmt::format(R"(<path class="axis" d="M{0} {1}V{2}H{3}"/>)", f.left, f.top, f.top + f.plot_height(),
                     f.left + f.plot_width());
}
std::string caption(const PlotFrame& f, const std::string& text) {
  return text_at(f.left + f.plot_width() / 2, f.height - 4, "middle", text);
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

std::string open_plot(const PlotFrame& f, const std::string& style) {
  return fmt::format(
      R"(<svg class="plot" viewBox="0 0 {} {}" data-frame="{} {} {} {}" data-range="{:.9g} {:.9g} {:.9g} {:.9g}" data-axis="{}"{} xmlns="http://www.w3.org/2000/svg" role="img">)",
      f.width, f.height, f.left, f.top, f.plot_width(), f.plot_height(), f.x0, f.x1, f.y0, f.y1, f.axis,
      style.empty() ? "" : " style=\"" + style + "\"");
}

std::string open_data(const PlotFrame& f) {
  return fmt::format(
      R"(<svg class="data" x="{0}" y="{1}" width="{2}" height="{3}" viewBox="{0} {1} {2} {3}" preserveAspectRatio="none">)",
      f.left, f.top, f.plot_width(), f.plot_height());
}

std::string x_label(const PlotFrame& f, double x, const std::string& text) {
  return fmt::format(R"(<text class="x" x="{:.1f}" y="{:.1f}" text-anchor="middle">{}</text>)", f.px(x),
                     f.top + f.plot_height() + 14, text);
}

std::string plot_line(const std::string& name, const std::string& colour, const std::string& points) {
  return fmt::format(
      R"(<polyline fill="none" style="stroke:{}" stroke-width="1.4" vector-effect="non-scaling-stroke" data-name="{}" points="{}"/>)",
      colour, html_text(name), points);
}

std::string svg_histogram(const nlohmann::json& histogram, const std::string& label,
                          std::optional<double> limit_ns) {
  const auto& buckets = histogram["buckets"];
  if (buckets.empty()) return "<p class=\"none\">nothing to show</p>";
  const auto log_of = [](double ns) { return std::log10(std::max(ns, 1.0)); };
  PlotFrame f;
  f.axis = "log ns";
  f.x0 = std::log10(std::max(100.0, buckets.front()[0].get<double>()));
  f.x1 = std::log10(std::max(101.0, buckets.back()[1].get<double>()));
  if (f.x1 - f.x0 < 1) {  // a single value stands in the middle of a decade
    const double middle = (f.x0 + f.x1) / 2;
    f.x0 = middle - 0.5, f.x1 = middle + 0.5;
  }
  // The linear parts of the buckets differ in width: draw the share per decade by regrouping into equal bars
  // on the log axis.
  constexpr std::size_t kBars = 90;
  const double step = (f.x1 - f.x0) / kBars;
  std::vector<double> bar(kBars, 0.0);
  for (const auto& b : buckets) {
    const double middle = 0.5 * (b[0].get<double>() + b[1].get<double>());
    bar[static_cast<std::size_t>(std::clamp((log_of(middle) - f.x0) / step, 0.0, kBars - 1.0))] +=
        b[2].get<double>();
  }
  // Counts are logarithmic as well, and one is seen.
  constexpr double kFoot = 0.15;
  const double peak = *std::max_element(bar.begin(), bar.end());
  f.y0 = -kFoot;
  f.y1 = std::max(std::log10(peak), kFoot);
  std::string s = open_plot(f) + open_data(f);
  for (std::size_t i = 0; i < kBars; ++i)
    if (bar[i] > 0) {
      const double from = f.x0 + step * static_cast<double>(i), y = f.py(std::log10(bar[i]));
      const bool beyond = limit_ns && from >= log_of(*limit_ns);
      s += fmt::format(
          R"(<rect class="bar{}" x="{:.2f}" y="{:.2f}" width="{:.2f}" height="{:.2f}" data-span="{:.6f} {:.6f}"><title>{:.0f} times</title></rect>)",
          beyond ? " beyond" : "", f.px(from), y, f.plot_width() / kBars - 0.6, f.top + f.plot_height() - y,
          from, from + step, bar[i]);
    }
  std::string names;
  double name_y = f.top + 9;
  const auto mark = [&](double ns, const char* name, const char* kind) {
    const double x = log_of(ns);
    if (x < f.x0 || x > f.x1) return;
    s += fmt::format(R"(<path class="{}" vector-effect="non-scaling-stroke" d="M{:.1f} {}V{}"/>)", kind,
                     f.px(x), f.top, f.top + f.plot_height());
    const bool at_edge = f.px(x) > f.left + f.plot_width() - 30;
    names += fmt::format(R"(<text data-x="{:.6f}" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>)", x,
                         f.px(x) + (at_edge ? -3 : 3), name_y, at_edge ? "end" : "start", name);
    name_y += 12;
  };
  mark(histogram["p50_ns"].get<double>(), "p50", "mark");
  mark(histogram["p99_ns"].get<double>(), "p99", "mark");
  if (limit_ns) mark(*limit_ns, "limit", "limit");
  s += "</svg>" + axes(f) + names;
  // Every power of ten; on a narrow axis two and five times it as well.
  for (double e = std::floor(f.x0); e <= f.x1; ++e)
    for (double times : {1.0, 2.0, 5.0}) {
      const double ns = times * std::pow(10, e), x = std::log10(ns);
      if (x < f.x0 || x > f.x1 || (times > 1 && f.x1 - f.x0 > 2)) continue;
      s += x_label(f, x, text_of(Duration(std::llround(ns))));
    }
  for (double e = 0; e <= std::log10(peak); ++e)
    s += text_at(f.left - 6, f.py(e) + 4, "end", fmt::format("{:.0f}", std::pow(10, e)));
  return s + caption(f, label) + "</svg>";
}

std::string svg_lines(const std::vector<SvgSeries>& series, const std::string& x_title,
                      const std::string& y_title) {
  PlotFrame f;
  f.x0 = f.y0 = INFINITY, f.x1 = f.y1 = -INFINITY;
  for (const SvgSeries& l : series)
    for (std::size_t i = 0; i < l.x.size(); ++i) {
      f.x0 = std::min(f.x0, l.x[i]);
      f.x1 = std::max(f.x1, l.x[i]);
      f.y0 = std::min(f.y0, l.y[i]);
      f.y1 = std::max(f.y1, l.y[i]);
    }
  if (!(f.x1 >= f.x0)) return "<p class=\"none\">nothing to show</p>";
  if (f.x1 == f.x0) f.x1 = f.x0 + 1;
  const double pad = std::max((f.y1 - f.y0) * 0.08, 1e-6 + std::abs(f.y1) * 0.01);
  f.y0 -= pad;
  f.y1 += pad;
  std::string s = open_plot(f), legend;
  for (double t : axis_ticks(f.x0, f.x1, 5)) s += x_label(f, t, fmt::format("{:g}", t));
  for (double y : axis_ticks(f.y0, f.y1, 5))
    s += text_at(f.left - 6, f.py(y) + 4, "end", fmt::format("{:g}", y));
  s += axes(f) + open_data(f);
  double legend_x = f.left + 8;
  for (const SvgSeries& l : series) {
    std::string points;
    for (std::size_t i = 0; i < l.x.size(); ++i)
      points += fmt::format("{:.2f},{:.2f} ", f.px(l.x[i]), f.py(l.y[i]));
    if (!points.empty()) s += plot_line(l.name, l.colour, points);
    legend += fmt::format(R"(<text x="{:.1f}" y="{}" style="fill:{}">{}</text>)", legend_x, f.top + 10,
                          l.colour, html_text(l.name));
    legend_x += 14 + 7.0 * static_cast<double>(l.name.size());
  }
  return s + "</svg>" + legend + caption(f, x_title + " · " + y_title) + "</svg>";
}

std::string svg_status(const nlohmann::json& spans, double duration_s) {
  PlotFrame f;
  f.height = 18, f.top = 2, f.bottom = 2;
  f.x1 = std::max(duration_s, 1e-9);
  std::string s = open_plot(f) + open_data(f);
  for (std::size_t i = 0; i < spans.size(); ++i) {
    const double from = spans[i]["t_s"],
                 to = i + 1 < spans.size() ? spans[i + 1]["t_s"].get<double>() : duration_s;
    const std::string status = spans[i]["status"];
    s += fmt::format(
        R"(<rect class="status-{}" x="{:.2f}" y="2" width="{:.2f}" height="14" data-span="{:.6f} {:.6f}"><title>{} from {:.3f} s</title></rect>)",
        status == "overdue" || status == "disconnected" || status == "never" ? status : "fresh", f.px(from),
        std::max(0.5, f.px(to) - f.px(from)), from, to, status, from);
  }
  return s + "</svg></svg>";
}

}  // namespace rigor

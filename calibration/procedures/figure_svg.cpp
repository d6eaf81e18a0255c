#include "calibration/procedures/figure_svg.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "bench/page/page.h"
#include "bench/page/svg.h"

namespace rigor {
namespace {

using calibration::Figure;
using calibration::Series;

constexpr double kWidth = 560, kHeight = 300, kLeft = 62, kRight = 14, kTop = 12, kBottom = 42;
constexpr std::array kColours{"var(--series-1)", "var(--series-2)", "var(--series-3)",
                              "var(--series-4)", "var(--series-5)", "var(--quiet)"};

struct Axis {
  double from, to, at, length;  // pixels
  [[nodiscard]] double operator()(double v) const {
    return at + length * (to > from ? (v - from) / (to - from) : 0.5);
  }
};

std::string text(double x, double y, const char* anchor, const std::string& t, const char* more = "") {
  return fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}" {}>{}</text>)", x, y, anchor, more,
                     html_text(t));
}

std::string axes(const Figure& f, const Axis& x, const Axis& y) {
  std::string s = fmt::format(R"(<path class="axis" d="M{0} {1}V{2}H{3}"/>)", kLeft, kTop, kHeight - kBottom,
                              kWidth - kRight);
  for (double v : axis_ticks(x.from, x.to, 6))
    s += text(x(v), kHeight - kBottom + 14, "middle", fmt::format("{:g}", v));
  for (double v : axis_ticks(y.from, y.to, 6))
    s += text(kLeft - 5, y(v) + 3.5, "end", fmt::format("{:g}", v));
  s += text((kLeft + kWidth - kRight) / 2, kHeight - 8, "middle", f.x_label);
  s += fmt::format(R"-(<text transform="translate(13 {:.0f}) rotate(-90)" text-anchor="middle">{}</text>)-",
                   (kHeight - kBottom + kTop) / 2, html_text(f.y_label));
  return s;
}
Axis x_axis(double a, double b) { return {a, b, kLeft, kWidth - kLeft - kRight}; }
Axis y_axis(double a, double b) { return {a, b, kHeight - kBottom, -(kHeight - kTop - kBottom)}; }
void widen(double& a, double& b) {
  if (!(b > a)) {  // one value: around it, by its own size
    const double about = a != 0 ? 0.1 * std::abs(a) : 0.5;
    a -= about, b += about;
  }
  const double margin = 0.04 * (b - a);
  a -= margin, b += margin;
}
void span_of(const std::vector<double>& v, double& a, double& b) {
  for (double x : v)
    if (std::isfinite(x)) a = std::min(a, x), b = std::max(b, x);
}

/// Inverse of the normal distribution (Acklam's rational approximation, 1e-9).
double normal_quantile(double p) {
  static constexpr double a[] = {-3.969683028665376e+01, 2.209460984245205e+02,  -2.759285104469687e+02,
                                 1.383577518672690e+02,  -3.066479806614716e+01, 2.506628277459239e+00};
  static constexpr double b[] = {-5.447609879822406e+01, 1.615858368580409e+02, -1.556989798598866e+02,
                                 6.680131188771972e+01, -1.328068155288572e+01};
  static constexpr double c[] = {-7.784894002430293e-03, -3.223964580411365e-01, -2.400758277161838e+00,
                                 -2.549732539343734e+00, 4.374664141464968e+00,  2.938163982698783e+00};
  static constexpr double d[] = {7.784695709041462e-03, 3.224671290700398e-01, 2.445134137142996e+00,
                                 3.754408661907416e+00};
  if (p > 0.5) return -normal_quantile(1 - p);
  if (p < 0.02425) {
    const double q = std::sqrt(-2 * std::log(p));
    return (((((c[0] * q + c[1]) * q + c[2]) * q + c[3]) * q + c[4]) * q + c[5]) /
           ((((d[0] * q + d[1]) * q + d[2]) * q + d[3]) * q + 1);
  }
  const double q = p - 0.5, r = q * q;
  return (((((a[0] * r + a[1]) * r + a[2]) * r + a[3]) * r + a[4]) * r + a[5]) * q /
         (((((b[0] * r + b[1]) * r + b[2]) * r + b[3]) * r + b[4]) * r + 1);
}

std::string draw_series(const Figure& f) {
  double x0 = std::numeric_limits<double>::infinity(), x1 = -x0, y0 = x0, y1 = -x0;
  for (const Series& s : f.series) span_of(s.x, x0, x1), span_of(s.y, y0, y1);
  if (!(x1 >= x0)) return "<p class=\"none\">nothing to show</p>";
  widen(x0, x1), widen(y0, y1);
  if (f.x_to > f.x_from) x0 = f.x_from, x1 = f.x_to;
  if (f.y_to > f.y_from) y0 = f.y_from, y1 = f.y_to;
  const Axis x = x_axis(x0, x1), y = y_axis(y0, y1);
  std::string out = axes(f, x, y);
  for (std::size_t k = 0; k < f.series.size(); ++k) {
    const Series& s = f.series[k];
    const char* colour = kColours[k % kColours.size()];
    const std::size_t n = std::min(s.x.size(), s.y.size());
    std::string path;
    // A page is to be read: of many points every n-th.
    const bool line = s.line && n > 1;
    const double width = line ? 1.6 : n < 60 ? 6.0 : 2.6;
    const std::size_t stride = line ? 1 : std::max<std::size_t>(1, n / 4000);
    for (std::size_t i = 0; i < n; i += stride) {
      if (!std::isfinite(s.x[i]) || !std::isfinite(s.y[i])) continue;
      if (line)
        path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", x(s.x[i]), y(s.y[i]));
      else
        path += fmt::format("M{:.1f} {:.1f}h.01", x(s.x[i]), y(s.y[i]));
    }
    out += fmt::format(
        R"(<path d="{}" fill="none" style="stroke:{}" stroke-width="{}" stroke-linecap="round"/>)", path,
        colour, width);
    if (!s.name.empty())
      out += text(
          kWidth - kRight - 4, kTop + 10 + 13 * static_cast<double>(k), "end", s.name,
          // A rim of the ground, so that a curve beneath does not cross it out.
          fmt::format("style=\"fill:{};paint-order:stroke;stroke:var(--surface);stroke-width:4px\"", colour)
              .c_str());
  }
  return out;
}

std::string draw_histogram(const Figure& f) {
  std::vector<double> v;
  if (!f.series.empty())
    for (double y : f.series[0].y)
      if (std::isfinite(y)) v.push_back(y);
  if (v.empty()) return "<p class=\"none\">nothing to show</p>";
  std::sort(v.begin(), v.end());
  const auto at = [&](double q) {
    return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
  };
  double a = at(0.002), b = at(0.998);
  widen(a, b);
  const std::size_t bars = std::clamp<std::size_t>(v.size() / 8, 8, 80);
  std::vector<double> count(bars, 0);
  for (double y : v)
    if (y >= a && y <= b)
      count[std::min(bars - 1, static_cast<std::size_t>((y - a) / (b - a) * static_cast<double>(bars)))] += 1;
  double top = *std::max_element(count.begin(), count.end());
  if (f.series.size() > 1)
    for (double y : f.series[1].y) top = std::max(top, y);
  const Axis x = x_axis(a, b), y = y_axis(0, top * 1.05);
  std::string out = axes(f, x, y);
  for (std::size_t i = 0; i < bars; ++i) {
    const double left = a + (b - a) * static_cast<double>(i) / static_cast<double>(bars);
    out +=
        fmt::format(R"(<rect class="bar" x="{:.2f}" y="{:.2f}" width="{:.2f}" height="{:.2f}"/>)", x(left),
                    y(count[i]), x.length / static_cast<double>(bars) - 0.5, kHeight - kBottom - y(count[i]));
  }
  if (f.series.size() > 1) {
    std::string path;
    const Series& s = f.series[1];
    for (std::size_t i = 0; i < std::min(s.x.size(), s.y.size()); ++i)
      if (s.x[i] >= a && s.x[i] <= b)
        path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", x(s.x[i]), y(s.y[i]));
    out +=
        fmt::format(R"(<path d="{}" fill="none" style="stroke:{}" stroke-width="1.6"/>)", path, kColours[1]);
  }
  return out;
}

std::string draw_quantiles(const Figure& f) {
  std::vector<double> v;
  if (!f.series.empty())
    for (double y : f.series[0].y)
      if (std::isfinite(y)) v.push_back(y);
  if (v.size() < 3) return "<p class=\"none\">nothing to show</p>";
  std::sort(v.begin(), v.end());
  double sum = 0;
  for (double y : v) sum += y * y;
  const double s = std::sqrt(sum / static_cast<double>(v.size()));
  Figure plot = f;
  plot.series = {{"residuals", {}, {}, false}, {"normal", {}, {}, true}};
  const std::size_t points = std::min<std::size_t>(v.size(), 400);
  for (std::size_t i = 0; i < points; ++i) {
    const double p = (static_cast<double>(i) + 0.5) / static_cast<double>(points);
    plot.series[0].x.push_back(normal_quantile(p));
    plot.series[0].y.push_back(v[static_cast<std::size_t>(p * static_cast<double>(v.size()))] /
                               (s > 0 ? s : 1));
  }
  const double edge = -plot.series[0].x.front();
  plot.series[1].x = {-edge, edge};
  plot.series[1].y = {-edge, edge};
  if (plot.x_label.empty()) plot.x_label = "quantile of a normal distribution";
  if (plot.y_label.empty()) plot.y_label = "quantile of the residuals [RMS]";
  return draw_series(plot);
}

/// Dark blue to yellow, the middle of viridis.
std::string colour_of(double share) {
  static constexpr double kStops[5][3] = {
      {68, 1, 84}, {59, 82, 139}, {33, 145, 140}, {94, 201, 98}, {253, 231, 37}};
  const double at = std::clamp(share, 0.0, 1.0) * 4;
  const int i = std::min(3, static_cast<int>(at));
  const double t = at - i;
  int rgb[3];
  for (int k = 0; k < 3; ++k)
    rgb[k] = static_cast<int>(std::lround(kStops[i][k] * (1 - t) + kStops[i + 1][k] * t));
  return fmt::format("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2]);
}

/// At most six: 1, 2, 5, 10 … of which three lie on the scale of colours, where it is wide enough.
std::vector<double> contour_levels(double low, double largest, double high) {
  std::vector<double> levels = axis_ticks(low, high, 4);
  for (double v = 2 * high; v < largest && levels.size() < 6; v *= 4) {
    const double ten = std::pow(10, std::floor(std::log10(v)));
    levels.push_back((v / ten < 2 ? 2 : v / ten < 5 ? 5 : 10) * ten);
  }
  return levels;
}

std::string draw_map(const Figure& f) {
  if (f.columns <= 0 || f.values.empty()) return "<p class=\"none\">nothing to show</p>";
  std::vector<double> good;
  for (double v : f.values)
    if (std::isfinite(v)) good.push_back(v);
  if (good.empty()) return "<p class=\"none\">nothing to show</p>";
  std::sort(good.begin(), good.end());
  // The far corners of a weak lens model must not take all colours for themselves: the scale ends well above
  // what is typical, and what lies beyond is grey and says so.
  const auto quantile = [&](double q) {
    return good[static_cast<std::size_t>(q * static_cast<double>(good.size() - 1))];
  };
  const double low = good.front(), typical = quantile(0.5);
  const double high =
      std::min(good.back(), std::max(quantile(0.75), typical + 3 * (typical - quantile(0.05))));
  const int rows = static_cast<int>(f.values.size()) / f.columns;
  const Axis x = x_axis(f.x_from, f.x_to), y{f.y_from, f.y_to, kTop, kHeight - kTop - kBottom};
  std::string out;
  const double w = x.length / f.columns, h = y.length / rows;
  const auto at = [&](int r, int c) { return f.values[static_cast<std::size_t>(r * f.columns + c)]; };
  bool beyond = false;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < f.columns; ++c) {
      const double v = at(r, c);
      if (!std::isfinite(v)) continue;
      beyond = beyond || v > high;
      out += fmt::format(
          R"(<rect x="{:.2f}" y="{:.2f}" width="{:.2f}" height="{:.2f}" fill="{}"><title>{:.3g}</title></rect>)",
          kLeft + w * c, kTop + h * r, w + 0.4, h + 0.4,
          v > high ? "#bdbdbd" : colour_of(high > low ? (v - low) / (high - low) : 0.5), v);
    }
  // Lines of equal height at round values, between the cells' middles (marching squares).
  const auto levels = good.back() > low ? contour_levels(low, good.back(), high) : std::vector<double>{};
  for (const double level : levels) {
    std::string path;
    double label_x = 0, label_y = 0;
    for (int r = 0; r + 1 < rows; ++r)
      for (int c = 0; c + 1 < f.columns; ++c) {
        const double v[4] = {at(r, c), at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)};
        static constexpr double kX[4] = {0, 1, 1, 0}, kY[4] = {0, 0, 1, 1};
        double px[4], py[4];
        int n = 0;
        for (int i = 0; i < 4; ++i) {
          const int k = (i + 1) % 4;
          if (!std::isfinite(v[i]) || !std::isfinite(v[k]) || (v[i] < level) == (v[k] < level)) continue;
          const double share = (level - v[i]) / (v[k] - v[i]);
          px[n] = kLeft + w * (c + 0.5 + kX[i] + share * (kX[k] - kX[i]));
          py[n++] = kTop + h * (r + 0.5 + kY[i] + share * (kY[k] - kY[i]));
        }
        for (int i = 0; i + 1 < n; i += 2)
          path += fmt::format("M{:.1f} {:.1f}L{:.1f} {:.1f}", px[i], py[i], px[i + 1], py[i + 1]);
        if (n >= 2) label_x = px[0], label_y = py[0];
      }
    if (path.empty()) continue;
    out += fmt::format(R"(<path d="{}" fill="none" stroke="#fff" stroke-width="1"/>)", path);
    out += text(label_x, label_y - 2, "middle", fmt::format("{:g}", level), "style=\"fill:#fff\"");
  }
  Figure labelled = f;
  labelled.x_label +=
      fmt::format("   ·   colour: {:.3g} (dark) to {:.3g} (bright) {}{}", low, high, f.value_label,
                  beyond ? fmt::format(", grey up to {:.3g}", good.back()) : "");
  return axes(labelled, x, y) + out;
}

std::string draw_arrows(const Figure& f) {
  if (f.series.size() < 2) return "<p class=\"none\">nothing to show</p>";
  const Axis x = x_axis(f.x_from, f.x_to), y{f.y_from, f.y_to, kTop, kHeight - kTop - kBottom};
  std::string out = axes(f, x, y), path;
  const Series &at = f.series[0], &by = f.series[1];
  for (std::size_t i = 0; i < std::min(at.x.size(), by.x.size()); ++i)
    path += fmt::format("M{:.1f} {:.1f}L{:.1f} {:.1f}", x(at.x[i]), y(at.y[i]),
                        x(at.x[i] + f.stretch * by.x[i]), y(at.y[i] + f.stretch * by.y[i]));
  return out +
         fmt::format(R"(<path d="{}" fill="none" style="stroke:{}" stroke-width="1"/>)", path, kColours[0]);
}

}  // namespace

std::string svg_figure(const Figure& f) {
  std::string body;
  switch (f.kind) {
    case Figure::Kind::series:
      body = draw_series(f);
      break;
    case Figure::Kind::histogram:
      body = draw_histogram(f);
      break;
    case Figure::Kind::quantiles:
      body = draw_quantiles(f);
      break;
    case Figure::Kind::map:
      body = draw_map(f);
      break;
    case Figure::Kind::arrows:
      body = draw_arrows(f);
      break;
  }
  if (body.starts_with("<p class")) return body;
  return fmt::format(R"(<svg viewBox="0 0 {} {}" xmlns="http://www.w3.org/2000/svg" role="img">{}</svg>)",
                     kWidth, kHeight, body);
}

}  // namespace rigor

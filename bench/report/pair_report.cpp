#include "bench/report/pair_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "bench/page/page.h"
#include "bench/page/svg.h"
#include "rt-core/numbers.h"

namespace rigor {
namespace {

using nlohmann::json;

double number(const json& v) { return v.is_number() ? v.get<double>() : kNaN; }

/// What one strip shows over the windows.
struct Strip {
  std::string title;
  std::vector<double> y;
  double middle = kNaN, half = kNaN;  ///< a band: the baseline
  double line = kNaN;                 ///< a threshold
  bool from_zero = false;
};

struct Times {
  std::vector<double> t_s;
  std::optional<double> since_s, raised_s;  ///< of the last alarm
  double watched_from_s = kNaN;             ///< where the baseline ends
};

std::string label(double x, double y, const char* anchor, const std::string& text) {
  return fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}" font-size="10">{}</text>)", x, y, anchor,
                     html_text(text));
}

std::string strip_svg(const Strip& s, const Times& times) {
  double low = INFINITY, high = -INFINITY;
  const auto include = [&](double v) {
    if (std::isfinite(v)) low = std::min(low, v), high = std::max(high, v);
  };
  for (const double v : s.y) include(v);
  if (!(low <= high)) return {};
  if (std::isfinite(s.half)) include(s.middle - s.half), include(s.middle + s.half);
  include(s.line);
  if (s.from_zero) include(0);
  const double pad = std::max((high - low) * 0.08, 1e-12 + std::abs(high) * 1e-6);
  high += pad;
  if (!s.from_zero) low -= pad;
  PlotFrame f;
  f.width = 270, f.height = 116, f.left = 54, f.top = 20, f.right = 8, f.bottom = 20;
  f.x0 = times.t_s.front(), f.x1 = std::max(times.t_s.back(), f.x0 + 1e-3);
  f.y0 = low, f.y1 = high;
  const double bottom = f.top + f.plot_height();
  const auto px = [&](double t) { return f.px(std::clamp(t, f.x0, f.x1)); };
  std::string out = open_plot(f, "width:270px;height:116px") + open_data(f);
  if (std::isfinite(s.half) && s.half > 0)
    out += fmt::format(
        R"x(<rect x="{}" y="{:.1f}" width="{}" height="{:.1f}" style="fill:var(--band)"><title>baseline, 3 standard deviations</title></rect>)x",
        f.left, f.py(s.middle + s.half), f.plot_width(),
        std::max(0.5, f.py(s.middle - s.half) - f.py(s.middle + s.half)));
  if (std::isfinite(s.line) && s.line < high)  // beyond the threshold
    out += fmt::format(R"(<rect class="region" x="{}" y="{}" width="{}" height="{:.1f}"/>)", f.left, f.top,
                       f.plot_width(), f.py(s.line) - f.top);
  if (times.since_s)
    out += fmt::format(R"(<rect class="region" x="{:.1f}" y="{}" width="{:.1f}" height="{}"/>)",
                       px(*times.since_s), f.top, std::max(1.0, px(*times.raised_s) - px(*times.since_s)),
                       f.plot_height());
  if (std::isfinite(times.watched_from_s))
    out += fmt::format(
        R"(<path class="axis" d="M{0:.1f} {1}V{2}" stroke-dasharray="1 3" vector-effect="non-scaling-stroke"/>)",
        px(times.watched_from_s), f.top, bottom);
  if (times.raised_s)
    out += fmt::format(
        R"(<path class="limit" d="M{0:.1f} {1}V{2}" stroke-width="1.4" vector-effect="non-scaling-stroke"><title>alarm at {3:.1f} s</title></path>)",
        px(*times.raised_s), f.top, bottom, *times.raised_s);
  if (std::isfinite(s.line))
    out += fmt::format(
        R"(<path class="limit" d="M{} {:.1f}h{}" stroke-dasharray="4 3" vector-effect="non-scaling-stroke"/>)",
        f.left, f.py(s.line), f.plot_width());
  std::string points;
  for (std::size_t i = 0; i < s.y.size(); ++i)
    if (std::isfinite(s.y[i])) points += fmt::format("{:.2f},{:.2f} ", px(times.t_s[i]), f.py(s.y[i]));
  if (!points.empty()) out += plot_line(s.title, "var(--series-1)", points);
  out += fmt::format(R"(</svg><path class="axis" d="M{0} {1}V{2}H{3}"/>)", f.left, f.top, bottom,
                     f.left + f.plot_width());
  for (const double v : axis_ticks(low, high, 3))
    out += label(f.left - 4, f.py(v) + 3, "end", fmt::format("{:.4g}", v));
  for (const double t : axis_ticks(f.x0, f.x1, 4)) out += x_label(f, t, fmt::format("{:g}", t));
  return out + label(f.left, 12, "start", s.title) + "</svg>";
}

std::string with_unit(const std::string& name, const std::string& unit) {
  return unit.empty() || unit == "1" ? name : name + " [" + unit + "]";
}

std::string parameter_table(const json& parameters) {
  std::string s =
      "<details><summary>parameters</summary><table><tr><th class=\"l\">parameter</th><th>baseline</th>"
      "<th>scatter of windows</th><th>newest window</th><th>its sigma</th><th>level (1: alarm)</th></tr>";
  const auto cell = [](const json& p, const char* key) {
    return p.contains(key) && p[key].is_number() ? fmt::format("{:.4g}", p[key].get<double>())
                                                 : std::string("–");
  };
  for (const json& p : parameters)
    s += fmt::format(
        "<tr><td class=\"l\">{}{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
        html_text(with_unit(p["name"], p["unit"])),
        p.value("unsettled", false) ? " (unsettled: the baseline is too short)" : "", cell(p, "mean"),
        cell(p, "scatter"), cell(p, "value"), cell(p, "sigma"),
        p["watched"].get<bool>() ? cell(p, "level") : "–");
  return s + "</table></details>";
}

}  // namespace

std::string pair_watch_card(const std::string& channel, const json& w, const std::string& unit) {
  const std::string state = w["state"];
  std::string s = fmt::format(
      "<div class=\"card\" style=\"grid-column:1/-1\"><h3>{}: does the simulation still match?</h3><p>",
      html_text(channel));
  if (w["alarms"].get<std::uint64_t>() > 0)
    s += fmt::format("<b style=\"color:var(--bad)\">{} at {:.1f} s: {}.</b> ",
                     state == "alarm" ? "Alarm" : "Alarm (acknowledged)",
                     w["alarm"]["raised_s"].get<double>(), html_text(w["text"].get<std::string>()));
  else if (state == "learning")
    s += fmt::format("Learning: {} of {} windows of the baseline. ", w["learned"].get<std::uint64_t>(),
                     w["baseline_windows"].get<std::uint64_t>());
  else
    s += "No change against the baseline. ";
  s += fmt::format("{} windows.</p>", w["windows"].get<std::uint64_t>());
  const json series = w.value("series", json::array());
  if (series.empty()) return s + "</div>";

  Times times;
  std::vector<double> bias, sigma, left, shift, features, level;
  for (const json& window : series) {
    times.t_s.push_back(window["t_s"]);
    if (window["state"] == "learning") times.watched_from_s = window["t_s"];
    bias.push_back(number(window["bias"])), sigma.push_back(number(window["sigma_all"]));
    left.push_back(number(window["left"])), shift.push_back(number(window["shift_px"]));
    features.push_back(number(window["features_px"]));
    double highest = kNaN;
    for (const json& l : window["level"])
      if (const double v = number(l); std::isfinite(v) && !(v <= highest)) highest = v;
    level.push_back(window["state"] == "learning" ? kNaN : highest);
  }
  if (w.contains("alarm")) times.since_s = w["alarm"]["since_s"], times.raised_s = w["alarm"]["raised_s"];

  s += "<div style=\"display:flex;flex-wrap:wrap;gap:4px\">";
  s += strip_svg({"highest sum over its threshold", level, kNaN, kNaN, 1, true}, times);
  s += strip_svg({with_unit("bias real − simulated", unit), bias}, times);
  s += strip_svg({with_unit("sigma real − simulated", unit), sigma}, times);
  s += strip_svg({with_unit("residual left by the fit, rms", unit), left}, times);
  s += strip_svg({"shift by focal length and mount, rms [px]", shift}, times);
  s += strip_svg({"features apart after that, rms [px]", features}, times);
  const json& parameters = w["parameters"];
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const json& p = parameters[i];
    Strip strip{with_unit(p["name"], p["unit"]), {}};
    for (const json& window : series)
      strip.y.push_back(i < window["value"].size() ? number(window["value"][i]) : kNaN);
    if (p["watched"].get<bool>()) strip.middle = number(p["mean"]), strip.half = 3 * number(p["scatter"]);
    s += strip_svg(strip, times);
  }
  return s +
         "</div><p>Time in seconds. Blue band: the baseline, ± 3 standard deviations of its windows (as the "
         "watch takes them); dotted: from here on changes are watched for; red: from the estimated beginning "
         "of the change to the alarm.</p>" +
         parameter_table(parameters) + "</div>";
}

}  // namespace rigor

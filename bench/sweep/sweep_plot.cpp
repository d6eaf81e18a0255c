#include "bench/sweep/sweep_plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "bench/page/page.h"
#include "bench/page/svg.h"

namespace rigor::sweep {
namespace {

std::optional<double> number_of(const std::string& text) {
  double v = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), v);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(v)) return std::nullopt;
  return v;
}

/// Equal parts of the axis; those without runs are left out.
std::vector<Group> bins(const std::vector<double>& x, bool logarithmic) {
  const auto [low, high] = std::ranges::minmax(x);
  const double width = (high - low) / static_cast<double>(kBins);
  std::vector<Group> groups(kBins);
  for (std::uint64_t i = 0; i < x.size(); ++i) {
    const auto bin = static_cast<std::size_t>((x[i] - low) / width);
    Group& g = groups[std::min(bin, kBins - 1)];
    g.runs.push_back(i);
    g.x += x[i];
  }
  std::erase_if(groups, [](const Group& g) { return g.runs.empty(); });
  for (Group& g : groups) {
    g.x /= static_cast<double>(g.runs.size());
    g.label = fmt::format("{:.4g}", logarithmic ? std::pow(10, g.x) : g.x);
  }
  return groups;
}

std::string cut(const std::string& text, std::size_t most) {
  return text.size() <= most || most < 2 ? text : "…" + text.substr(text.size() - most + 1);
}

}  // namespace

Axis axis_of(const SweepPlan& plan, std::size_t parameter) {
  const SweepParameter& p = plan.options().vary[parameter];
  Axis axis;
  axis.key = p.key;
  std::vector<std::string> values;
  for (std::uint64_t i = 0; i < plan.size(); ++i) values.push_back(plan.run(i).values[parameter]);
  axis.numbers = std::ranges::all_of(values, [](const std::string& v) { return number_of(v).has_value(); });
  axis.logarithmic = axis.numbers && p.values.logarithmic();
  // Places on the axis: of numbers their values, of words the order in which they were listed.
  std::map<std::string, double> places;
  for (const std::string& word : p.values.words()) places.emplace(word, static_cast<double>(places.size()));
  for (const std::string& v : values) {
    const double x = axis.numbers ? *number_of(v) : places.at(v);
    axis.x.push_back(axis.logarithmic ? std::log10(x) : x);
  }
  std::map<double, Group> by_x;
  for (std::uint64_t i = 0; i < values.size(); ++i) {
    Group& g = by_x[axis.x[i]];
    g.label = values[i];
    g.x = axis.x[i];
    g.runs.push_back(i);
  }
  for (const auto& [x, group] : by_x) axis.same.push_back(group.runs);
  if (axis.numbers && by_x.size() > kMostGroups) {
    axis.groups = bins(axis.x, axis.logarithmic);
    return axis;
  }
  for (auto& [x, group] : by_x) axis.groups.push_back(std::move(group));
  return axis;
}

std::string sweep_plot(const Axis& axis, const std::vector<double>& values,
                       const std::vector<GroupMean>& means, PlotOf what) {
  const bool dots = what == PlotOf::runs;
  PlotFrame f;
  f.width = 400;
  f.height = 190;
  f.left = 62;
  const auto [left, right] = std::ranges::minmax(axis.x);
  const double margin = right > left ? 0.06 * (right - left) : 0.5;
  f.x0 = left - margin;
  f.x1 = right + margin;
  double low = std::numeric_limits<double>::infinity(), high = -low;
  const auto include = [&](double v) {
    if (!std::isfinite(v)) return;
    low = std::min(low, v);
    high = std::max(high, v);
  };
  if (dots)
    for (const double v : values) include(v);
  for (const GroupMean& m : means) include(m.mean), include(m.interval.from), include(m.interval.to);
  if (what == PlotOf::shares) include(0), include(1);
  if (!(high >= low)) return "<p class=\"none\">nothing to show</p>";
  const double pad = high > low ? 0.06 * (high - low) : std::max(std::abs(high) * 0.1, 0.5);
  f.y0 = low - pad;
  f.y1 = high + pad;

  std::string s = fmt::format(R"(<svg viewBox="0 0 {} {}" xmlns="http://www.w3.org/2000/svg" role="img">)",
                              f.width, f.height);
  s += fmt::format(R"(<path class="axis" d="M{0} {1}V{2}H{3}"/>)", f.left, f.top, f.top + f.plot_height(),
                   f.left + f.plot_width());
  for (const double y : axis_ticks(f.y0, f.y1, 4)) {
    if (y < f.y0 || y > f.y1) continue;
    s += fmt::format(
        R"(<path class="grid" d="M{:.1f} {:.1f}H{:.1f}"/><text x="{:.1f}" y="{:.1f}" text-anchor="end">{:.5g}</text>)",
        f.left, f.py(y), f.left + f.plot_width(), f.left - 5, f.py(y) + 3.5, y);
  }
  if (axis.numbers && !axis.logarithmic && axis.groups.size() > 6) {
    for (const double x : axis_ticks(left, right, 5))
      if (x >= f.x0 && x <= f.x1) s += x_label(f, x, fmt::format("{:.5g}", x));
  } else {
    const auto most =
        static_cast<std::size_t>(f.plot_width() / static_cast<double>(axis.groups.size()) / 5.6);
    for (const Group& g : axis.groups)
      s += x_label(f, g.x, html_text(cut(g.label, std::max<std::size_t>(most, 3))));
  }
  s += fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="middle">{}</text>)",
                   f.left + f.plot_width() / 2, f.height - 4, html_text(axis.key));
  if (dots)
    for (const std::vector<std::uint64_t>& runs : axis.same)
      for (std::size_t k = 0; k < runs.size(); ++k) {
        // Runs of one value are spread a little, so that each is seen.
        const auto n = static_cast<double>(runs.size());
        const double aside = (static_cast<double>(k) - (n - 1) / 2) * std::min(2.2, 16 / n);
        const double value = values[runs[k]];
        if (!std::isfinite(value)) continue;
        s += fmt::format(
            R"svg(<circle cx="{:.1f}" cy="{:.1f}" r="2" fill="var(--series-1)" opacity="0.35"><title>run {}: {:.6g}</title></circle>)svg",
            f.px(axis.x[runs[k]]) + aside, f.py(value), runs[k], value);
      }
  for (std::size_t k = 0; k < means.size(); ++k) {
    const double x = f.px(axis.groups[k].x);
    const GroupMean& m = means[k];
    if (!std::isfinite(m.mean)) continue;
    if (std::isfinite(m.interval.from))
      s += fmt::format(
          R"svg(<path d="M{0:.1f} {1:.1f}V{2:.1f}M{3:.1f} {1:.1f}h8M{3:.1f} {2:.1f}h8" style="stroke:var(--series-2)" stroke-width="1.6" fill="none"/>)svg",
          x, f.py(m.interval.from), f.py(m.interval.to), x - 4);
    s += fmt::format(
        R"svg(<circle cx="{:.1f}" cy="{:.1f}" r="3.6" style="fill:var(--series-2)"><title>{}: {:.6g} ({:.6g} to {:.6g}), {} runs</title></circle>)svg",
        x, f.py(m.mean), html_text(axis.groups[k].label), m.mean, m.interval.from, m.interval.to,
        axis.groups[k].runs.size());
  }
  return s + "</svg>";
}

}  // namespace rigor::sweep

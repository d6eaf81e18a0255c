#include "bench/report/fault_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/page/page.h"
#include "bench/page/svg.h"

namespace rigor {
namespace {

using nlohmann::json;

constexpr double kChartLeft_px = 150, kWidth = 690, kRow = 18;

const char* colour_of(const std::string& kind) {
  if (kind == "drop" || kind == "burst_loss" || kind == "disconnect") return "#c0392b";
  if (kind == "delay" || kind == "jitter" || kind == "slow_consumer") return "#e8a33d";
  if (kind == "timestamp" || kind == "clock_skew" || kind == "clock_step") return "#7d5ba6";
  return "#3b6ea5";
}

std::string chart_label(double x, double y, const char* anchor, const std::string& text) {
  return fmt::format(R"(<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>)", x, y, anchor,
                     html_text(text));
}

/// What the port of the channel showed over the run: a thin bar in the row's colours of the status plots.
std::string status_bar(const json& result, const std::string& channel, double y, double scale) {
  const std::string port = channel.substr(0, channel.find('.'));
  std::string s;
  for (const json& c : result["channels"]) {
    if (c["name"] != port) continue;
    const json& spans = c["status"];
    for (std::size_t i = 0; i < spans.size(); ++i) {
      const double from = spans[i]["t_s"],
                   to = i + 1 < spans.size() ? spans[i + 1]["t_s"] : result["duration_s"];
      const std::string status = spans[i]["status"];
      const char* known =
          status == "overdue" || status == "disconnected" || status == "never" ? status.c_str() : "fresh";
      s += fmt::format(
          R"(<rect x="{:.2f}" y="{:.1f}" width="{:.2f}" height="10" class="status-{}"><title>{} from {:.3f} s</title></rect>)",
          kChartLeft_px + from * scale, y + 3, std::max(0.5, (to - from) * scale), known, status, from);
    }
  }
  return s;
}

std::string timeline(const json& result) {
  const double duration_s = std::max(1e-3, result["duration_s"].get<double>()), scale = kWidth / duration_s;
  std::string rows;
  double y = 4;
  for (const json& c : result["faults"]) {
    const std::string channel = c["channel"];
    rows += chart_label(kChartLeft_px - 8, y + 12, "end", channel) + status_bar(result, channel, y, scale);
    y += kRow;
    for (const json& f : c["faults"]) {
      const std::string kind = f["kind"];
      rows += chart_label(kChartLeft_px - 8, y + 12, "end", kind + (f["live"].get<bool>() ? " (live)" : ""));
      rows += fmt::format(R"(<path class="grid" d="M{} {:.1f}h{}"/>)", kChartLeft_px, y + 8, kWidth);
      for (const json& span : f["spans"]) {
        const double from = span[0], to = std::min(duration_s, span[1].get<double>());
        rows += fmt::format(
            R"(<rect x="{:.2f}" y="{:.1f}" width="{:.2f}" height="12" fill="{}"><title>{} from {:.3f} to {:.3f} s</title></rect>)",
            kChartLeft_px + from * scale, y + 2, std::max(1.0, (to - from) * scale), colour_of(kind),
            html_text(f["text"].get<std::string>()), from, to);
      }
      y += kRow;
    }
    y += 6;
  }
  for (const double t : axis_ticks(0, duration_s, 8))
    rows += chart_label(kChartLeft_px + t * scale, y + 12, "middle", fmt::format("{:g}", t));
  rows += chart_label(kChartLeft_px + kWidth / 2, y + 28, "middle",
                      "time [s]; green: fresh and held, orange: overdue, red: disconnected");
  return fmt::format(R"(<svg viewBox="0 0 {0:.0f} {1:.0f}" style="width:100%;max-width:{0:.0f}px">{2}</svg>)",
                     kChartLeft_px + kWidth + 20, y + 34, rows);
}

std::string number(const json& j, const char* key) {
  return j.contains(key) ? fmt::format("{}", j[key].get<std::uint64_t>()) : "";
}

}  // namespace

std::string faults_section(const json& result) {
  if (!result.contains("faults")) return {};
  std::string s = "<h2>Faults</h2><div class=\"card\">" + timeline(result) +
                  "</div><table><tr><th>channel</th><th class=\"l\">fault</th><th>times on</th><th>samples "
                  "seen</th><th>dropped</th><th>changed</th><th>delayed</th></tr>";
  for (const json& c : result["faults"]) {
    const auto row = [&](const std::string& what, const json& f) {
      s += fmt::format(
          "<tr><td>{}</td><td "
          "class=\"l\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
          html_text(c["channel"].get<std::string>()), what, number(f, "times"), number(f, "seen"),
          number(f, "dropped"), number(f, "changed"), number(f, "delayed"));
    };
    if (c.contains("earlier")) row(number(c["earlier"], "faults") + " earlier live ones", c["earlier"]);
    for (const json& f : c["faults"])
      row(fmt::format("{}<code>{}</code>", f["live"].get<bool>() ? "live " : "",
                      html_text(f["text"].get<std::string>())),
          f);
  }
  s += "</table><h3>Every sample accounted for</h3><table><tr><th>channel</th><th>taken from the "
       "source</th><th>handed on</th><th>dropped</th><th>disconnected</th><th>no slot</th><th>waiting at the "
       "end</th></tr>";
  for (const json& c : result["faults"])
    if (c.contains("taken"))
      s += fmt::format(
          "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
          html_text(c["channel"].get<std::string>()), number(c, "taken"), number(c, "handed_on"),
          number(c, "dropped"), number(c, "disconnected"), number(c, "no_slot"), number(c, "waiting"));
  return s + "</table>";
}

}  // namespace rigor

#include "bench/report/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "bench/console/terminal.h"
#include "bench/control/pair_snapshot.h"
#include "bench/files/picture_file.h"
#include "bench/page/page.h"
#include "bench/page/svg.h"
#include "bench/report/fault_report.h"
#include "bench/report/pair_report.h"
#include "bench/result/report_json.h"
#include "bench/result/verdict_forms.h"
#include "sim/world/store/value_codec.h"

namespace rigor {
namespace {

using nlohmann::json;

std::string html(const std::string& text) { return html_text(text); }
std::string str(const json& v) { return html(v.get<std::string>()); }
std::string ns(const json& v) { return text_of(Duration(v.get<std::int64_t>())); }
std::string count(const json& v) { return fmt::format("{}", v.get<std::uint64_t>()); }

std::string tile(const std::string& value, const std::string& what, bool bad = false) {
  return fmt::format("<div class=\"tile{}\"><b>{}</b><span>{}</span></div>", bad ? " bad" : "", value, what);
}

/// Of a loop that follows the wall clock: in virtual time these numbers say how fast the host is and no more.
std::string loop_section(const json& r) {
  if (r["clock"] != "wall") return {};
  const json& loop = r["loop"];
  const double period_ns = 1e9 / loop["rate_hz"].get<double>();
  const auto skipped = loop["cycles_skipped"].get<std::uint64_t>(),
             misses = loop["misses"]["total"].get<std::uint64_t>();
  std::string s = "<h2>The loop</h2><div class=\"tiles\">";
  s += tile(count(loop["cycles_run"]), "cycles run") +
       tile(count(loop["cycles_skipped"]), "skipped", skipped > 0) +
       tile(count(loop["overruns"]), "overruns") +
       tile(fmt::format("{}", misses), "misses, attributed below") +
       tile(ns(loop["wake_error"]["p50_ns"]), "wake-up error p50") +
       tile(ns(loop["wake_error"]["p99_ns"]), "wake-up error p99") +
       tile(ns(loop["cycle_time"]["p99_ns"]), "cycle time p99");
  s += "</div><p class=\"words\">A cycle is one pass of the loop. p50: half of the values are at most this; "
       "p99: 99 of "
       "100. Red bars took longer than the period of a cycle.</p><div class=\"cards\">";
  s += "<div class=\"card\"><h3>Wake-up error</h3>" +
       svg_histogram(loop["wake_error"], "wake-up after its grid point (counts, log)", period_ns) + "</div>";
  s += "<div class=\"card\"><h3>Time in a cycle</h3>" +
       svg_histogram(loop["cycle_time"], "first step to last (counts, log)", period_ns) + "</div>";
  s += "<div class=\"card\"><h3>Misses and their causes</h3><table><tr><th>cause</th><th>number</th></tr>";
  for (const auto& [cause, n] : loop["misses"]["by_cause"].items())
    s += fmt::format("<tr><td>{}</td><td>{}</td></tr>", html(cause), n.get<std::uint64_t>());
  s += "</table><details><summary>each of them</summary><table>";
  for (const json& m : loop["misses"]["list"]) s += "<tr><td>" + str(m["text"]) + "</td></tr>";
  s += "</table></details></div>";
  s += "<div class=\"card\"><h3>Steps</h3><table><tr><th>step</th><th>p50</th><th>p99</th><th>max</th></tr>";
  for (const json& step : loop.value("steps", json::array()))
    s += fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>", str(step["name"]),
                     ns(step["ran"]["p50_ns"]), ns(step["ran"]["p99_ns"]), ns(step["ran"]["max_ns"]));
  s += "</table><h3 style=\"margin-top:12px\">What the machine granted</h3><table>";
  for (const json& g : loop.value("settings", json::array()))
    s += fmt::format("<tr><td>{}</td><td class=\"l\">{}</td><td class=\"l\">{}</td></tr>", str(g["name"]),
                     g["granted"].get<bool>()  ? "granted"
                     : g["wanted"].get<bool>() ? "<span class=\"note\">not granted</span>"
                                               : "not asked for",
                     str(g["text"]));
  return s + "</table></div></div>";
}

/// A cell whose colour says how bad the number is: the limits of `lost` and `late` in docs/verdict.md.
std::string judged(const json& c, const char* key) {
  const auto n = c[key].get<std::uint64_t>();
  const bool lost = std::string_view(key) == "missing";
  const double share =
      static_cast<double>(n) /
      std::max(1.0, c["due"].is_number() ? c["due"].get<double>() : c["delivered"].get<double>());
  const char* level = share >= (lost ? 0.05 : 0.2) ? " class=\"bad\""
                      : share >= 0.01              ? " class=\"warning\""
                                                   : "";
  return fmt::format("<td{}>{}</td>", level, n);
}

/// What the rig expected.
std::string expect_section(const json& r) {
  const auto all = r.find("expect");
  if (all == r.end()) return "";
  std::string s =
      "<h2>Expectations</h2><div class=\"wide\"><table><tr><th class=\"l\">of</th><th "
      "class=\"l\">quantity</th>"
      "<th class=\"l\">expected</th><th class=\"l\">came out</th></tr>";
  for (const json& e : *all) {
    const bool holds = e["holds"] == true;
    s += fmt::format(
        "<tr><td class=\"l\">{}</td><td class=\"l\">{}</td><td class=\"l\">{}</td><td "
        "class=\"l{}\">{}{}</td></tr>",
        str(e["of"]), str(e["quantity"]), str(e["bounds"]), holds ? "" : " bad", holds ? "holds: " : "",
        str(e["outcome"]));
  }
  return s + "</table></div>";
}

/// What left for other programs and what they commanded.
std::string bridges_section(const json& r) {
  std::string s;
  if (!r.contains("bridges")) return s;
  for (const json& b : r["bridges"]) {
    s += fmt::format(
        "<h2>Bridge {}</h2><div class=\"wide\"><table><tr><th>topic</th><th class=\"l\">type</th><th "
        "class=\"l\">quality of service</th><th>messages</th><th>dropped</th><th>subscribers</th></tr>",
        str(b["name"]));
    for (const json& t : b["topics"])
      s += fmt::format(
          "<tr><td>{}</td><td class=\"l\">{}</td><td "
          "class=\"l\">{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
          str(t["topic"]), str(t["type"]), str(t["qos"]), count(t["messages"]), count(t["dropped"]),
          count(t["peers"]));
    s += "</table></div>";
    if (b["commands"].empty()) continue;
    s += "<div class=\"wide\"><table><tr><th>commands</th><th class=\"l\">type</th><th "
         "class=\"l\">sink</th><th>received</th><th>given</th><th>rejected</th></tr>";
    for (const json& c : b["commands"])
      s += fmt::format(
          "<tr><td>{}</td><td class=\"l\">{}</td><td "
          "class=\"l\">{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
          str(c["topic"]), str(c["type"]), str(c["sink"]), count(c["received"]), count(c["accepted"]),
          count(c["rejected"]));
    s += "</table></div>";
  }
  return s;
}

/// Of an application that is called in turns.
std::string application_section(const json& r) {
  const auto a = r.find("application");
  if (a == r.end()) return "";
  std::string s =
      "<h2>Application</h2><div class=\"wide\"><table><tr><th "
      "class=\"l\">program</th><th>turns</th><th>answered</th>"
      "<th title=\"answers that were not there at their deadline\">late</th><th title=\"turns that were due "
      "and not "
      "given: it was still busy, or not there\">skipped</th><th>restarts</th><th title=\"from turn to "
      "answer\">answer "
      "p50</th><th title=\"from turn to answer\">answer p99</th><th>samples delivered</th><th "
      "title=\"pictures "
      "and scans "
      "that a newer one overtook before its turn\">superseded</th><th title=\"it was away for too long, or "
      "was started "
      "again\">dropped</th></tr>";
  const json& samples = (*a)["samples"];
  s += fmt::format("<tr><td class=\"l\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>",
                   str((*a)["name"]), count((*a)["turns"]), count((*a)["answered"]), count((*a)["late"]),
                   count((*a)["skipped"]), count((*a)["restarts"]));
  s += a->contains("answer")
           ? fmt::format("<td>{}</td><td>{}</td>", ns((*a)["answer"]["p50_ns"]), ns((*a)["answer"]["p99_ns"]))
           : std::string("<td>–</td><td>–</td>");
  return s + fmt::format("<td>{}</td><td>{}</td><td>{}</td></tr></table></div>", count(samples["delivered"]),
                         count(samples["superseded"]), count(samples["dropped"]));
}

std::string channel_table(const json& r) {
  std::string s =
      "<h2>Channels</h2><div class=\"wide\"><table><tr><th>channel</th><th class=\"l\">backend</th><th "
      "title=\"delivered samples over the time in which they were due\">rate, of nominal</th><th title=\"by "
      "rate and latency, within the run\">samples due</th><th title=\"that became visible to the "
      "application\">delivered</th><th title=\"due and not delivered\">missing</th><th title=\"arrived after "
      "their release\">late</th><th title=\"capture of the last sample\">silent since</th><th title=\"jumps "
      "in the sequence of samples\">gaps</th><th title=\"from capture until visible to the application: half "
      "of the samples are at most this old\">age p50</th><th title=\"from capture until visible to the "
      "application: 99 of 100 samples are at most this old\">age p99</th><th title=\"from capture until "
      "arrival at the bench: 99 of 100 samples take at most this long\">arrival p99</th></tr>";
  for (const json& c : r["channels"]) {
    s += fmt::format(
        "<tr><td>{}</td><td class=\"l\">{}{}</td><td>{}</td><td>{}</td><td>{}</td>{}{}"
        "<td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
        str(c["name"]), str(c["backend"]),
        c["replaced_by"].get<std::string>().empty() ? "" : " (replaced by " + str(c["replaced_by"]) + ")",
        c["due"].is_number() ? fmt::format("{:.2f} of {:.2f} Hz", c["rate_hz"].get<double>(),
                                           c["nominal_rate_hz"].get<double>())
                             : std::string("no rate"),
        c["due"].is_number() ? count(c["due"]) : "–", count(c["delivered"]), judged(c, "missing"),
        judged(c, "late_samples"),
        c["silent_since_s"].is_number() ? fmt::format("{:.1f} s", c["silent_since_s"].get<double>()) : "",
        count(c["gap_count"]), ns(c["age"]["p50_ns"]), ns(c["age"]["p99_ns"]), ns(c["arrival"]["p99_ns"]));
  }
  s += "</table></div>";
  if (!r["sinks"].empty()) {
    s += "<h2>Commands</h2><div class=\"wide\"><table><tr><th>sink</th><th "
         "class=\"l\">backend</th><th>accepted</th><th>applied</th><th>late</th><th>failed</th><th>dropped</"
         "th><th>made safe</th></tr>";
    for (const json& k : r["sinks"])
      s += fmt::format(
          "<tr><td>{}</td><td "
          "class=\"l\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
          str(k["name"]), str(k["backend"]), count(k["accepted"]), count(k["applied"]), count(k["late"]),
          count(k["failed"]), count(k["dropped"]), count(k["made_safe"]));
    s += "</table></div>";
  }
  return s + bridges_section(r) + application_section(r);
}

std::string pair_card(const json& c) {
  const json& p = c["pair"];
  std::string s = fmt::format("<div class=\"card\"><h3>{}: real against simulated</h3>", str(c["name"]));
  if (p["count"].get<std::uint64_t>() == 0) {
    s += "<p class=\"note\">" + html(pair_line(p)) + "</p>";
  } else {
    const std::string unit = html(p.value("unit", ""));
    s += fmt::format(
        "<table><tr><th>compared</th><th>bias</th><th>sigma</th><th>real missing</th><th>simulated "
        "missing</th></tr><tr><td>{}</td><td>{:.3f} {}</td><td>{:.3f} "
        "{}</td><td>{}</td><td>{}</td></tr></table>",
        count(p["count"]), p["bias"].get<double>(), unit, p["sigma"].get<double>(), unit,
        count(p["real_missing"]), count(p["simulated_missing"]));
  }
  if (const json values = p.value("values", json::array()); !values.empty()) {
    s += "<table><tr><th></th><th>bias</th><th>sigma</th></tr>";
    for (const json& v : values)
      s += fmt::format("<tr><td>{}</td><td>{:.4g} {}</td><td>{:.4g} {}</td></tr>", str(v["name"]),
                       v["bias"].get<double>(), str(v["unit"]), v["sigma"].get<double>(), str(v["unit"]));
    s += "</table>";
  }
  SvgSeries bias{"bias", "var(--series-1)", {}, {}}, sigma{"sigma", "var(--series-2)", {}, {}};
  for (const json& point : p.value("series", json::array())) {
    bias.x.push_back(point["t_s"]);
    bias.y.push_back(point["bias"]);
    sigma.x.push_back(point["t_s"]);
    sigma.y.push_back(point["sigma"]);
  }
  if (!bias.x.empty())
    s += svg_lines({bias, sigma}, "time [s]",
                   "difference real − simulated [" + html(p.value("unit", "")) + "]");
  s += "</div>";
  if (p.contains("watch")) s += pair_watch_card(c["name"], p["watch"], p.value("unit", ""));
  return s;
}

using NamedFiles = std::vector<std::pair<std::string, std::string>>;

std::string channel_section(const json& r, const NamedFiles& pictures) {
  std::string s = "<h2>Time and pictures, channel by channel</h2><div class=\"cards\">";
  for (const json& c : r["channels"]) {
    s += "<div class=\"card\"><h3>" + str(c["name"]) + "</h3>" +
         svg_histogram(c["age"], "age when it became visible (counts, log)");
    // What arrives after its release is late.
    const double latency_ns = c["latency_ms"].get<double>() * 1e6;
    s += svg_histogram(c["arrival"], "arrival after capture (counts, log)",
                       latency_ns > 0 ? std::optional(latency_ns) : std::nullopt);
    s += svg_status(c["status"], r["duration_s"]);
    if (!c["gaps"].empty()) {
      s += "<details><summary>gaps</summary><table><tr><th>at</th><th>missing</th></tr>";
      for (const json& g : c["gaps"])
        s +=
            fmt::format("<tr><td>{:.3f} s</td><td>{}</td></tr>", g["t_s"].get<double>(), count(g["missing"]));
      s += "</table></details>";
    }
    if (c.contains("pictures")) {
      s += "<div class=\"pictures\">";
      for (const json& p : c["pictures"])
        for (const auto& [file, bytes] : pictures)
          if (p["file"] == file)  // in the page itself: it is one file
            s += fmt::format(
                "<figure><img src=\"data:image/png;base64,{}\" "
                "alt=\"{}\"><figcaption>{}</figcaption></figure>",
                world::store::base64(std::as_bytes(std::span(bytes))), html(file), str(p["caption"]));
      s += "</div>";
    }
    s += "</div>";
    if (c.contains("pair")) s += pair_card(c);
  }
  return s + "</div>";
}

/// What was run, with what and where.
std::string about_section(const json& r) {
  std::string s = "<h2>About this run</h2><div class=\"card\"><table class=\"facts\">";
  const auto row = [&](const char* name, const std::string& value) {
    s += fmt::format("<tr><td>{}</td><td>{}</td></tr>", name, value);
  };
  row("Rigor", str(r["version"]));
  row("Command", "<code>" + str(r["command"]) + "</code>");
  row("Rig", "<code>" + str(r["file"]) + "</code>, seed " + count(r["seed"]));
  row("Machine", str(r["machine"]));
  row("Renderer", str(r["renderer"]));
  if (r.contains("recording"))
    row("Recording",
        fmt::format("<code>{}</code>: {} messages, {:.1f} MB, {} dropped", str(r["recording"]["file"]),
                    count(r["recording"]["messages"]), r["recording"]["bytes"].get<double>() * 1e-6,
                    count(r["recording"]["dropped"])));
  if (r["input_sha256"].is_string()) {
    const std::string seen = r["input_sha256"];
    row("Input digest",
        fmt::format(
            "<code>{}</code> (SHA-256 over every sample that the application received; a replay gives "
            "the same)",
            seen.empty() ? "not known: its computation could not keep up" : seen));
  }
  return s + "</table></div>";
}

}  // namespace

Status write_report(const std::filesystem::path& dir, RunReport& report, const RunParts& parts,
                    Existing existing) {
  NamedFiles files;
  for (std::size_t i = 0; i < parts.channels.size(); ++i) {
    const RunChannel& c = *parts.channels[i];
    const auto add = [&](const SampleLease& sample, const std::string& which) -> Status {
      const auto* image = sample ? sample->as<ImageInfo>() : nullptr;
      if (!image) return {};
      auto picture = picture_bytes(".png", *image, sample->bytes());
      if (!picture) return tl::unexpected<Error>(picture.error());
      files.emplace_back(c.entry->name + "-" + which + ".png", std::move(*picture));
      report.channels[i].pictures.push_back(
          {files.back().first, fmt::format("{} picture, sequence {}", which, sample->stamp.sequence)});
      return {};
    };
    if (auto s = add(c.first_image, "first"); !s) return s;
    if (auto s = add(c.port.sample(), "last"); !s) return s;
  }
  const json result = report_json(report);
  std::string analyses;
  for (const AnalysisReport& a : report.analyses) analyses += a.html;
  files.emplace_back("result.json", result.dump(1));

  const std::string when = result["virtual_epoch"].get<bool>()
                               ? "virtual time: every virtual run begins at " + str(result["utc"])
                               : str(result["utc"]);
  std::string page =
      html_page(result["rig"],
                fmt::format("{} · {:.1f} s on the {} clock · {}", when, result["duration_s"].get<double>(),
                            str(result["clock"]), str(result["loop"]["reason"])),
                verdict_section(result["verdict"]) + expect_section(result) + channel_table(result) +
                    analyses + faults_section(result) + channel_section(result, files) +
                    loop_section(result) + about_section(result));
  files.emplace_back("index.html", std::move(page));
  return write_report_files(dir, files, existing);
}

}  // namespace rigor

#include "bench/sweep/sweep_report.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "bench/page/page.h"
#include "bench/report/typed_command.h"
#include "bench/sweep/sweep_plot.h"
#include "bench/sweep/sweep_table.h"
#include "rt-core/numbers.h"

namespace rigor::sweep {
namespace {

/// Runs with more are drawn without a dot for each.
constexpr std::size_t kMostDots = 60'000;
/// Of each metric the highest and the lowest; of each reason the first; of all the commands.
constexpr std::size_t kExtremes = 3, kOfAReason = 3, kMostCommands = 300;

using Rows = std::vector<std::optional<Row>>;

/// A metric, or an expectation as 1 where it holds and 0 where it is violated.
struct Quantity {
  std::string name;
  bool expectation = false;
  std::vector<double> values;  ///< by run; NaN: not known, or not reported
  Summary summary;
  std::vector<double> explained;              ///< by parameter
  std::vector<std::vector<GroupMean>> means;  ///< by parameter and group
  [[nodiscard]] bool varies() const { return summary.count > 1 && summary.max > summary.min; }
  [[nodiscard]] double most_explained() const {
    double most = -1;
    for (const double share : explained) most = std::isfinite(share) ? std::max(most, share) : most;
    return most;
  }
};

std::vector<Quantity> quantities_of(const Rows& rows) {
  const TableColumns columns = table_columns(rows);
  std::vector<Quantity> out;
  for (const std::string& name : columns.expectations) {
    Quantity q{name, true, std::vector<double>(rows.size(), kNaN), {}, {}, {}};
    for (std::size_t i = 0; i < rows.size(); ++i)
      if (rows[i])
        if (const auto e = std::ranges::find(rows[i]->expectations, name, &RowExpectation::name);
            e != rows[i]->expectations.end() && (e->state == "holds" || e->state == "violated"))
          q.values[i] = e->state == "holds" ? 1 : 0;
    out.push_back(std::move(q));
  }
  for (const std::string& name : columns.metrics) {
    Quantity q{name, false, std::vector<double>(rows.size(), kNaN), {}, {}, {}};
    for (std::size_t i = 0; i < rows.size(); ++i)
      if (rows[i])
        if (const auto m = rows[i]->metrics.find(name); m != rows[i]->metrics.end()) q.values[i] = m->second;
    out.push_back(std::move(q));
  }
  return out;
}

std::vector<double> known_of(const Quantity& q, const std::vector<std::uint64_t>& runs) {
  std::vector<double> values;
  for (const std::uint64_t i : runs)
    if (std::isfinite(q.values[i])) values.push_back(q.values[i]);
  return values;
}

GroupMean mean_of(const Quantity& q, const std::vector<double>& values) {
  const Summary s = summarize(values);
  if (!q.expectation || values.empty()) return {s.mean, s.mean95};
  const auto hits = static_cast<std::size_t>(std::ranges::count(values, 1.0));
  return {s.mean, wilson95(hits, values.size())};
}

void evaluate(Quantity& q, const std::vector<Axis>& axes) {
  q.summary = summarize(q.values);
  for (const Axis& axis : axes) {
    q.means.emplace_back();
    std::vector<std::vector<double>> near, same;
    for (const Group& g : axis.groups) {
      near.push_back(known_of(q, g.runs));
      q.means.back().push_back(mean_of(q, near.back()));
    }
    for (const auto& runs : axis.same) same.push_back(known_of(q, runs));
    // Where each value has one run, as samples of a range have, values near each other tell.
    const double share = explained_share(same);
    q.explained.push_back(axis.same.size() < q.values.size() ? share : explained_share(near));
  }
}

std::string number_text(double v) { return std::isfinite(v) ? fmt::format("{:.4g}", v) : "–"; }
std::string percent(double share) {
  if (!std::isfinite(share)) return "–";
  return share < 1 && share >= 0.995 ? "over 99 %" : fmt::format("{:.0f} %", 100 * share);
}
std::string range_text(const Interval95& i) {
  return std::isfinite(i.from) ? fmt::format("{:.4g} to {:.4g}", i.from, i.to) : "–";
}

/// Collects the runs whose commands the page gives.
class Commands {
 public:
  std::string link(std::uint64_t run) {
    if (runs_.size() < kMostCommands) runs_.insert(run);
    return runs_.contains(run) ? fmt::format("<a href=\"#run-{0}\">run {0}</a>", run)
                               : fmt::format("run {}", run);
  }
  [[nodiscard]] std::string section(const SweepPlan& plan, const Rows& rows) const {
    if (runs_.empty()) return "";
    std::string s =
        "<h2>To repeat a run</h2><p class=\"words\">Each command makes the run that the page names, with the "
        "same result; add <code>--report DIR</code> or <code>--record FILE.mcap</code> to look into it.</p>"
        "<div class=\"card\"><table class=\"facts\">";
    for (const std::uint64_t i : runs_)
      s += fmt::format("<tr id=\"run-{0}\"><td>run {0}{1}</td><td><code>{2}</code></td></tr>", i,
                       rows[i] && !rows[i]->passed() ? ", " + html_text(rows[i]->status) : "",
                       html_text(quoted_command(plan.command(plan.run(i)))));
    return s + "</table></div>";
  }

 private:
  std::set<std::uint64_t> runs_;
};

std::string values_of(const SweepPlan& plan, std::uint64_t index) {
  const SweepRun run = plan.run(index);
  std::vector<std::string> parts;
  for (std::size_t i = 0; i < run.values.size(); ++i)
    parts.push_back(plan.options().vary[i].key + "=" + run.values[i]);
  parts.push_back(fmt::format("seed={}", run.seed));
  return html_text(fmt::format("{}", fmt::join(parts, ", ")));
}

std::string outcome_section(const SweepPlan& plan, const Rows& rows, Commands& commands) {
  const Outcome outcome = outcome_of(rows);
  const char* state = outcome.all_passed() ? "good" : "bad";
  std::string s =
      fmt::format("<section class=\"verdict {0}\"><h2>{1}</h2>", state, html_text(outcome.text()));
  // By what was violated, the run with the largest share outside first, then that with the value farthest
  // from the bounds; else by what was said.
  struct Bad {
    std::uint64_t run = 0;
    double outside = 0, beyond = 0;
  };
  std::map<std::string, std::vector<Bad>> reasons;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!rows[i] || rows[i]->passed()) continue;
    if (rows[i]->status != "failed") reasons[rows[i]->status + ": " + rows[i]->reason].push_back({i});
    for (const RowExpectation& e : rows[i]->expectations)
      if (rows[i]->status == "failed" && e.state == "violated")
        reasons["not as expected: " + e.name].push_back({i, e.outside, e.beyond});
  }
  if (reasons.empty()) return s + "</section>";
  // The most frequent first.
  std::vector<std::pair<std::string, std::vector<Bad>>> sorted(reasons.begin(), reasons.end());
  std::ranges::stable_sort(sorted,
                           [](const auto& a, const auto& b) { return a.second.size() > b.second.size(); });
  for (auto& [reason, runs] : sorted)
    std::ranges::stable_sort(runs, [](const Bad& a, const Bad& b) {
      return std::pair(a.outside, a.beyond) > std::pair(b.outside, b.beyond);
    });
  constexpr std::size_t kShown = 50;
  s += "<ul>";
  for (std::size_t k = 0; k < std::min(kShown, sorted.size()); ++k) {
    const auto& [reason, runs] = sorted[k];
    s += fmt::format("<li class=\"bad\"><b>{} run{}</b> {}: ", runs.size(), runs.size() == 1 ? "" : "s",
                     html_text(reason));
    for (std::size_t i = 0; i < std::min(kOfAReason, runs.size()); ++i)
      s += fmt::format("{}{} ({})", i == 0 ? "" : "; ", commands.link(runs[i].run),
                       values_of(plan, runs[i].run));
    s += runs.size() > kOfAReason ? "; …</li>" : "</li>";
  }
  if (sorted.size() > kShown)
    s += fmt::format("<li>and {} other reasons: table.csv has all</li>", sorted.size() - kShown);
  return s + "</ul></section>";
}

/// "by exposure_us": the last part of each key, where that is enough to tell them apart.
std::string column_heads(const std::vector<Axis>& axes) {
  const auto last = [](const Axis& axis) { return axis.key.substr(axis.key.rfind('.') + 1); };
  std::string s;
  for (const Axis& axis : axes) {
    const bool alone = std::ranges::count(axes, last(axis), last) == 1;
    s += fmt::format("<th title=\"{}\">by {}</th>", html_text(axis.key),
                     html_text(alone ? last(axis) : axis.key));
  }
  return s;
}

std::string expectations_section(const std::vector<Quantity>& all, const std::vector<Axis>& axes) {
  std::string s;
  for (const Quantity& q : all) {
    if (!q.expectation || q.summary.count == 0) continue;
    const auto hits = static_cast<std::size_t>(std::ranges::count(q.values, 1.0));
    const Interval95 i = wilson95(hits, q.summary.count);
    s += "<tr><td>" + html_text(q.name) + "</td>";
    for (const double share : q.explained) s += "<td>" + percent(share) + "</td>";
    s += fmt::format("<td>{} of {}</td><td>{:.1f} %</td><td>{:.1f} to {:.1f} %</td></tr>", hits,
                     q.summary.count, 100 * q.summary.mean, 100 * i.from, 100 * i.to);
  }
  if (s.empty()) return "";
  return "<h2>What the rig expects</h2><div class=\"card wide\"><table><tr><th>expectation</th>" +
         column_heads(axes) +
         "<th>held in</th><th>share</th><th title=\"Wilson's interval\">95 % interval</th></tr>" + s +
         "</table></div>";
}

std::string metrics_section(const std::vector<const Quantity*>& varying, const std::vector<Axis>& axes) {
  if (std::ranges::all_of(varying, &Quantity::expectation)) return "";
  std::string s =
      "<h2>Metrics that vary</h2><p class=\"words\">The mean has a 95 % interval by Student's t. "
      "\"By KEY\" is the share of the variance that lies between values of the parameter (ε²): 0 where runs "
      "with different values differ no more than runs with the same one.</p><div class=\"card "
      "wide\"><table><tr>"
      "<th>metric</th>" +
      column_heads(axes) +
      "<th>runs</th><th>mean</th><th>95 % of the "
      "mean</th><th>sd</th><th>min</th><th>p5</th><th>p50</th><th>p95</th>"
      "<th>max</th></tr>";
  for (const Quantity* q : varying) {
    if (q->expectation) continue;
    const Summary& m = q->summary;
    s += "<tr><td>" + html_text(q->name) + "</td>";
    for (const double share : q->explained) s += "<td>" + percent(share) + "</td>";
    s += fmt::format("<td>{}</td><td>{}</td><td>{}</td>", m.count, number_text(m.mean), range_text(m.mean95));
    for (const double v : {m.sd, m.min, m.p05, m.p50, m.p95, m.max}) s += "<td>" + number_text(v) + "</td>";
    s += "</tr>";
  }
  return s + "</table></div>";
}

std::string extremes(const Quantity& q, Commands& commands) {
  std::vector<std::uint64_t> order;
  for (std::uint64_t i = 0; i < q.values.size(); ++i)
    if (std::isfinite(q.values[i])) order.push_back(i);
  std::ranges::stable_sort(order,
                           [&](std::uint64_t a, std::uint64_t b) { return q.values[a] > q.values[b]; });
  const std::size_t n = std::min(kExtremes, order.size());
  std::string s = "highest ";
  for (std::size_t k = 0; k < n; ++k)
    s += fmt::format("{}{} ({})", k == 0 ? "" : ", ", number_text(q.values[order[k]]),
                     commands.link(order[k]));
  s += "; lowest ";
  for (std::size_t k = 0; k < n; ++k) {
    const std::uint64_t run = order[order.size() - 1 - k];
    s += fmt::format("{}{} ({})", k == 0 ? "" : ", ", number_text(q.values[run]), commands.link(run));
  }
  return s;
}

std::string plots_section(const std::vector<const Quantity*>& varying, const std::vector<Axis>& axes,
                          std::size_t runs, Commands& commands) {
  if (varying.empty()) return "";
  const bool dots = runs * varying.size() * axes.size() <= kMostDots;
  std::string s = "<h2>Highest and lowest</h2>";
  if (!axes.empty())
    s = fmt::format(
        "<h2>Over the parameters</h2><p class=\"words\">Red: the mean over all runs with a value, or with "
        "values "
        "near it, with its 95 % interval{}. What depends most on a parameter comes first.</p>",
        dots ? "; blue: each run" : "");
  s += "<div class=\"cards\">";
  for (const Quantity* q : varying) {
    s += fmt::format("<div class=\"card\"><h3>{}{}</h3>", html_text(q->name),
                     q->expectation ? ": share that holds" : "");
    for (std::size_t p = 0; p < axes.size(); ++p) {
      s += "<figure>" + sweep_plot(axes[p], q->values, q->means[p],
                                   q->expectation ? PlotOf::shares
                                   : dots         ? PlotOf::runs
                                                  : PlotOf::means);
      if (std::isfinite(q->explained[p]))
        s += fmt::format("<figcaption>{} explains {} of the variance</figcaption>", html_text(axes[p].key),
                         percent(q->explained[p]));
      s += "</figure>";
    }
    if (!q->expectation) s += "<p class=\"words\">" + extremes(*q, commands) + "</p>";
    s += "</div>";
  }
  return s + "</div>";
}

std::string constants_section(const std::vector<Quantity>& all, std::size_t runs) {
  std::string s;
  for (const Quantity& q : all) {
    if (q.expectation || q.varies()) continue;
    s += fmt::format("<tr><td>{}</td><td>{}</td><td>{} of {}</td></tr>", html_text(q.name),
                     number_text(q.summary.mean), q.summary.count, runs);
  }
  if (s.empty()) return "";
  return "<h2>The same in all runs</h2><div class=\"card wide\"><details><summary>Metrics with one "
         "value</summary><table>"
         "<tr><th>metric</th><th>value</th><th>known in</th></tr>" +
         s + "</table></details></div>";
}

std::string about_section(const SweepPlan& plan) {
  const nlohmann::json m = plan.manifest();
  std::string s = "<h2>About this sweep</h2><div class=\"card\"><table class=\"facts\">";
  const auto fact = [&](const std::string& what, const std::string& text) {
    s += fmt::format("<tr><td>{}</td><td>{}</td></tr>", what, html_text(text));
  };
  const auto joined = [](const nlohmann::json& list) {
    std::vector<std::string> texts = list;
    return texts.empty() ? std::string("none") : fmt::format("{}", fmt::join(texts, ", "));
  };
  fact("rig", m["rig"]);
  fact("set in every run", joined(m["set"]));
  fact("varied", joined(m["vary"]));
  const SweepOptions& o = plan.options();
  fact("combinations",
       o.samples > 0 ? fmt::format("{} Latin hypercube samples, seed {} of the draws", o.samples, o.draw_seed)
                     : "the grid of all values");
  const SweepRun last = plan.run(plan.size() - 1);
  fact("seeds", last.seed == plan.run(0).seed ? fmt::format("{}", last.seed)
                                              : fmt::format("{} to {}", plan.run(0).seed, last.seed));
  fact("version", "Rigor " + m["rigor_version"].get<std::string>());
  std::string inputs;
  for (const auto& [name, digest] : m["inputs"].items())
    inputs +=
        fmt::format("{}{} {}", inputs.empty() ? "" : ", ", name, digest.get<std::string>().substr(0, 12));
  fact("files and the beginnings of their SHA-256", inputs);
  return s + "</table></div>";
}

}  // namespace

std::string Outcome::text() const {
  std::string s = fmt::format("{} of {} run{} passed", passed, runs, runs == 1 ? "" : "s");
  for (const auto& [count, what] : {std::pair{failed, "failed"},
                                    {error, "broke off or could not run"},
                                    {crashed, "crashed"},
                                    {timeout, "took too long"},
                                    {not_run, "not run"}})
    if (count > 0) s += fmt::format(", {} {}", count, what);
  return s;
}

Outcome outcome_of(const Rows& rows) {
  Outcome o;
  o.runs = rows.size();
  for (const auto& row : rows) {
    if (!row)
      ++o.not_run;
    else if (row->passed())
      ++o.passed;
    else if (row->status == "failed")
      ++o.failed;
    else if (row->status == "crashed")
      ++o.crashed;
    else if (row->status == "timeout")
      ++o.timeout;
    else
      ++o.error;
  }
  return o;
}

std::string report_page(const SweepPlan& plan, const Rows& rows) {
  std::vector<Axis> axes;
  for (std::size_t i = 0; i < plan.options().vary.size(); ++i) axes.push_back(axis_of(plan, i));
  std::vector<Quantity> all = quantities_of(rows);
  for (Quantity& q : all) evaluate(q, axes);
  std::vector<const Quantity*> varying;
  for (const Quantity& q : all)
    if (q.varies()) varying.push_back(&q);
  // Expectations come before metrics.
  std::ranges::stable_sort(varying, [](const Quantity* a, const Quantity* b) {
    if (a->expectation != b->expectation) return a->expectation;
    return a->most_explained() > b->most_explained();
  });
  Commands commands;
  std::string body = outcome_section(plan, rows, commands);
  body += expectations_section(all, axes) + metrics_section(varying, axes);
  body += plots_section(varying, axes, rows.size(), commands);
  body += constants_section(all, rows.size());
  body += commands.section(plan, rows) + about_section(plan);
  std::vector<std::string> keys;
  for (const Axis& axis : axes) keys.push_back(html_text(axis.key));
  return html_page("Sweep of " + plan.options().rig.stem().string(),
                   fmt::format("{} runs{}", rows.size(),
                               keys.empty() ? "" : fmt::format(" over {}", fmt::join(keys, ", "))),
                   body);
}

}  // namespace rigor::sweep

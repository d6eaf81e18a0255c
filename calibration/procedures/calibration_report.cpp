#include "calibration/procedures/calibration_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

#include "bench/page/page.h"
#include "calibration/procedures/figure_svg.h"

namespace rigor {
namespace {

using namespace calibration;

std::string number(double v) {
  if (std::isnan(v)) return "–";
  return std::isfinite(v) ? fmt::format("{:.6g}", v) : "not determined";
}

/// As many digits as the uncertainty leaves meaning to.
std::string value_with(const Parameter& p) {
  if (!(p.sigma > 0) || !std::isfinite(p.sigma)) return fmt::format("{:.6g}", p.value);
  const int digits = std::clamp(1 - static_cast<int>(std::floor(std::log10(p.sigma))), 0, 15);
  return fmt::format("{:.{}f}", p.value, digits);
}

/// What stands beside a sigma that does not hold.
std::string contradiction(const FitResult& f, const Parameter& p) {
  if (f.identifiable(p.name) || !std::isfinite(p.halves_apart)) return {};
  return fmt::format(" NOT IDENTIFIABLE: halves of the data are {:.2g} apart", p.halves_apart);
}

std::string table(const std::vector<std::string>& head, const std::vector<std::vector<std::string>>& rows) {
  std::string s = "<table><tr>";
  for (const std::string& h : head) s += "<th>" + html_text(h) + "</th>";
  s += "</tr>";
  for (const auto& row : rows) {
    s += "<tr>";
    for (const std::string& cell : row) s += "<td>" + html_text(cell) + "</td>";
    s += "</tr>";
  }
  return s + "</table>";
}

}  // namespace

nlohmann::json result_json(const CalibrationResult& result) {
  nlohmann::json answer = to_json(result.fit);
  answer.update(result.details.json());
  if (!result.notes.empty()) answer["notes"] = result.notes;
  return answer;
}

std::string text_report(const CalibrationResult& result) {
  std::string out;
  const auto put = [&]<class... T>(fmt::format_string<T...> form, T&&... values) {
    fmt::format_to(std::back_inserter(out), form, std::forward<T>(values)...);
  };
  const FitResult& f = result.fit;
  if (f.interrupted) put("INTERRUPTED: the best so far\n");
  put("model {}\n", f.model);
  for (const Parameter& p : f.parameters)
    put("  {:<26} {:>16} ± {:<12}{}{}{}\n", p.name, value_with(p),
        std::isfinite(p.sigma) ? fmt::format("{:.2g}", p.sigma) : "not determined", p.held ? " held" : "",
        p.at_bound ? " AT ITS BOUND" : "", contradiction(f, p));
  put("residuals: RMS {:.4g} {} over {} numbers, median {:.3g}, p95 {:.3g}, largest {:.3g}\n",
      f.residuals.rms, f.residuals.unit, f.residuals.count, f.residuals.median_absolute,
      f.residuals.p95_absolute, f.residuals.largest);
  for (const auto& [key, value] : result.details.json().items())
    if (value.is_number()) put("{}: {:.5g}\n", key, value.get<double>());
  if (!f.candidates.empty()) {
    put("models compared (cross-validation: error on what was not fitted):\n");
    for (const Candidate& c : f.candidates)
      put("  {} {:<12} {:>3} parameters  RMS {:<9.4g} BIC {:<10.1f} cross-validation {:<9} {}\n",
          c.chosen ? "*" : " ", c.name, c.parameters, c.rms, c.bic, number(c.cross_validation), c.note);
  }
  if (!f.rejected.empty()) {
    put("rejected ({}):\n", f.rejected.size());
    for (std::size_t i = 0; i < std::min<std::size_t>(f.rejected.size(), 30); ++i)
      put("  {} ({:.3g} {}, {:.1f} sigma)\n", f.rejected[i].what, f.rejected[i].residual, f.residuals.unit,
          f.rejected[i].sigmas);
    if (f.rejected.size() > 30) put("  … and {} more (--json lists all)\n", f.rejected.size() - 30);
  }
  for (const std::string& note : result.notes) put("{}\n", note);
  for (const auto& [name, why] : f.not_identifiable) put("NOT IDENTIFIABLE {}: {}\n", name, why);
  for (const WeakDirection& w : f.weak) {
    put("WEAK: {}\n", w.words);
    if (!w.cure.empty()) put("      mend it: {}\n", w.cure);
  }
  for (const std::string& w : f.warnings) put("warning: {}\n", w);
  return out;
}

std::string html_report(const CalibrationResult& result) {
  const FitResult& f = result.fit;
  const std::string subtitle =
      fmt::format("model {} · RMS {:.4g} {} · {} numbers, {} rejected{}", html_text(f.model), f.residuals.rms,
                  html_text(f.residuals.unit), f.residuals.count, f.residuals.rejected,
                  f.interrupted ? " · INTERRUPTED, the best so far" : "");
  std::string s;
  if (!f.weak.empty() || !f.warnings.empty() || !f.not_identifiable.empty() || !result.record_next.empty()) {
    s += "<h2>What the data do not say, and what to record next</h2><ul>";
    for (const auto& [name, why] : f.not_identifiable)
      s += "<li class=\"note\"><b>" + html_text(name) + "</b> is not identifiable: " + html_text(why) +
           "</li>";
    for (const WeakDirection& w : f.weak)
      s += "<li class=\"note\">" + html_text(w.words) + (w.cure.empty() ? "" : ". " + html_text(w.cure)) +
           "</li>";
    for (const std::string& w : f.warnings) s += "<li class=\"note\">" + html_text(w) + "</li>";
    for (const std::string& w : result.record_next) s += "<li>" + html_text(w) + "</li>";
    s += "</ul>";
  }
  std::vector<std::vector<std::string>> rows;
  for (const Parameter& p : f.parameters)
    rows.push_back({p.name, value_with(p),
                    std::isfinite(p.sigma) ? fmt::format("{:.2g}", p.sigma) : "not determined",
                    p.held       ? "held"
                    : p.at_bound ? "at its bound"
                                 : contradiction(f, p)});
  if (!rows.empty()) s += "<h2>Parameters</h2>" + table({"parameter", "value", "sigma", ""}, rows);
  for (const std::string& note : result.notes) s += "<p>" + html_text(note) + "</p>";
  if (!f.candidates.empty()) {
    rows.clear();
    for (const Candidate& c : f.candidates)
      rows.push_back({(c.chosen ? "▸ " : "") + c.name, std::to_string(c.parameters), number(c.rms),
                      fmt::format("{:.1f}", c.bic), number(c.cross_validation),
                      number(c.cross_validation_sigma), c.note});
    s += "<h2>Models compared</h2>" +
         table({"model", "parameters", "RMS", "BIC", "cross-validation", "its sigma", ""}, rows);
  }
  s += "<h2>Figures</h2><div class=\"cards\">";
  for (const Figure& figure : result.figures)
    s += "<div class=\"card\"><h3>" + html_text(figure.title) + "</h3>" + svg_figure(figure) + "<p>" +
         html_text(figure.caption) + "</p></div>";
  s += "</div>";
  if (!f.rejected.empty()) {
    rows.clear();
    for (const Rejected& r : f.rejected)
      rows.push_back({r.what, number(r.residual), fmt::format("{:.1f}", r.sigmas)});
    s += "<h2>Rejected</h2><details><summary>" + std::to_string(rows.size()) + " observations</summary>" +
         table({"what", "residual [" + f.residuals.unit + "]", "sigmas"}, rows) + "</details>";
  }
  return html_page(result.title, subtitle, s);
}

}  // namespace rigor

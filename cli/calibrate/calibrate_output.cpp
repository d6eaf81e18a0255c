#include <fmt/format.h>
#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <memory>
#include <sstream>

#include "bench/files/output_file.h"
#include "bench/page/page.h"
#include "cli/calibrate/calibrate.h"
#include "cli/calibrate/figure_svg.h"

namespace rigor {
namespace {

using nlohmann::json;
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

void print(const CalibrationProduct& product) {
  const FitResult& f = product.fit;
  if (f.interrupted) fmt::print("INTERRUPTED: the best so far\n");
  fmt::print("model {}\n", f.model);
  for (const Parameter& p : f.parameters)
    fmt::print("  {:<26} {:>16} ± {:<12}{}{}{}\n", p.name, value_with(p),
               std::isfinite(p.sigma) ? fmt::format("{:.2g}", p.sigma) : "not determined",
               p.held ? " held" : "", p.at_bound ? " AT ITS BOUND" : "", contradiction(f, p));
  fmt::print("residuals: RMS {:.4g} {} over {} numbers, median {:.3g}, p95 {:.3g}, largest {:.3g}\n",
             f.residuals.rms, f.residuals.unit, f.residuals.count, f.residuals.median_absolute,
             f.residuals.p95_absolute, f.residuals.largest);
  for (const auto& [key, value] : product.more.items())
    if (value.is_number()) fmt::print("{}: {:.5g}\n", key, value.get<double>());
  if (!f.candidates.empty()) {
    fmt::print("models compared (cross-validation: error on what was not fitted):\n");
    for (const Candidate& c : f.candidates)
      fmt::print("  {} {:<12} {:>3} parameters  RMS {:<9.4g} BIC {:<10.1f} cross-validation {:<9} {}\n",
                 c.chosen ? "*" : " ", c.name, c.parameters, c.rms, c.bic, number(c.cross_validation),
                 c.note);
  }
  if (!f.rejected.empty()) {
    fmt::print("rejected ({}):\n", f.rejected.size());
    for (std::size_t i = 0; i < std::min<std::size_t>(f.rejected.size(), 30); ++i)
      fmt::print("  {} ({:.3g} {}, {:.1f} sigma)\n", f.rejected[i].what, f.rejected[i].residual,
                 f.residuals.unit, f.rejected[i].sigmas);
    if (f.rejected.size() > 30) fmt::print("  … and {} more (--json lists all)\n", f.rejected.size() - 30);
  }
  for (const std::string& note : product.notes) fmt::print("{}\n", note);
  for (const auto& [name, why] : f.not_identifiable) fmt::print("NOT IDENTIFIABLE {}: {}\n", name, why);
  for (const WeakDirection& w : f.weak) {
    fmt::print("WEAK: {}\n", w.words);
    if (!w.cure.empty()) fmt::print("      mend it: {}\n", w.cure);
  }
  for (const std::string& w : f.warnings) fmt::print("warning: {}\n", w);
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

std::string page_of(const CalibrationProduct& product) {
  const FitResult& f = product.fit;
  const std::string subtitle =
      fmt::format("model {} · RMS {:.4g} {} · {} numbers, {} rejected{}", html_text(f.model), f.residuals.rms,
                  html_text(f.residuals.unit), f.residuals.count, f.residuals.rejected,
                  f.interrupted ? " · INTERRUPTED, the best so far" : "");
  std::string s;
  if (!f.weak.empty() || !f.warnings.empty() || !f.not_identifiable.empty() || !product.record_next.empty()) {
    s += "<h2>What the data do not say, and what to record next</h2><ul>";
    for (const auto& [name, why] : f.not_identifiable)
      s += "<li class=\"note\"><b>" + html_text(name) + "</b> is not identifiable: " + html_text(why) +
           "</li>";
    for (const WeakDirection& w : f.weak)
      s += "<li class=\"note\">" + html_text(w.words) + (w.cure.empty() ? "" : ". " + html_text(w.cure)) +
           "</li>";
    for (const std::string& w : f.warnings) s += "<li class=\"note\">" + html_text(w) + "</li>";
    for (const std::string& w : product.record_next) s += "<li>" + html_text(w) + "</li>";
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
  for (const std::string& note : product.notes) s += "<p>" + html_text(note) + "</p>";
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
  for (const Figure& figure : product.figures)
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
  return html_page(product.title, subtitle, s);
}

}  // namespace

std::string sha256_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return {};
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), &EVP_MD_CTX_free);
  if (!context || EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr) != 1) return {};
  std::vector<char> block(1 << 16);
  while (in.read(block.data(), static_cast<std::streamsize>(block.size())) || in.gcount() > 0)
    EVP_DigestUpdate(context.get(), block.data(), static_cast<std::size_t>(in.gcount()));
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  EVP_DigestFinal_ex(context.get(), digest.data(), &size);
  std::string out;
  for (unsigned i = 0; i < size; ++i) out += fmt::format("{:02x}", digest[i]);
  return out;
}

Result<std::vector<std::filesystem::path>> input_files(const std::vector<std::filesystem::path>& inputs,
                                                       const std::vector<std::string>& extensions) {
  std::vector<std::filesystem::path> files;
  std::error_code ec;
  for (const auto& input : inputs) {
    if (!std::filesystem::is_directory(input, ec)) {
      if (!std::filesystem::exists(input, ec))
        return fail(ErrorCode::not_found, input.string(),
                    "expected a file or a folder, got nothing of that name");
      files.push_back(input);
      continue;
    }
    std::vector<std::filesystem::path> found;
    for (const auto& entry : std::filesystem::directory_iterator(input, ec)) {
      std::string extension = entry.path().extension().string();
      std::transform(extension.begin(), extension.end(), extension.begin(),
                     [](unsigned char c) { return std::tolower(c); });
      if (std::find(extensions.begin(), extensions.end(), extension) != extensions.end())
        found.push_back(entry.path());
    }
    if (found.empty())
      return fail(
          ErrorCode::not_found, input.string(),
          fmt::format("expected files ending in {} in this folder, found none", fmt::join(extensions, ", ")));
    std::sort(found.begin(), found.end());
    files.insert(files.end(), found.begin(), found.end());
  }
  return files;
}

Status check_outputs(const CalibrateOptions& options, const std::vector<std::filesystem::path>& more_inputs,
                     const std::vector<std::filesystem::path>& more_outputs) {
  std::error_code ec;
  InputFiles inputs;
  for (const auto& input : options.inputs) {
    inputs.add("an input of the calibration", input);
    for (const auto& entry : std::filesystem::directory_iterator(input, ec))
      inputs.add("an input of the calibration", entry.path());
  }
  for (const auto& input : more_inputs) inputs.add("an input of the calibration", input);
  inputs.add("the sheet of --base", options.base);
  Outputs outputs(std::move(inputs));
  const Existing existing = options.force ? Existing::replace : Existing::refuse;
  if (!options.output.empty())
    if (auto s = outputs.add(options.output, "-o", existing); !s) return s;
  for (const auto& output : more_outputs)
    if (auto s = outputs.add(output, "-o", existing); !s) return s;
  if (!options.base.empty() && !std::filesystem::is_regular_file(options.base, ec))
    return fail(ErrorCode::not_found, options.base.string(), "expected a sheet (--base), got no such file");
  return options.report.empty() ? Status{} : outputs.add_report(options.report);
}

int finish_calibration(const CalibrateOptions& options, CalibrationProduct product) {
  json answer = to_json(product.fit);
  answer.update(product.more);
  if (!product.notes.empty()) answer["notes"] = product.notes;
  if (!options.output.empty()) {
    if (!options.base.empty()) {
      std::ifstream in(options.base);
      std::ostringstream text;
      text << in.rdbuf();
      product.recipe.base = text.str();
    }
    std::vector<RecordingHash> hashes;
    for (const auto& file : product.inputs) hashes.push_back({file.filename().string(), sha256_of(file)});
    const auto sheet = sheet_yaml(product.recipe, product.fit, hashes);
    if (!sheet) return report_error(sheet.error(), options.json);
    if (auto s = write_output(options.output, *sheet); !s) return report_error(s.error(), options.json);
    answer["output"] = options.output.string();
  }
  if (!options.report.empty()) {
    if (auto s = write_report_files(options.report,
                                    {{"result.json", json_text(answer)}, {"index.html", page_of(product)}},
                                    options.force ? Existing::replace : Existing::keep);
        !s)
      return report_error(s.error(), options.json);
    answer["report"] = (options.report / "index.html").string();
  }
  if (options.json) {
    fmt::print("{}\n", json_text(answer));
  } else {
    print(product);
    if (!options.output.empty()) fmt::print("model:  {}\n", options.output.string());
    if (!options.report.empty()) fmt::print("report: {}\n", (options.report / "index.html").string());
  }
  return product.fit.interrupted ? 1 : 0;
}

}  // namespace rigor

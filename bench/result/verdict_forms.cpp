#include "bench/result/verdict_forms.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <nlohmann/json.hpp>

#include "bench/page/page.h"

namespace rigor {

using nlohmann::json;

json verdict_json(const Verdict& v) {
  const Severity worst = v.worst();
  json j{{"state", worst == Severity::note ? "good" : name_of(worst)}, {"findings", json::array()}};
  std::array<std::size_t, 3> n{};
  for (const Finding& f : v.findings) {
    ++n[static_cast<std::size_t>(f.severity)];
    j["findings"].push_back({{"severity", name_of(f.severity)},
                             {"kinds", f.kinds.names()},
                             {"channel", f.channel},
                             {"text", f.sentence},
                             {"cure", f.cure}});
  }
  if (worst == Severity::note) {
    j["text"] = n[0] == 0 ? "what was due came in time" : "what was due came; see the notes";
  } else {
    std::vector<std::string> parts;
    if (n[2] > 0) parts.push_back(fmt::format("{} bad", n[2]));
    if (n[1] > 0) parts.push_back(fmt::format("{} warning{}", n[1], n[1] == 1 ? "" : "s"));
    if (n[0] > 0) parts.push_back(fmt::format("{} note{}", n[0], n[0] == 1 ? "" : "s"));
    j["text"] = fmt::format("{}", fmt::join(parts, ", "));
  }
  return j;
}

std::string verdict_text(const json& v) {
  std::string out =
      fmt::format("verdict   {}: {}\n", v["state"].get<std::string>(), v["text"].get<std::string>());
  for (const json& f : v["findings"]) {
    out += fmt::format("  {:<8}{}", f["severity"].get<std::string>(), f["text"].get<std::string>());
    if (const std::string cure = f["cure"]; !cure.empty()) out += "; " + cure;
    out += '\n';
  }
  return out;
}

std::string verdict_section(const json& v) {
  /// `like this` becomes code.
  const auto with_code = [](const std::string& text) {
    std::string out;
    bool in_code = false;
    for (const char c : html_text(text)) {
      if (c != '`') {
        out += c;
        continue;
      }
      out += in_code ? "</code>" : "<code>";
      in_code = !in_code;
    }
    return out;
  };
  const std::string state = v["state"];
  std::string s = fmt::format("<section class=\"verdict {0}\"><h2>Verdict: {0}</h2><p>{1}</p>", state,
                              html_text(v["text"].get<std::string>()));
  if (v["findings"].empty()) return s + "</section>";
  s += "<ul>";
  for (const json& f : v["findings"]) {
    const std::string severity = f["severity"], cure = f["cure"];
    s += fmt::format("<li class=\"{0}\"><b>{0}</b> {1}{2}</li>", severity,
                     with_code(f["text"].get<std::string>()), cure.empty() ? "" : "; " + with_code(cure));
  }
  return s + "</ul></section>";
}

}  // namespace rigor

#include "bench/expect/expected_forms.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/page/page.h"

namespace rigor {

using nlohmann::json;

namespace {

/// Text of an attribute. XML has no control characters, whose place a space takes.
std::string xml_text(std::string text) {
  std::ranges::replace_if(
      text, [](unsigned char c) { return c < 0x20; }, ' ');
  return html_text(text);
}

}  // namespace

const char* Expected::state() const {
  if (!known) return "unknown";
  return !decided ? "undecided" : holds ? "holds" : "violated";
}

std::string Expected::name() const { return fmt::format("{} {} {}", of, quantity, bounds); }

std::string Expected::outcome() const {
  if (!known) return "cannot be determined from a recording";
  if (looked_at == 0) return nothing.empty() ? "nothing came that could be judged" : nothing;
  if (quantity == "alarm")
    return minimum > 0 ? fmt::format("it came{}", first_s ? fmt::format(" at {:.3f} s", *first_s) : "")
                       : "it did not";
  std::string s = minimum == maximum ? fmt::format("got {:.6g}", minimum)
                                     : fmt::format("got {:.6g} to {:.6g}", minimum, maximum);
  if (looked_at > 1 && outside > 0) s += fmt::format("; {} of {}", outside, looked_at);
  if (first_s) s += fmt::format(", first at {:.3f} s", *first_s);
  if (!detail.empty()) s += fmt::format(" ({})", detail);
  return s;
}

std::string Expected::sentence() const {
  return quantity == "alarm" ? fmt::format("{}: expected an alarm {}, {}", of, bounds, outcome())
                             : fmt::format("{}: expected {} {}, {}", of, quantity, bounds, outcome());
}

json to_json(const std::vector<Expected>& all) {
  json out = json::array();
  for (const Expected& e : all) {
    json j{{"of", e.of},
           {"quantity", e.quantity},
           {"bounds", e.bounds},
           {"state", e.state()},
           {"holds", e.known && e.decided ? json(e.holds) : json()},
           {"looked_at", e.looked_at},
           {"outside", e.outside},
           {"outcome", e.outcome()},
           {"text", e.sentence()}};
    j["first_s"] = e.first_s ? json(*e.first_s) : json();
    if (e.looked_at > 0) j["minimum"] = e.minimum, j["maximum"] = e.maximum;
    out.push_back(std::move(j));
  }
  return out;
}

std::string junit_text(const std::vector<Expected>& all, const std::string& rig,
                       const std::optional<std::string>& failure_of_run, double duration_s) {
  const auto failures =
      std::ranges::count_if(all, &Expected::fails) + (failure_of_run && !failure_of_run->empty());
  const auto skipped = std::ranges::count(all, false, &Expected::known);
  std::string out = fmt::format(
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"{}\" tests=\"{}\" failures=\"{}\" "
      "errors=\"0\" skipped=\"{}\" time=\"{:.3f}\">\n",
      xml_text(rig), all.size() + failure_of_run.has_value(), failures, skipped, duration_s);
  const auto add = [&](const std::string& name, const char* element, const std::string& message,
                       double time_s) {
    out += fmt::format("  <testcase classname=\"{}\" name=\"{}\" time=\"{:.3f}\"", xml_text(rig),
                       xml_text(name), time_s);
    out += message.empty()
               ? "/>\n"
               : fmt::format(">\n    <{} message=\"{}\"/>\n  </testcase>\n", element, xml_text(message));
  };
  if (failure_of_run) add("run", "failure", *failure_of_run, duration_s);
  for (const Expected& e : all)
    add(e.name(), e.known ? "failure" : "skipped", e.known && e.holds ? "" : e.sentence(), 0);
  return out + "</testsuite>\n";
}

}  // namespace rigor

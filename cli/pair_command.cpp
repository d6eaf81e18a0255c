// `rigor pair`: what the watches of a run's pairs say, over its control socket (docs/pair-watch.md).
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/control/control_socket.h"
#include "bench/control/pair_snapshot.h"
#include "cli/commands.h"

namespace rigor {
namespace {

using nlohmann::json;

void print_pair(const std::string& name, const json& p) {
  fmt::print("{:<16} {} handed on, {}\n", name, p["active"].get<std::string>(), pair_line(p));
  if (!p.contains("watch")) {
    fmt::print("{:17}not watched\n", "");
    return;
  }
  const json& w = p["watch"];
  const std::string state = w["state"];
  if (state == "learning")
    fmt::print("{:17}learning: {} of {} windows of the baseline\n", "", w["learned"].get<std::uint64_t>(),
               w["baseline_windows"].get<std::uint64_t>());
  else
    fmt::print("{:17}{}, {} windows\n", "", state, w["windows"].get<std::uint64_t>());
  if (w["alarms"].get<std::uint64_t>() > 0)
    fmt::print("{:17}{} at {:.1f} s: {}\n", "", state == "alarm" ? "ALARM" : "last alarm",
               w["alarm"]["raised_s"].get<double>(), w["text"].get<std::string>());
}

void print_parameters(const json& w) {
  fmt::print("{:17}{:<28} {:>12} {:>10} {:>12} {:>7}\n", "", "parameter", "newest", "sigma", "baseline",
             "level");
  const auto cell = [](const json& p, const char* key) {
    return p.contains(key) && p[key].is_number() ? fmt::format("{:.4g}", p[key].get<double>())
                                                 : std::string("-");
  };
  for (const json& p : w["parameters"]) {
    const std::string unit = p["unit"];
    fmt::print("{:17}{:<28} {:>12} {:>10} {:>12} {:>7}\n", "",
               p["name"].get<std::string>() + (unit == "1" || unit.empty() ? "" : " [" + unit + "]"),
               cell(p, "value"), cell(p, "sigma"), cell(p, "mean"),
               p["watched"].get<bool>() ? cell(p, "level") : "-");
  }
}

}  // namespace

int pair_command(const PairOptions& o) {
  json request{{"command", "pair"}};
  if (!o.channel.empty()) request["channel"] = o.channel;
  if (o.acknowledge) request["do"] = "acknowledge";
  if (o.learn_again) request["do"] = "learn_again";
  const auto answer = ask_bench(o.run, request);
  if (!answer) return report_error(answer.error(), o.json);
  if (o.json) {
    fmt::print("{}\n", answer->dump());
    return 0;
  }
  if (o.channel.empty()) {
    if (answer->empty()) fmt::print("no pairs\n");
    for (const auto& [name, pair] : answer->items()) print_pair(name, pair);
    return 0;
  }
  if (o.acknowledge) fmt::print("acknowledged\n");
  if (o.learn_again) fmt::print("learning again\n");
  print_pair(o.channel, *answer);
  if (answer->contains("watch") && !o.acknowledge && !o.learn_again) print_parameters((*answer)["watch"]);
  return 0;
}

}  // namespace rigor

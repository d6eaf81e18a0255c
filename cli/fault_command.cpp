// `rigor fault`: faults of a run that is going on, over its control socket.
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/control/control_socket.h"
#include "cli/commands.h"
#include "sensor-hal/config/json_text.h"

namespace rigor {
namespace {

using nlohmann::json;

/// Numbers and flags as such, everything else as text.
json value_of(const std::string& text) {
  const json value = parse_json(text).value_or(json());
  return value.is_number() || value.is_boolean() ? value : json(text);
}

Result<json> request_of(const FaultOptions& o) {
  if (o.list) return json{{"command", "faults"}};
  if (o.clear) {
    json request{{"command", "clear"}};
    if (!o.channel.empty()) request["channel"] = o.channel;
    return request;
  }
  if (o.channel.empty()) return json{{"command", "channels"}};
  if (o.kind.empty())
    return fail(ErrorCode::bad_input, "KIND",
                "expected what is to go wrong with " + o.channel + ": drop, delay, …");
  json fault{{"kind", o.kind}};
  for (const std::string& word : o.keys) {
    const std::size_t equals = word.find('=');
    if (equals == 0 || equals == std::string::npos)
      return fail(ErrorCode::bad_input, word, "expected KEY=VALUE, for example probability=0.2");
    const std::string key = word.substr(0, equals), text = word.substr(equals + 1);
    // The run may have been started elsewhere.
    fault[key] = key == "dbc" ? json(std::filesystem::absolute(text).string()) : value_of(text);
  }
  if (o.for_s > 0) fault["for_s"] = o.for_s;
  return json{{"command", "fault"}, {"channel", o.channel}, {"fault", fault}};
}

void print_faults(const json& all) {
  if (all.empty()) fmt::print("no faults\n");
  for (const json& c : all) {
    if (c.contains("earlier"))
      fmt::print("{:<16} {} earlier live ones\n{:21}seen {}, dropped {}, changed {}, delayed {}\n",
                 c["channel"].get<std::string>(), c["earlier"]["faults"].get<std::uint64_t>(), "",
                 c["earlier"]["seen"].get<std::uint64_t>(), c["earlier"]["dropped"].get<std::uint64_t>(),
                 c["earlier"]["changed"].get<std::uint64_t>(), c["earlier"]["delayed"].get<std::uint64_t>());
    for (const json& f : c["faults"])
      fmt::print(
          "{:<16} {:>3} {:<5} {:<4} {}\n{:21}seen {}, dropped {}, changed {}, delayed {}\n",
          c["channel"].get<std::string>(), f["index"].get<int>(), f["live"].get<bool>() ? "live" : "rig",
          f["on"].get<bool>()     ? "on"
          : f["over"].get<bool>() ? "over"
                                  : "off",
          f["text"].get<std::string>(), "", f["seen"].get<std::uint64_t>(), f["dropped"].get<std::uint64_t>(),
          f["changed"].get<std::uint64_t>(), f["delayed"].get<std::uint64_t>());
  }
}

void print_channels(const json& all) {
  for (const json& c : all["faults_at"]) {
    std::string values;
    for (const json& v : c["values"])
      values += (values.empty() ? "" : ", ") + v["name"].get<std::string>() +
                (v["unit"].get<std::string>().empty() ? "" : " [" + v["unit"].get<std::string>() + "]");
    fmt::print("{:<20} {:<12} {}\n", c["name"].get<std::string>(), c["kind"].get<std::string>(), values);
  }
}

}  // namespace

int fault_command(const FaultOptions& options) {
  if (options.run.empty()) {
    const auto all = running_benches();
    json list = json::array();
    for (const RunningBench& b : all)
      list.push_back({{"name", b.name}, {"pid", b.pid}, {"socket", b.socket.string()}});
    if (options.json) fmt::print("{}\n", list.dump());
    for (const RunningBench& b : all)
      if (!options.json) fmt::print("{:<20} {:>8}  {}\n", b.name, b.pid, b.socket.string());
    if (all.empty() && !options.json) fmt::print("no run of this user is going on\n");
    return 0;
  }
  const auto request = request_of(options);
  if (!request) return report_error(request.error(), options.json);
  const auto answer = ask_bench(options.run, *request);
  if (!answer) return report_error(answer.error(), options.json);
  if (options.json)
    fmt::print("{}\n", answer->dump());
  else if (options.list)
    print_faults(*answer);
  else if (options.clear)
    fmt::print("cleared\n");
  else if (options.channel.empty())
    print_channels(*answer);
  else
    fmt::print("live fault {} of {}\n", (*answer)["index"].get<std::uint32_t>(), options.channel);
  return 0;
}

}  // namespace rigor

#include "bench/control/pair_snapshot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/pair_values.h"

namespace rigor {
namespace {

using nlohmann::json;

/// JSON has no NaN: what is not known is null.
json number(double v) { return std::isfinite(v) ? json(v) : json(); }

std::string unit_of(SampleKind kind) {
  if (kind == SampleKind::image) return "DN";
  if (const auto values = compared_values(kind); !values.empty()) return std::string(values.front().unit);
  return kind == SampleKind::point_cloud || kind == SampleKind::range_image ? "m" : "";
}

json window_json(const PairWindow& w, BenchTime t0) {
  json values = json::array(), sigmas = json::array(), levels = json::array();
  for (std::uint32_t i = 0; i < w.parameters; ++i) {
    values.push_back(number(w.estimate.value[i]));
    sigmas.push_back(number(w.estimate.sigma[i]));
    levels.push_back(number(static_cast<double>(w.level[i])));
  }
  return {{"t_s", (w.t_end - t0).seconds()},
          {"state", name_of(w.state)},
          {"pairs", w.compared},
          {"unlike", w.unlike},
          {"bias", w.difference.count > 0 ? number(w.difference.bias) : json()},
          {"sigma_all", w.difference.count > 0 ? number(w.difference.sigma) : json()},
          {"left", number(w.estimate.left)},
          {"shift_px", number(w.estimate.shift_px)},
          {"features_px", number(w.estimate.features_px)},
          {"value", std::move(values)},
          {"sigma", std::move(sigmas)},
          {"level", std::move(levels)}};
}

json watch_json(const PairWatchReport& report) {
  const PairMonitor::Status& s = report.status;
  const auto& names = report.parameters;
  const auto& baseline = report.baseline;
  const pair_watch::PairWatchSnapshot& w = s.watch;
  json j{{"state", name_of(w.state)},
         {"text", s.text},
         {"windows", w.windows},
         {"learned", w.learned},
         {"baseline_windows", w.baseline_windows},
         {"compared", w.compared},
         {"unlike", w.unlike},
         {"alarms", w.alarms},
         {"untold", s.untold},
         {"parameters", json::array()}};
  const auto at = [&](BenchTime t) { return (t - s.t0).seconds(); };
  if (w.alarms > 0) {
    const pair_watch::Alarm& a = w.alarm;
    j["alarm"] = {{"parameter", names[a.parameter].name},
                  {"unit", names[a.parameter].unit},
                  {"change", number(a.change)},
                  {"sigma", number(a.sigma)},
                  {"log_ratio", number(a.log_ratio)},
                  {"trigger", names[a.trigger].name},
                  {"runner_up", names[a.runner_up].name},
                  {"runner_up_log_ratio", number(a.runner_up_log_ratio)},
                  {"since_s", at(w.t_since)},
                  {"raised_s", at(w.t_alarm)}};
  }
  for (std::size_t i = 0; i < names.size(); ++i) {
    json p{{"name", names[i].name},
           {"unit", names[i].unit},
           {"value", w.windows > 0 ? number(w.last.value[i]) : json()},
           {"sigma", w.windows > 0 ? number(w.last.sigma[i]) : json()},
           {"level", number(static_cast<double>(w.level[i]))},
           {"watched", baseline[i].watched}};
    if (baseline[i].watched) {
      p["mean"] = number(baseline[i].mean);
      p["scatter"] = number(baseline[i].sigma);
      p["threshold"] = number(baseline[i].h);
      p["reference"] = number(baseline[i].k);
      p["highest"] = number(baseline[i].highest);
      p["unsettled"] = baseline[i].unsettled;
    }
    j["parameters"].push_back(std::move(p));
  }
  if (report.windows) {
    j["series"] = json::array();
    for (const PairWindow& window : *report.windows) j["series"].push_back(window_json(window, s.t0));
  }
  return j;
}

/// The pair that a request names, or bad_input with what there is.
Result<RunChannel*> pair_named(RunParts& parts, const std::string& name) {
  std::vector<std::string> pairs;
  for (const auto& c : parts.channels) {
    if (!c->pair) continue;
    if (c->entry->name == name) return c.get();
    pairs.push_back(c->entry->name);
  }
  const std::string near = nearest(name, pairs);
  return fail(ErrorCode::bad_input, "channel",
              fmt::format("expected a pair of this rig, got \"{}\"{}", name,
                          near.empty() ? "" : "; did you mean '" + near + "'?"));
}

Result<json> answer(RunParts& parts, const json& request) {
  const auto text = [&](const char* key) {
    return request.contains(key) && request[key].is_string() ? request[key].get<std::string>() : "";
  };
  const std::string order = text("do");
  if (!request.contains("channel")) {
    if (request.contains("do"))
      return fail(ErrorCode::bad_input, "channel", "expected the pair that this is meant for, got none");
    return pair_snapshot(parts);
  }
  const auto channel = pair_named(parts, text("channel"));
  if (!channel) return tl::unexpected<Error>(channel.error());
  if (request.contains("do")) {
    PairMonitor* monitor = (*channel)->pair->monitor();
    if (order != "acknowledge" && order != "learn_again")
      return fail(ErrorCode::bad_input, "do", "expected acknowledge or learn_again, got \"" + order + "\"");
    if (!monitor)
      return fail(ErrorCode::wrong_state, (*channel)->entry->name,
                  "expected a pair that is watched; give it `watch` in the rig");
    if (order == "learn_again")
      monitor->learn_again();
    else if (auto s = monitor->acknowledge(); !s)
      return tl::unexpected<Error>(s.error());
  }
  return pair_json(pair_report(**channel, true));
}

}  // namespace

const char* name_of(pair_watch::WatchState s) noexcept {
  switch (s) {
    case pair_watch::WatchState::learning:
      return "learning";
    case pair_watch::WatchState::watching:
      return "watching";
    case pair_watch::WatchState::alarm:
      return "alarm";
  }
  return "?";
}

PairReport pair_report(const RunChannel& c, bool with_windows) {
  const PairSnapshot s = c.pair->statistics();
  PairReport r;
  r.compared = s.compared;
  r.unlike = s.unlike;
  r.skipped = s.skipped;
  r.switches = c.pair->switches();
  r.active = name_of(c.pair->active());
  r.real_missing = s.missing_of(PairSide::real);
  r.simulated_missing = s.missing_of(PairSide::simulated);
  r.bias = s.all.bias;
  r.sigma = s.all.sigma;
  r.unit = unit_of(c.entry->kind);
  const auto values = compared_values(c.entry->kind);
  if (!values.empty() && s.values == values.size()) {
    for (std::size_t i = 0; i < values.size(); ++i)
      r.values.push_back(
          {std::string(values[i].name), std::string(values[i].unit), s.value[i].bias, s.value[i].sigma});
  } else if (c.entry->kind == SampleKind::register_block) {
    const ChannelDescription& d = c.source->describe();
    for (std::size_t i = 0; i < std::min<std::size_t>(s.values, d.names.size()); ++i)
      r.values.push_back(
          {d.names[i], i < d.units.size() ? d.units[i] : "", s.value[i].bias, s.value[i].sigma});
  }
  if (const PairMonitor* m = c.pair->monitor())
    r.watch = std::make_shared<PairWatchReport>(
        PairWatchReport{m->status(), m->parameters(), m->baseline(),
                        with_windows ? std::optional(m->windows()) : std::nullopt});
  return r;
}

json pair_json(const PairReport& r) {
  json j{{"count", r.compared},
         {"unlike", r.unlike},
         {"skipped", r.skipped},
         {"switches", r.switches},
         {"active", r.active},
         {"real_missing", r.real_missing},
         {"simulated_missing", r.simulated_missing},
         {"bias", r.compared > 0 ? json(r.bias) : json()},
         {"sigma", r.compared > 0 ? json(r.sigma) : json()},
         {"unit", r.unit}};
  for (const ValueDifference& v : r.values)
    j["values"].push_back({{"name", v.name}, {"unit", v.unit}, {"bias", v.bias}, {"sigma", v.sigma}});
  for (const DifferenceAt& d : r.series)
    j["series"].push_back({{"t_s", d.t_s}, {"bias", d.bias}, {"sigma", d.sigma}});
  if (r.watch) j["watch"] = watch_json(*r.watch);
  return j;
}

std::string pair_line(const json& p) {
  const auto n = [&](const char* key) { return p[key].get<std::uint64_t>(); };
  if (n("count") == 0)
    return fmt::format("nothing compared (missing: {} of the real side, {} of the simulated{})",
                       n("real_missing"), n("simulated_missing"),
                       n("unlike") > 0 ? fmt::format("; {} unlike", n("unlike")) : "");
  return fmt::format("{} compared, bias {:.3f}, sigma {:.3f} {}", n("count"), p["bias"].get<double>(),
                     p["sigma"].get<double>(), p.value("unit", ""));
}

json pair_snapshot(const RunParts& parts) {
  json all = json::object();
  for (const auto& c : parts.channels)
    if (c->pair) all[c->entry->name] = pair_json(pair_report(*c, false));
  return all;
}

void add_pair_command(ControlCommands& commands, RunParts& parts) {
  commands.add("pair", [&parts](const json& request) { return answer(parts, request); });
}

}  // namespace rigor

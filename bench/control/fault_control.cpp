#include "bench/control/fault_control.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/control/pair_snapshot.h"
#include "bench/run/recorded_events.h"
#include "bench/run/recording.h"
#include "bench/run/run_json.h"
#include "sensor-hal/channel/pair_source.h"

namespace rigor {
namespace {

using nlohmann::json;

json values_json(const FaultSubject& subject) {
  json all = json::array();
  if (subject.kind == SampleKind::can_frame) return all;
  for (const FaultComponent& c : fault_components(subject.kind, *subject.description))
    all.push_back({{"name", c.name}, {"unit", c.unit}});
  return all;
}

json channel_json(const RunChannel& c) {
  const HealthSnapshot h = c.source->health();
  json j{{"name", c.entry->name},    {"kind", kind_name(c.entry->kind)}, {"pair", c.pair != nullptr},
         {"connected", h.connected}, {"received", h.received},           {"lost", h.lost}};
  if (c.pair) j["active"] = name_of(c.pair->active());
  return j;
}

Result<json> list_channels(const RunParts& parts) {
  json all{{"channels", json::array()}, {"sinks", json::array()}, {"faults_at", json::array()}};
  for (const auto& c : parts.channels) all["channels"].push_back(channel_json(*c));
  for (const auto& s : parts.sinks)
    all["sinks"].push_back({{"name", s->entry->name}, {"accepted", s->sink->counters().accepted}});
  if (parts.faults)
    for (const FaultBench::Entry& e : parts.faults->entries())
      all["faults_at"].push_back({{"name", e.name},
                                  {"kind", e.sink ? "sink" : kind_name(e.injector->subject().kind)},
                                  {"values", values_json(e.injector->subject())}});
  return all;
}

Result<json> switch_pair(RunParts& parts, const json& request) {
  const std::string name = request.value("channel", ""), side = request.value("active", "");
  std::vector<std::string> pairs;
  if (side != "real" && side != "simulated")
    return fail(ErrorCode::bad_input, "active", "expected real or simulated, got \"" + side + "\"");
  for (const auto& c : parts.channels) {
    if (!c->pair) continue;
    pairs.push_back(c->entry->name);
    if (c->entry->name != name) continue;
    c->pair->switch_to(side == "real" ? PairSide::real : PairSide::simulated);
    return json::object();
  }
  const std::string near = nearest(name, pairs);
  return fail(ErrorCode::bad_input, "channel",
              fmt::format("expected a pair of this rig, got \"{}\"{}", name,
                          near.empty() ? "" : "; did you mean '" + near + "'?"));
}

Result<json> inject(FaultBench& faults, const json& request) {
  if (!request.contains("fault") || !request["fault"].is_object())
    return fail(ErrorCode::bad_input, "fault",
                "expected an object with the keys of a fault, as rigs have them");
  const auto node = fault_node(request["fault"].dump(), "fault");
  if (!node) return tl::unexpected<Error>(node.error());
  const auto index = faults.inject(request.value("channel", ""), *node);
  if (!index) {
    // A place in a line that nobody wrote helps nobody; the message has the key.
    Error e = index.error();
    if (e.where.starts_with("fault:")) e.where = "fault";
    return tl::unexpected<Error>(std::move(e));
  }
  return json{{"index", *index}};
}

}  // namespace

ChannelFaultReport fault_report(const FaultBench::Entry& entry, const BenchTime* t0) {
  ChannelFaultReport report;
  report.channel = entry.name;
  for (const auto* faults : {&entry.injector->scheduled(), &entry.injector->live()})
    for (const auto& f : *faults) {
      FaultReport r{f->index,
                    std::string(fault_kind_name(f->spec.kind)),
                    f->identity->yaml,
                    f->identity->json,
                    f->live,
                    f->on.load(),
                    f->over.load(),
                    f->count.begins.load(),
                    f->count.seen.load(),
                    f->count.dropped.load(),
                    f->count.changed.load(),
                    f->count.delayed.load(),
                    {}};
      if (t0)
        for (std::size_t i = 0; i < std::min(f->span_count, f->spans.size()); ++i)
          r.spans.push_back({(f->spans[i].from - *t0).seconds(), (f->spans[i].until - *t0).seconds()});
      report.faults.push_back(std::move(r));
    }
  if (const FaultInjector::Earlier& e = entry.injector->earlier(); e.faults > 0)
    report.earlier = {e.faults, e.begins, e.seen, e.dropped, e.changed, e.delayed};
  if (entry.source) report.source = faulty_report(*entry.source, entry.name);
  return report;
}

json faults_json(const ChannelFaultReport& report) {
  json list = json::array();
  for (const FaultReport& f : report.faults) {
    list.push_back({{"index", f.index},
                    {"kind", f.kind},
                    {"text", f.text},
                    {"fault", json::parse(f.json)},
                    {"live", f.live},
                    {"on", f.on},
                    {"over", f.over},
                    {"times", f.times},
                    {"seen", f.seen},
                    {"dropped", f.dropped},
                    {"changed", f.changed},
                    {"delayed", f.delayed},
                    {"spans", json::array()}});
    for (const FaultReport::Span& s : f.spans) list.back()["spans"].push_back({s.from_s, s.until_s});
  }
  json j{{"channel", report.channel}, {"faults", std::move(list)}};
  if (const auto& e = report.earlier)
    j["earlier"] = {{"faults", e->faults},   {"times", e->times},     {"seen", e->seen},
                    {"dropped", e->dropped}, {"changed", e->changed}, {"delayed", e->delayed}};
  if (report.source) j.update(faulty_json(*report.source));
  return j;
}

void add_run_commands(ControlCommands& commands, RunParts& parts) {
  commands.add("run", [&parts](const json&) -> Result<json> {
    json run = identity_json(identity_of(parts.rig));
    run["pid"] = getpid();
    return run;
  });
  commands.add("channels", [&parts](const json&) { return list_channels(parts); });
  commands.add("switch", [&parts](const json& request) { return switch_pair(parts, request); });
  add_pair_command(commands, parts);
  if (!parts.faults) return;
  commands.add("fault", [&parts](const json& request) { return inject(*parts.faults, request); });
  commands.add("clear", [&parts](const json& request) -> Result<json> {
    if (auto s = parts.faults->clear(request.value("channel", "")); !s)
      return tl::unexpected<Error>(s.error());
    return json::object();
  });
  commands.add("faults", [&parts](const json&) -> Result<json> {
    json all = json::array();
    for (const FaultBench::Entry& e : parts.faults->entries())
      if (!e.injector->scheduled().empty() || !e.injector->live().empty())
        all.push_back(faults_json(fault_report(e, nullptr)));
    return all;
  });
}

// ------------------------------------------------------------------ from a recording

namespace {

/// Draws depend on channels' names and kinds: those that were recorded are to be in this rig.
Status check_channels(const RecordedRun& run, const std::filesystem::path& file, const RigConfig& rig) {
  const auto recorded = recorded_rig(run, file);
  if (!recorded) return tl::unexpected<Error>(recorded.error());
  std::vector<std::string> differ;
  for (const ChannelEntry& was : recorded->channels) {
    const auto is = std::ranges::find(rig.channels, was.name, &ChannelEntry::name);
    if (is == rig.channels.end())
      differ.push_back("no channel " + was.name);
    else if (is->kind != was.kind)
      differ.push_back(
          fmt::format("{} is of kind {} and not {}", was.name, kind_name(is->kind), kind_name(was.kind)));
    else if (is->is_pair != was.is_pair)
      differ.push_back(was.name + (was.is_pair ? " is no pair" : " is a pair"));
  }
  for (const SinkEntry& was : recorded->sinks)
    if (std::ranges::find(rig.sinks, was.name, &SinkEntry::name) == rig.sinks.end())
      differ.push_back("no sink " + was.name);
  if (differ.empty()) return {};
  return fail(ErrorCode::bad_input, file.string(),
              fmt::format("expected a recording of this rig ({}), got one of {}: here is {}", rig.name,
                          recorded->name, fmt::join(differ, ", ")));
}

}  // namespace

Status schedule_recorded_faults(const std::filesystem::path& file, const RigConfig& rig, FaultBench& faults) {
  const auto run = read_recorded_run(file);
  if (!run) return tl::unexpected<Error>(run.error());
  if (auto s = check_channels(*run, file, rig); !s) return s;
  const auto events = read_recorded_events(file, *run);
  if (!events) return tl::unexpected<Error>(events.error());
  const auto found = recorded_live_faults(file, *run, *events);
  if (!found) return tl::unexpected<Error>(found.error());
  if (found->empty())
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected a recording of a run into which faults were injected (`rigor fault`), got one without; "
        "faults that the rig itself schedules come from the rig");
  for (const RecordedLiveFault& live : *found) {
    const auto entry = faults.find(live.of);
    if (!entry) return tl::unexpected<Error>(entry.error());
    const auto node = fault_node(live.json, file.string());
    if (!node) return tl::unexpected<Error>(node.error());
    if (auto s = (*entry)->injector->schedule_live(*node, live.index, live.from, live.until); !s) return s;
  }
  return {};
}

}  // namespace rigor

#include "bench/live/status.h"

#include <unistd.h>

#include <nlohmann/json.hpp>

#include "bench/control/pair_snapshot.h"
#include "bench/expect/expected_forms.h"
#include "bench/result/verdict_forms.h"
#include "bench/run/run_json.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/simulated_source.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor::live {
namespace {

using nlohmann::json;

json bins_json(const LiveBins& bins) {
  const LiveBins::Read r = bins.read();
  json list = json::array();
  for (std::size_t i = 0; i < LiveBins::kBins; ++i)
    if (r.count[i] > 0)
      list.push_back({{"from_us", LiveBins::lower_us(i)},
                      {"to_us", i + 1 == LiveBins::kBins ? r.max_us : LiveBins::lower_us(i + 1)},
                      {"count", r.count[i]}});
  return {{"p50_us", r.percentile_us(0.5)},
          {"p99_us", r.percentile_us(0.99)},
          {"max_us", r.max_us},
          {"count", r.total},
          {"bins", std::move(list)}};
}

json side_json(const PairSource& pair, const PairSnapshot& s, PairSide side) {
  const HealthSnapshot h = pair.side(side).health();
  return {{"connected", h.connected},
          {"received", h.received},
          {"came", s.came_of(side)},
          {"missing", s.missing_of(side)}};
}

json differences_json(const RunChannel& channel) {
  const PairSource& pair = *channel.pair;
  const PairSnapshot s = pair.statistics();
  json j{{"active", name_of(pair.active())},
         {"switches", pair.switches()},
         {"compared", s.compared},
         {"unlike", s.unlike},
         {"bias", s.compared ? json(s.all.bias) : json()},
         {"sigma", s.compared ? json(s.all.sigma) : json()},
         {"last_bias", s.compared ? json(s.last.bias) : json()},
         {"last_sigma", s.compared ? json(s.last.sigma) : json()},
         {"real", side_json(pair, s, PairSide::real)},
         {"simulated", side_json(pair, s, PairSide::simulated)}};
  if (pair.monitor()) {
    j["watch"] = pair_json(pair_report(channel, false))["watch"];
    j["watch"].erase("parameters");  // the command `pair` tells of each
  }
  return j;
}

}  // namespace

LiveStatus::LiveStatus(const RunParts& parts, const LoopCounters& counters, ControlCommands& commands,
                       const LiveTap& tap, const EpochPair& epoch, bool replay)
    : parts_(parts),
      counters_(counters),
      commands_(commands),
      tap_(tap),
      epoch_(epoch),
      replay_(replay),
      rates_(parts.channels.size()) {
  for (const auto& c : parts.channels) descriptions_.push_back(c->source->describe());
}

std::string LiveStatus::schema() {
  const json number{{"type", "number"}}, text{{"type", "string"}},
      list{{"type", "array"}, {"items", {{"type", "object"}}}}, object{{"type", "object"}};
  return json{{"type", "object"},
              {"title", "rigor.Live"},
              {"properties",
               {{"run", object},
                {"t_s", number},
                {"bench_ns", number},
                {"utc_ns", number},
                {"cycles", number},
                {"skipped", number},
                {"overruns", number},
                {"misses", number},
                {"wake", object},
                {"cycle_time", object},
                {"verdict", object},
                {"channels", list},
                {"sinks", list},
                {"faults", list},
                {"expect", list},
                {"server", object}}}}
      .dump();
}

/// As a run that has ended is judged, of what is known so far.
RunFacts LiveStatus::facts() const {
  const LoopCounts loop{tap_.t0(), tap_.now(), counters_.run.load(), counters_.skipped.load(),
                        counters_.misses.load()};
  std::vector<ChannelCounts> counts;
  for (std::size_t i = 0; i < parts_.channels.size(); ++i) {
    const LiveTap::ChannelState& s = tap_.channel(i);
    const auto of = [](const auto& a) { return a.load(std::memory_order_relaxed); };
    ChannelCounts n;
    n.delivered = of(s.fresh) + of(s.superseded);
    n.late = of(s.late_samples);
    n.lost = of(s.lost);
    n.disconnected_cycles = of(s.disconnected_cycles);
    n.lost_now = static_cast<PortStatus>(of(s.status)) == PortStatus::disconnected;
    if (of(s.fresh) > 0) n.t_last = BenchTime(of(s.t_capture_ns));
    counts.push_back(n);
  }
  return run_facts(parts_, loop, counts);
}

json LiveStatus::channel(std::size_t i, const ChannelFacts& facts) {
  const RunChannel& c = *parts_.channels[i];
  const ChannelDescription& d = descriptions_[i];
  const LiveTap::ChannelState& s = tap_.channel(i);
  const HealthSnapshot h = c.source->health();
  const std::uint64_t fresh = s.fresh.load(std::memory_order_relaxed);
  const std::int64_t now = tap_.now().ns();
  Rate& rate = rates_[i];
  const std::int64_t window_ns = std::max<std::int64_t>(1'000'000'000, 2 * c.entry->period.ns());
  if (now - rate.t_ns >= window_ns || now < rate.t_ns) {
    rate.known = rate.t_ns > 0 && now > rate.t_ns && fresh >= rate.fresh;
    rate.hz =
        rate.known ? static_cast<double>(fresh - rate.fresh) * 1e9 / static_cast<double>(now - rate.t_ns) : 0;
    rate.fresh = fresh;
    rate.t_ns = now;
  }
  json j{{"name", c.entry->name},
         {"kind", kind_name(c.entry->kind)},
         {"status", name_of(static_cast<PortStatus>(s.status.load(std::memory_order_relaxed)))},
         {"connected", h.connected},
         {"rate_hz", rate.known ? json(rate.hz) : json()},
         {"nominal_hz", c.entry->period.ns() > 0 ? json(c.entry->period.hz()) : json()},
         {"latency_ms", c.entry->latency.seconds() * 1e3},
         {"samples", facts.delivered},
         {"due", facts.due ? json(*facts.due) : json()},
         {"silent_since_s", facts.silent ? json(facts.last_s.value_or(0)) : json()},
         {"received", h.received},
         {"sequence", s.sequence.load(std::memory_order_relaxed)},
         {"lost", std::max(s.lost.load(std::memory_order_relaxed), h.lost)},
         {"late", facts.late},
         {"dropped", h.no_slot + h.ring_full + s.overflow.load(std::memory_order_relaxed)},
         {"incomplete", h.incomplete},
         {"reconnects", h.reconnects},
         {"replaced_by", c.replaced_by},
         {"frame_id", d.frame_id}};
  const LiveBins::Read age = s.age.read();
  j["age_ms"] = age.total == 0
                    ? json()
                    : json{{"p50", age.percentile_us(0.5) * 1e-3}, {"p99", age.percentile_us(0.99) * 1e-3}};
  if (d.width_px > 0) {
    j["width_px"] = d.width_px;
    j["height_px"] = d.height_px;
    if (d.kind == SampleKind::image) j["format"] = pfnc_name(d.format);
  }
  j["values"] = json::array();
  for (std::size_t k = 0; k < d.names.size(); ++k)
    j["values"].push_back({{"name", d.names[k]}, {"unit", k < d.units.size() ? d.units[k] : std::string()}});
  const std::string topic = "/" + std::string(record::topic_of(d.kind));
  if (c.pair) {
    j["topics"] = {{"real", "/" + c.entry->name + "/real" + topic},
                   {"simulated", "/" + c.entry->name + "/simulated" + topic}};
    j["pair"] = differences_json(c);
  } else {
    j["topics"] = {{"main", "/" + c.entry->name + topic}};
  }
  return j;
}

json LiveStatus::faults() {
  json list = json::array();
  if (!parts_.faults) return list;
  const json answer = json::parse(commands_.answer(R"({"command":"faults"})"), nullptr, false);
  if (!answer.is_object() || !answer.value("ok", false)) return list;
  for (const json& entry : answer["result"])
    for (json f : entry["faults"]) {
      f["channel"] = entry["channel"];
      list.push_back(std::move(f));
    }
  return list;
}

/// As the loop showed it when it was asked, which it is every third time: less than twice a second.
std::vector<Expected> LiveStatus::expected(const RunFacts& facts) {
  if (!parts_.expectations) return {};
  if (published_++ % 3 == 0) parts_.expectations->ask();
  RunEnd known = run_end(facts);
  known.extent = RunEnd::Extent::so_far;
  known.skipped = facts.skipped;
  known.misses = facts.misses;
  return parts_.expectations->so_far(known);
}

json LiveStatus::operator()(const HubCounters& server) {
  const RigConfig& rig = parts_.rig;
  const BenchTime now = tap_.now();
  const bool begun = counters_.run.load() > 0;
  RunFacts facts = this->facts();
  const std::vector<Expected> expected = this->expected(facts);
  for (const Expected& e : expected)
    if (e.fails()) facts.unmet.push_back(e.sentence());
  json run = identity_json(identity_of(rig));
  run.update({{"pid", getpid()},
              {"replay", replay_},
              {"application", rig.application},
              {"duration_s", rig.duration.seconds()},
              {"period_s", rig.loop.period.seconds()}});
  json j{{"run", std::move(run)},
         {"t_s", begun ? (now - tap_.t0()).seconds() : 0.0},
         {"bench_ns", now.ns()},
         {"utc_ns", epoch_.to_utc(now).ns()},
         {"cycles", counters_.run.load()},
         {"skipped", counters_.skipped.load()},
         {"overruns", counters_.overruns.load()},
         {"misses", counters_.misses.load()},
         {"wake", bins_json(tap_.wake())},
         {"cycle_time", bins_json(tap_.cycle_time())},
         {"verdict", begun ? verdict_json(judge(facts)) : json()},
         {"channels", json::array()},
         {"sinks", json::array()},
         {"faults", faults()},
         {"expect", rigor::to_json(expected)},
         {"server",
          {{"clients", server.clients.load()},
           {"frames_sent", server.frames_sent.load()},
           {"frames_dropped", server.frames_dropped.load()},
           {"frames_thinned", server.frames_thinned.load()},
           {"bytes_sent", server.bytes_sent.load()},
           {"events_lost", tap_.lost()}}}};
  for (std::size_t i = 0; i < parts_.channels.size(); ++i)
    j["channels"].push_back(channel(i, facts.channels[i]));
  for (const auto& s : parts_.sinks) {
    json sink = commands_json(s->sink->counters());
    sink.update({{"name", s->entry->name},
                 {"names", s->sink->describe().names},
                 {"units", s->sink->describe().units},
                 {"replaced_by", s->replaced_by}});
    j["sinks"].push_back(std::move(sink));
  }
  return j;
}

}  // namespace rigor::live

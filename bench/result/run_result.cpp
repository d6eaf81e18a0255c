#include "bench/result/run_result.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/control/fault_control.h"
#include "bench/control/pair_snapshot.h"
#include "bench/result/verdict_forms.h"
#include "bench/run/run_json.h"
#include "bench/sensing/sensors.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/fault_source.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {
namespace {

using nlohmann::json;

json histogram_json(const Histogram& h) {
  json buckets = json::array();
  h.for_each([&](Duration lo, Duration hi, std::uint64_t n) { buckets.push_back({lo.ns(), hi.ns(), n}); });
  return {{"count", h.count()},
          {"p50_ns", h.percentile(0.5).ns()},
          {"p99_ns", h.percentile(0.99).ns()},
          {"p999_ns", h.percentile(0.999).ns()},
          {"max_ns", h.max().ns()},
          {"mean_ns", h.mean_ns()},
          {"buckets", std::move(buckets)}};
}

json loop_json(const RunParts& parts, const RunSummary& s) {
  json loop{{"rate_hz", s.period.hz()},
            {"reason", to_string(s.reason)},
            {"cycles_run", s.cycles_run},
            {"cycles_skipped", s.cycles_skipped},
            {"overruns", s.overruns},
            {"late_wakeups", s.late_wakeups},
            {"minor_faults", s.minor_faults},
            {"major_faults", s.major_faults},
            {"spin_us", static_cast<double>(parts.rig.loop.spin.ns()) * 1e-3},
            {"wake_error", histogram_json(s.wake_error)},
            {"cycle_time", histogram_json(s.cycle_time)}};
  for (const StepTiming& step : s.steps)
    loop["steps"].push_back({{"name", step.name}, {"ran", histogram_json(step.ran)}});
  for (const RealtimeSetting& r : s.settings)
    loop["settings"].push_back(
        {{"name", r.name}, {"wanted", r.wanted}, {"granted", r.granted}, {"text", r.text}});
  json causes = json::object();
  for (std::size_t i = 0; i < kMissCauses; ++i)
    causes[to_string(static_cast<MissCause>(i))] = s.misses.by_cause[i];
  json list = json::array();
  for (const Miss& m : s.misses.misses) {
    if (list.size() == 100) break;
    const std::string step = m.longest_step < s.steps.size() ? s.steps[m.longest_step].name : "?";
    list.push_back({{"cycle", m.cycle},
                    {"t_s", (m.t_cycle - s.t0).seconds()},
                    {"late_ns", m.late.ns()},
                    {"ran_ns", m.ran.ns()},
                    {"cause", to_string(m.cause)},
                    {"text", describe(m, s.period, step)}});
  }
  loop["misses"] = {
      {"total", s.misses.total}, {"dropped", s.misses.dropped}, {"by_cause", causes}, {"list", list}};
  return loop;
}

/// Null where it is not known.
template <class T>
json or_null(const std::optional<T>& v) {
  return v ? json(*v) : json();
}

json channel_json(const RunChannel& c, const ChannelFacts& facts, BenchTime t0) {
  const PortCounters& n = c.port.counters();
  const Health& h = c.source->health();
  json j{{"name", c.entry->name},
         {"kind", kind_name(c.entry->kind)},
         {"backend", c.entry->is_pair ? c.entry->source.backend + " | " + c.entry->twin.backend
                                      : c.entry->source.backend},
         {"replaced_by", c.replaced_by},
         {"nominal_rate_hz", c.entry->period.hz()},
         {"rate_hz", facts.rate_hz()},
         {"due", or_null(facts.due)},
         {"delivered", facts.delivered},
         {"missing", facts.missing()},
         {"silent_since_s", facts.silent ? json(facts.last_s.value_or(0)) : json()},
         {"latency_ms", c.entry->latency.seconds() * 1e3},
         {"fresh", n.fresh},
         {"superseded", n.superseded},
         {"late_samples", n.late_samples},
         {"late_cycles", n.late_cycles},
         {"lost_samples", n.lost_samples},
         {"lost_cycles", n.lost_cycles},
         {"overflow", n.overflow},
         {"before_start", c.before_start},
         {"age", histogram_json(c.age)},
         {"arrival", histogram_json(c.arrival)},
         {"gap_count", c.gap_count},
         {"health",
          {{"received", h.received.load()},
           {"incomplete", h.incomplete.load()},
           {"lost", h.lost.load()},
           {"no_slot", h.no_slot.load()},
           {"ring_full", h.ring_full.load()},
           {"protocol_errors", h.protocol_errors.load()},
           {"retries", h.retries.load()},
           {"reconnects", h.reconnects.load()}}}};
  j["gaps"] = json::array();
  for (std::size_t i = 0; i < std::min(c.gap_count, RunChannel::kKept); ++i)
    j["gaps"].push_back({{"t_s", (c.gaps[i].t - t0).seconds()},
                         {"after", c.gaps[i].after_sequence},
                         {"missing", c.gaps[i].missing}});
  j["status"] = json::array();
  for (std::size_t i = 0; i < std::min(c.span_count, RunChannel::kKept); ++i)
    j["status"].push_back({{"t_s", (c.spans[i].t - t0).seconds()}, {"status", name_of(c.spans[i].status)}});
  return j;
}

/// Where the samples of a channel went, from the source to the application.
json accounts_json(const RunChannel& c, const RunParts& parts) {
  const PortCounters& n = c.port.counters();
  json j{{"taken_by_loop", c.taken},
         {"before_start", c.before_start},
         {"shown", n.fresh},
         {"superseded", n.superseded},
         {"overflow", n.overflow},
         {"not_due_at_end", c.taken - c.before_start - n.fresh - n.superseded - n.overflow},
         {"sources", json::array()}};
  const std::string& name = c.entry->name;
  if (parts.faults)
    for (const FaultBench::Entry& e : parts.faults->entries())
      if (e.source && (e.name == name || (c.pair && e.name.rfind(name + ".", 0) == 0))) {
        const Health& h = e.source->inner().health();
        json source = faulty_json(*e.source);
        source.update({{"name", e.name},
                       {"received", h.received.load()},
                       {"ring_full", h.ring_full.load()},
                       {"no_slot_in_source", h.no_slot.load()},
                       {"lost_in_source", h.lost.load()}});
        j["sources"].push_back(std::move(source));
      }
  return j;
}

/// Where the time went: of the loop's steps `loop.steps` has more.
json times_json(const RunParts& parts, const RunOutcome& outcome, const Recorder* recorder) {
  json j{{"wall_s", outcome.wall_s}, {"cpu_s", outcome.cpu_s}, {"sensors", json::array()}};
  for (const StepTiming& step : outcome.loop.steps)
    j["loop_s"][step.name] = step.ran.mean_ns() * static_cast<double>(step.ran.count()) * 1e-9;
  const auto seconds_of = [](const StageTime& s) { return static_cast<double>(s.wall_ns.load()) * 1e-9; };
  for (const auto& [name, times] : parts.sensor_times) {
    const StageTime& whole = times->whole;
    if (whole.count.load() == 0) continue;
    const double all_s = seconds_of(whole), world_s = seconds_of(times->world),
                 light_s = seconds_of(times->light);
    j["sensors"].push_back({{"channel", name},
                            {"captures", whole.count.load()},
                            {"wall_s", all_s},
                            {"world_s", world_s},
                            {"light_s", light_s},
                            {"model_s", std::max(0.0, all_s - world_s - light_s)},
                            {"cpu_s", static_cast<double>(whole.cpu_ns.load()) * 1e-9},
                            {"longest_ms", static_cast<double>(whole.longest_ns.load()) * 1e-6}});
  }
  if (recorder) j["recorder_cpu_s"] = recorder->statistics().cpu_s;
  return j;
}

json sink_json(const RunSink& s) {
  json j = commands_json(*s.sink);
  j.update({{"name", s.entry->name}, {"backend", s.entry->sink.backend}, {"replaced_by", s.replaced_by}});
  return j;
}

/// As `pair_json`, with how the difference went over the run.
json pair_result(const RunChannel& c) {
  json j = pair_json(c, true);
  j["series"] = json::array();
  for (std::size_t i = 0; i < std::min(c.difference_count, RunChannel::kKept); ++i) {
    const auto& d = c.differences[i];
    j["series"].push_back({{"t_s", d.t_s}, {"bias", d.bias}, {"sigma", d.sigma}});
  }
  return j;
}

json recorder_json(const Recorder& recorder, const std::string& file) {
  const Recorder::Statistics s = recorder.statistics();
  return {{"file", file},         {"messages", s.messages}, {"bytes", s.bytes},        {"chunks", s.chunks},
          {"samples", s.samples}, {"dropped", s.dropped},   {"after_end", s.after_end}};
}

json application_json(const RigConfig& rig, const ApplicationFacts& a) {
  json j{{"name", rig.application},
         {"turns", a.turns},
         {"answered", a.answered},
         {"late", a.late},
         {"skipped", a.skipped},
         {"restarts", a.restarts},
         {"samples",
          {{"delivered", a.delivered},
           {"superseded", a.superseded},
           {"dropped", a.dropped},
           {"after_last", a.after_last}}}};
  if (a.answer.count() > 0)
    j["answer"] = {{"p50_ns", a.answer.percentile(0.5).ns()},
                   {"p99_ns", a.answer.percentile(0.99).ns()},
                   {"max_ns", a.answer.max().ns()}};
  return j;
}

}  // namespace

RunFacts ended_run_facts(const RunParts& parts, const RunOutcome& outcome, const Recorder* recorder,
                         const std::vector<std::string>& warnings) {
  const RunSummary& s = outcome.loop;
  LoopCounts loop{outcome.t0, outcome.t0, s.cycles_run, s.cycles_skipped, s.misses.total};
  if (const std::uint64_t cycles = s.cycles_run + s.cycles_skipped; cycles > 0)
    loop.now = outcome.t0 + s.period * static_cast<std::int64_t>(cycles - 1);
  std::vector<ChannelCounts> counts;
  for (const auto& c : parts.channels) counts.push_back(counts_of(*c));
  RunFacts facts = run_facts(parts, loop, counts);
  if (recorder) facts.recording_dropped = recorder->statistics().dropped;
  facts.digest_known = !outcome.digest_wanted || !outcome.seen_sha256.empty();
  facts.warnings = warnings;
  if (parts.application) facts.application = parts.application->facts();
  return facts;
}

json run_result(const RunParts& parts, const RunOutcome& outcome, const Recorder* recorder,
                const RunContextText& text, const RunFacts& facts, const Verdict& verdict) {
  json j = identity_json(parts.rig);
  j["verdict"] = verdict_json(verdict);
  j["warnings"] = json::array();
  for (const Finding& f : verdict.findings)
    if (f.severity > Severity::note) j["warnings"].push_back(f.text());
  j.update({{"utc", text.utc},
            {"virtual_epoch", text.virtual_epoch},
            {"engine", text.engine},
            {"command", text.command},
            {"machine", text.machine},
            {"duration_s", outcome.loop.period.seconds() *
                               static_cast<double>(outcome.loop.cycles_run + outcome.loop.cycles_skipped)},
            {"loop", loop_json(parts, outcome.loop)},
            {"seen_sha256", outcome.digest_wanted ? json(outcome.seen_sha256) : json()},
            {"channels", json::array()},
            {"sinks", json::array()}});
  for (std::size_t i = 0; i < parts.channels.size(); ++i) {
    const auto& c = parts.channels[i];
    json channel = channel_json(*c, facts.channels[i], outcome.t0);
    if (c->pair) channel["pair"] = pair_result(*c);
    channel["accounts"] = accounts_json(*c, parts);
    j["channels"].push_back(std::move(channel));
  }
  for (const auto& s : parts.sinks) j["sinks"].push_back(sink_json(*s));
  if (parts.faults)
    for (const FaultBench::Entry& e : parts.faults->entries())
      if (!e.injector->scheduled().empty() || !e.injector->live().empty())
        j["faults"].push_back(faults_json(e, &outcome.t0));
  if (facts.application) j["application"] = application_json(parts.rig, *facts.application);
  j["times"] = times_json(parts, outcome, recorder);
  if (recorder) j["recording"] = recorder_json(*recorder, text.recording);
  return j;
}

namespace {

std::string watch_line(const json& w) {
  const std::string state = w["state"];
  std::string out = fmt::format("          watch: {}, {} windows", state, w["windows"].get<std::uint64_t>());
  if (state == "learning")
    out += fmt::format(" ({} of {} of the baseline)", w["learned"].get<std::uint64_t>(),
                       w["baseline_windows"].get<std::uint64_t>());
  double highest = -1;
  std::string of;
  for (const json& p : w["parameters"])
    if (p.contains("highest") && p["highest"].get<double>() > highest) highest = p["highest"], of = p["name"];
  if (!of.empty()) out += fmt::format(", highest sum {:.2f} of its threshold ({})", highest, of);
  out += '\n';
  if (w["alarms"].get<std::uint64_t>() > 0)
    out += fmt::format("          ALARM at {:.1f} s: {}\n", w["alarm"]["raised_s"].get<double>(),
                       w["text"].get<std::string>());
  return out;
}

std::string channel_line(const json& c) {
  std::string out = fmt::format("{:<9} {} ", c["name"].get<std::string>(), c["backend"].get<std::string>());
  const auto delivered = c["delivered"].get<std::uint64_t>(), late = c["late_samples"].get<std::uint64_t>();
  if (c["due"].is_number())
    out += fmt::format("{:.2f} of {:.2f} Hz, {} of {} samples, {} missing, {} late",
                       c["rate_hz"].get<double>(), c["nominal_rate_hz"].get<double>(), delivered,
                       c["due"].get<std::uint64_t>(), c["missing"].get<std::uint64_t>(), late);
  else
    out += fmt::format("{} samples, {} lost, {} late", delivered, c["missing"].get<std::uint64_t>(), late);
  if (c["silent_since_s"].is_number())
    out += delivered > 0 ? fmt::format(", silent since {:.1f} s", c["silent_since_s"].get<double>())
                         : std::string(", silent");
  const auto ns = [](const json& v) { return text_of(Duration(v.get<std::int64_t>())); };
  return out + fmt::format("; age p50 {} p99 {}\n", ns(c["age"]["p50_ns"]), ns(c["age"]["p99_ns"]));
}

}  // namespace

std::string summary_text(const json& r) {
  const auto ns = [](const json& v) { return text_of(Duration(v.get<std::int64_t>())); };
  const json& loop = r["loop"];
  std::string out = verdict_text(r["verdict"]);
  out += fmt::format("{}: {:.1f} s on the {} clock, {}\n", r["rig"].get<std::string>(),
                     r["duration_s"].get<double>(), r["clock"].get<std::string>(),
                     loop["reason"].get<std::string>());
  if (r["virtual_epoch"].get<bool>())
    out += fmt::format("time      virtual: every virtual run begins at {}\n", r["utc"].get<std::string>());
  out += fmt::format(
      "loop      {:g} Hz, {} cycles, {} skipped, {} overruns; wake-up p50 {} p99 {}; cycle p50 {} p99 {}\n",
      loop["rate_hz"].get<double>(), loop["cycles_run"].get<std::uint64_t>(),
      loop["cycles_skipped"].get<std::uint64_t>(), loop["overruns"].get<std::uint64_t>(),
      ns(loop["wake_error"]["p50_ns"]), ns(loop["wake_error"]["p99_ns"]), ns(loop["cycle_time"]["p50_ns"]),
      ns(loop["cycle_time"]["p99_ns"]));
  if (loop["misses"]["total"].get<std::uint64_t>() > 0) {
    out += fmt::format("misses    {}:", loop["misses"]["total"].get<std::uint64_t>());
    for (const auto& [cause, n] : loop["misses"]["by_cause"].items())
      if (n.get<std::uint64_t>() > 0) out += fmt::format(" {} {}", n.get<std::uint64_t>(), cause);
    out += '\n';
  }
  for (const json& s : loop.value("settings", json::array()))
    if (s["wanted"].get<bool>() && !s["granted"].get<bool>())
      out += fmt::format("not granted: {}: {}\n", s["name"].get<std::string>(), s["text"].get<std::string>());
  for (const json& c : r["channels"]) {
    out += channel_line(c);
    if (const std::string by = c["replaced_by"]; !by.empty())
      out += fmt::format("          replaced by {}\n", by);
    if (c.contains("pair")) out += fmt::format("          pair: {}\n", pair_line(c["pair"]));
    if (c.contains("pair") && c["pair"].contains("watch")) out += watch_line(c["pair"]["watch"]);
  }
  for (const json& s : r["sinks"])
    out += fmt::format("{:<9} {} {} commands, {} applied, {} late, {} failed\n", s["name"].get<std::string>(),
                       s["backend"].get<std::string>(), s["accepted"].get<std::uint64_t>(),
                       s["applied"].get<std::uint64_t>(), s["late"].get<std::uint64_t>(),
                       s["failed"].get<std::uint64_t>());
  if (const auto e = r.find("expect"); e != r.end())
    out +=
        fmt::format("expect    {} of {} hold\n",
                    std::ranges::count_if(*e, [](const json& x) { return x["holds"] == true; }), e->size());
  if (const auto a = r.find("application"); a != r.end()) {
    out += fmt::format("app       {}: {} turns, {} late, {} skipped, {} restarts",
                       (*a)["name"].get<std::string>(), (*a)["turns"].get<std::uint64_t>(),
                       (*a)["late"].get<std::uint64_t>(), (*a)["skipped"].get<std::uint64_t>(),
                       (*a)["restarts"].get<std::uint64_t>());
    if (a->contains("answer"))
      out +=
          fmt::format("; answers p50 {} p99 {}", ns((*a)["answer"]["p50_ns"]), ns((*a)["answer"]["p99_ns"]));
    out += '\n';
  }
  for (const json& c : r.value("faults", json::array())) {
    const auto line = [&](const std::string& what, const json& f) {
      out += fmt::format("fault     {}: {}: {} times on, {} seen, {} dropped, {} changed, {} delayed\n",
                         c["channel"].get<std::string>(), what, f["times"].get<std::uint64_t>(),
                         f["seen"].get<std::uint64_t>(), f["dropped"].get<std::uint64_t>(),
                         f["changed"].get<std::uint64_t>(), f["delayed"].get<std::uint64_t>());
    };
    if (c.contains("earlier"))
      line(fmt::format("{} earlier live ones", c["earlier"]["faults"].get<std::uint64_t>()), c["earlier"]);
    for (const json& f : c["faults"]) line(f["text"].get<std::string>(), f);
  }
  const json analyses = r.value("analyses", json::object());
  for (const auto& [name, a] : analyses.items())
    out += fmt::format("{:<9} {}\n", name, a["text"].get<std::string>());
  if (r.contains("recording"))
    out += fmt::format(
        "recording {} ({} messages, {:.1f} MB, {} dropped)\n", r["recording"]["file"].get<std::string>(),
        r["recording"]["messages"].get<std::uint64_t>(), r["recording"]["bytes"].get<double>() * 1e-6,
        r["recording"]["dropped"].get<std::uint64_t>());
  if (r["seen_sha256"].is_string()) {
    const std::string seen = r["seen_sha256"];
    out += fmt::format("digest    of all that the application saw (a replay gives the same): {}\n",
                       seen.empty() ? "not known, its computation could not keep up" : seen);
  }
  return out;
}

}  // namespace rigor

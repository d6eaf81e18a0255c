#include "bench/result/report_json.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/control/fault_control.h"
#include "bench/control/pair_snapshot.h"
#include "bench/expect/expected_forms.h"
#include "bench/result/verdict_forms.h"
#include "bench/run/run_json.h"

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

json loop_json(const RunReport& r) {
  const RunSummary& s = r.outcome.loop;
  json loop{{"rate_hz", s.period.hz()},
            {"reason", to_string(s.reason)},
            {"cycles_run", s.cycles_run},
            {"cycles_skipped", s.cycles_skipped},
            {"overruns", s.overruns},
            {"late_wakeups", s.late_wakeups},
            {"minor_faults", s.minor_faults},
            {"major_faults", s.major_faults},
            {"spin_us", static_cast<double>(r.identity.spin.ns()) * 1e-3},
            {"wake_error", histogram_json(s.wake_error)},
            {"cycle_time", histogram_json(s.cycle_time)}};
  for (const StepTiming& step : s.steps)
    loop["steps"].push_back({{"name", step.name}, {"ran", histogram_json(step.ran)}});
  for (const RealtimeSetting& x : s.settings)
    loop["settings"].push_back(
        {{"name", x.name}, {"wanted", x.wanted}, {"granted", x.granted}, {"text", x.text}});
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

/// Where the samples of a channel went, from the source to the application.
json accounts_json(const ChannelReport& c) {
  json j{{"taken_by_loop", c.taken},    {"before_start", c.before_start},
         {"shown", c.port.fresh},       {"superseded", c.port.superseded},
         {"overflow", c.port.overflow}, {"not_due_at_end", c.not_due_at_end()},
         {"sources", json::array()}};
  for (const FaultyReport& f : c.faulty) {
    json source = faulty_json(f);
    source.update({{"name", f.name},
                   {"received", f.inner.received},
                   {"ring_full", f.inner.ring_full},
                   {"no_slot_in_source", f.inner.no_slot},
                   {"lost_in_source", f.inner.lost}});
    j["sources"].push_back(std::move(source));
  }
  return j;
}

json channel_json(const ChannelReport& c, const ChannelFacts& facts, BenchTime t0) {
  const PortCounters& n = c.port;
  const HealthSnapshot& h = c.health;
  json j{{"name", c.name},
         {"kind", kind_name(c.kind)},
         {"backend", c.backend},
         {"replaced_by", c.replaced_by},
         {"nominal_rate_hz", c.period.hz()},
         {"rate_hz", facts.rate_hz()},
         {"due", or_null(facts.due)},
         {"delivered", facts.delivered},
         {"missing", facts.missing()},
         {"silent_since_s", facts.silent ? json(facts.last_s.value_or(0)) : json()},
         {"latency_ms", c.latency.seconds() * 1e3},
         {"fresh", n.fresh},
         {"superseded", n.superseded},
         {"late_samples", n.late_samples},
         {"overdue_cycles", n.overdue_cycles},
         {"lost_samples", n.lost_samples},
         {"disconnected_cycles", n.disconnected_cycles},
         {"overflow", n.overflow},
         {"before_start", c.before_start},
         {"age", histogram_json(c.age)},
         {"arrival", histogram_json(c.arrival)},
         {"gap_count", c.gap_count},
         {"gaps", json::array()},
         {"status", json::array()},
         {"health",
          {{"received", h.received},
           {"incomplete", h.incomplete},
           {"lost", h.lost},
           {"no_slot", h.no_slot},
           {"ring_full", h.ring_full},
           {"protocol_errors", h.protocol_errors},
           {"retries", h.retries},
           {"reconnects", h.reconnects}}}};
  for (const Gap& g : c.gaps)
    j["gaps"].push_back({{"t_s", (g.t - t0).seconds()}, {"after", g.after_sequence}, {"missing", g.missing}});
  for (const StatusSpan& s : c.status)
    j["status"].push_back({{"t_s", (s.t - t0).seconds()}, {"status", name_of(s.status)}});
  if (c.pair) j["pair"] = pair_json(*c.pair);
  j["accounts"] = accounts_json(c);
  for (const ChannelReport::Picture& p : c.pictures)
    j["pictures"].push_back({{"file", p.file}, {"caption", p.caption}});
  return j;
}

/// Where the time went: of the loop's steps `loop.steps` has more.
json times_json(const RunReport& r) {
  json j{{"wall_s", r.outcome.wall_s}, {"cpu_s", r.outcome.cpu_s}, {"sensors", json::array()}};
  for (const StepTiming& step : r.outcome.loop.steps)
    j["loop_s"][step.name] = step.ran.mean_ns() * static_cast<double>(step.ran.count()) * 1e-9;
  for (const SensorTimeReport& t : r.sensor_times)
    j["sensors"].push_back(
        {{"channel", t.channel},
         {"captures", t.captures},
         {"wall_s", t.wall_s},
         {"world_s", t.world_s},
         {"collect_s", t.collect_s},
         {"prepare_s", t.prepare_s},
         {"light_s", t.light_s},
         {"model_s", std::max(0.0, t.wall_s - t.world_s - t.collect_s - t.prepare_s - t.light_s)},
         {"cpu_s", t.cpu_s},
         {"longest_ms", t.longest_ms}});
  if (r.recorded) j["recorder_cpu_s"] = r.recorded->cpu_s;
  return j;
}

json sink_json(const SinkReport& s) {
  json j = commands_json(s.commands);
  j.update({{"name", s.name}, {"backend", s.backend}, {"replaced_by", s.replaced_by}});
  return j;
}

json bridge_json(const RunBridgeReport& b) {
  json j{{"name", b.name},           {"samples", b.samples},      {"dropped", b.dropped},
         {"after_end", b.after_end}, {"cpu_s", b.cpu_s},          {"channels", json::array()},
         {"topics", json::array()},  {"commands", json::array()}, {"problems", b.traffic.problems}};
  for (const auto& c : b.channels)
    j["channels"].push_back({{"name", c.name}, {"samples", c.samples}, {"dropped", c.dropped}});
  for (const auto& t : b.traffic.topics)
    j["topics"].push_back({{"topic", t.topic},
                           {"type", t.type},
                           {"qos", t.qos},
                           {"messages", t.messages},
                           {"accepted", t.accepted},
                           {"dropped", t.dropped},
                           {"peers", t.peers}});
  for (const auto& c : b.traffic.commands)
    j["commands"].push_back({{"topic", c.topic},
                             {"type", c.type},
                             {"sink", c.sink},
                             {"received", c.received},
                             {"accepted", c.accepted},
                             {"rejected", c.rejected},
                             {"superseded", c.superseded},
                             {"dropped", c.dropped},
                             {"clamped", c.clamped},
                             {"timeouts", c.timeouts},
                             {"peers", c.peers},
                             {"last_rejection", c.last_rejection}});
  return j;
}

json application_json(const std::string& name, const ApplicationFacts& a) {
  json j{{"name", name},
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

json judgement_json(const RunReport& r) {
  json j = verdict_json(r.verdict);
  if (!r.fail_on.empty()) j.update({{"fail_on", r.fail_on.names()}, {"failed_on", r.failed_on.names()}});
  return j;
}

}  // namespace

json report_json(const RunReport& r) {
  const RunIdentity& id = r.identity;
  json j = identity_json(id);
  j.update({{"verdict", judgement_json(r)},
            {"warnings", json::array()},
            {"utc", id.utc},
            {"virtual_epoch", id.virtual_epoch},
            {"renderer", id.renderer},
            {"command", id.command},
            {"machine", id.machine},
            {"duration_s", r.duration_s()},
            {"loop", loop_json(r)},
            {"input_sha256", r.outcome.digest_wanted ? json(r.outcome.input_sha256) : json()},
            {"channels", json::array()},
            {"sinks", json::array()},
            {"times", times_json(r)}});
  for (const Finding& f : r.verdict.findings)
    if (f.severity > Severity::note) j["warnings"].push_back(f.text());
  for (std::size_t i = 0; i < r.channels.size(); ++i)
    j["channels"].push_back(channel_json(r.channels[i], r.facts.channels[i], r.outcome.t0));
  for (const SinkReport& s : r.sinks) j["sinks"].push_back(sink_json(s));
  for (const RunBridgeReport& b : r.bridges) j["bridges"].push_back(bridge_json(b));
  for (const ChannelFaultReport& f : r.faults) j["faults"].push_back(faults_json(f));
  if (r.facts.application) j["application"] = application_json(id.application, *r.facts.application);
  if (!r.expected.empty()) j["expect"] = to_json(r.expected);
  for (const AnalysisReport& a : r.analyses) {
    json& of = j["analyses"][a.name] = json::parse(a.json);
    of["text"] = a.line;
  }
  if (const auto& f = r.recorded)
    j["recording"] = {{"file", f->file},          {"messages", f->messages}, {"bytes", f->bytes},
                      {"chunks", f->chunks},      {"samples", f->samples},   {"dropped", f->dropped},
                      {"after_end", f->after_end}};
  return j;
}

std::string RunReport::json() const { return report_json(*this).dump(); }

}  // namespace rigor

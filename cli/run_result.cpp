#include "cli/run_result.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "cli/fault_control.h"
#include "cli/terminal.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/pair_values.h"
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

const char* status_name(PortStatus s) {
  switch (s) {
    case PortStatus::never:
      return "never";
    case PortStatus::fresh:
      return "fresh";
    case PortStatus::stale:
      return "stale";
    case PortStatus::late:
      return "late";
    case PortStatus::lost:
      return "lost";
  }
  return "?";
}

json loop_json(const RunParts& parts, const RunSummary& s) {
  json loop{{"rate_hz", 1e9 / static_cast<double>(s.period.ns())},
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

json channel_json(const RunChannel& c, BenchTime t0) {
  const PortCounters& n = c.port.counters();
  const Health& h = c.source->health();
  const double span_s = (c.t_last - c.t_first).seconds();
  json j{
      {"name", c.entry->name},
      {"kind", kind_name(c.entry->kind)},
      {"backend",
       c.entry->is_pair ? c.entry->source.backend + " | " + c.entry->twin.backend : c.entry->source.backend},
      {"replaced_by", c.replaced_by},
      {"nominal_rate_hz", 1.0 / c.entry->period.seconds()},
      {"rate_hz", n.fresh > 1 && span_s > 0 ? static_cast<double>(n.fresh + n.superseded - 1) / span_s : 0.0},
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
    j["status"].push_back(
        {{"t_s", (c.spans[i].t - t0).seconds()}, {"status", status_name(c.spans[i].status)}});
  return j;
}

json sink_json(const RunSink& s) {
  const Sink::Counters& n = s.sink->counters();
  return {
      {"name", s.entry->name},         {"backend", s.entry->sink.backend}, {"replaced_by", s.replaced_by},
      {"accepted", n.accepted.load()}, {"applied", n.applied.load()},      {"late", n.late.load()},
      {"failed", n.failed.load()},     {"dropped", n.dropped.load()},      {"made_safe", n.made_safe.load()}};
}

std::string unit_of(SampleKind kind) {
  if (kind == SampleKind::image) return "DN";
  if (const auto values = compared_values(kind); !values.empty()) return std::string(values.front().unit);
  return kind == SampleKind::point_cloud || kind == SampleKind::range_image ? "m" : "";
}

json pair_json(const RunChannel& c) {
  const PairSnapshot s = c.pair->statistics();
  json j{{"count", s.compared},
         {"unlike", s.unlike},
         {"skipped", s.skipped},
         {"switches", c.pair->switches()},
         {"active", name_of(c.pair->active())},
         {"real_missing", s.missing_of(PairSide::real)},
         {"simulated_missing", s.missing_of(PairSide::simulated)},
         {"bias", s.all.bias},
         {"sigma", s.all.sigma},
         {"unit", unit_of(c.entry->kind)},
         {"series", json::array()}};
  const auto values = compared_values(c.entry->kind);
  if (!values.empty() && s.values == values.size()) {
    j["values"] = json::array();
    for (std::size_t i = 0; i < values.size(); ++i)
      j["values"].push_back({{"name", values[i].name},
                             {"unit", values[i].unit},
                             {"bias", s.value[i].bias},
                             {"sigma", s.value[i].sigma}});
  }
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

}  // namespace

json run_result(const RunParts& parts, const RunOutcome& outcome, const Recorder* recorder,
                const RunContextText& text) {
  const RigConfig& rig = parts.rig;
  json j{{"rig", rig.name},
         {"file", rig.file.string()},
         {"clock", rig.clock == ClockKind::wall ? "wall" : "virtual"},
         {"seed", rig.seed},
         {"version", RIGOR_VERSION},
         {"utc", text.utc},
         {"engine", text.engine},
         {"duration_s", outcome.loop.period.seconds() *
                            static_cast<double>(outcome.loop.cycles_run + outcome.loop.cycles_skipped)},
         {"loop", loop_json(parts, outcome.loop)},
         {"seen_sha256", outcome.seen_sha256},
         {"channels", json::array()},
         {"sinks", json::array()}};
  for (const auto& c : parts.channels) {
    json channel = channel_json(*c, outcome.t0);
    if (c->pair) channel["pair"] = pair_json(*c);
    j["channels"].push_back(std::move(channel));
  }
  for (const auto& s : parts.sinks) j["sinks"].push_back(sink_json(*s));
  if (parts.faults)
    for (const FaultBench::Entry& e : parts.faults->entries())
      if (!e.injector->scheduled().empty() || !e.injector->live().empty())
        j["faults"].push_back(faults_json(e, &outcome.t0));
  if (recorder) j["recording"] = recorder_json(*recorder, text.recording);
  return j;
}

std::string summary_text(const json& r) {
  const auto ns = [](const json& v) { return text_of(Duration(v.get<std::int64_t>())); };
  const json& loop = r["loop"];
  std::string out = fmt::format("{}: {:.1f} s on the {} clock, {}\n", r["rig"].get<std::string>(),
                                r["duration_s"].get<double>(), r["clock"].get<std::string>(),
                                loop["reason"].get<std::string>());
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
    out +=
        fmt::format("{:<9} {} {:.2f} Hz, {} samples, {} lost, {} late; age p50 {} p99 {}\n",
                    c["name"].get<std::string>(), c["backend"].get<std::string>(), c["rate_hz"].get<double>(),
                    c["fresh"].get<std::uint64_t>(), c["lost_samples"].get<std::uint64_t>(),
                    c["late_samples"].get<std::uint64_t>(), ns(c["age"]["p50_ns"]), ns(c["age"]["p99_ns"]));
    if (const std::string by = c["replaced_by"]; !by.empty())
      out += fmt::format("          replaced by {}\n", by);
    if (c.contains("pair") && c["pair"].value("count", 0) > 0)
      out += fmt::format("          pair: {} compared, bias {:.3f}, sigma {:.3f} {}\n",
                         c["pair"]["count"].get<std::uint64_t>(), c["pair"]["bias"].get<double>(),
                         c["pair"]["sigma"].get<double>(), c["pair"].value("unit", ""));
  }
  for (const json& s : r["sinks"])
    out += fmt::format("{:<9} {} {} commands, {} applied, {} late, {} failed\n", s["name"].get<std::string>(),
                       s["backend"].get<std::string>(), s["accepted"].get<std::uint64_t>(),
                       s["applied"].get<std::uint64_t>(), s["late"].get<std::uint64_t>(),
                       s["failed"].get<std::uint64_t>());
  for (const json& c : r.value("faults", json::array()))
    for (const json& f : c["faults"])
      out += fmt::format("fault     {}: {}: {} times on, {} seen, {} dropped, {} changed, {} delayed\n",
                         c["channel"].get<std::string>(), f["text"].get<std::string>(),
                         f["times"].get<std::uint64_t>(), f["seen"].get<std::uint64_t>(),
                         f["dropped"].get<std::uint64_t>(), f["changed"].get<std::uint64_t>(),
                         f["delayed"].get<std::uint64_t>());
  if (r.contains("recording"))
    out += fmt::format(
        "recording {} ({} messages, {:.1f} MB, {} dropped)\n", r["recording"]["file"].get<std::string>(),
        r["recording"]["messages"].get<std::uint64_t>(), r["recording"]["bytes"].get<double>() * 1e-6,
        r["recording"]["dropped"].get<std::uint64_t>());
  const std::string seen = r["seen_sha256"];
  out += fmt::format("seen      {}\n", seen.empty() ? "not known: the digest could not keep up" : seen);
  return out;
}

}  // namespace rigor

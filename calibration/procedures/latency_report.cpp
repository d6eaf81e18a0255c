#include "calibration/procedures/latency_report.h"

#include <fmt/format.h>

#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/files/file_digest.h"

namespace rigor {
namespace {

using namespace calibration;
using nlohmann::json;

double latency_ms(std::int64_t ns) { return static_cast<double>(ns) / 1e6; }

/// None where the samples are too few for a share so small to be one of them.
std::optional<std::int64_t> shown(std::int64_t quantile_ns, std::size_t samples, std::size_t at_least) {
  return samples < at_least ? std::nullopt : std::optional(quantile_ns);
}
std::string ms_text(std::optional<std::int64_t> ns) {
  return ns ? fmt::format("{:.3f}", latency_ms(*ns)) : "–";
}
json ms_json(std::optional<std::int64_t> ns) { return ns ? json(latency_ms(*ns)) : json(); }

json to_json(const LatencyCalibrationOptions& o, const ChannelLatency& c) {
  const LatencyFit& f = c.fit;
  const double n = static_cast<double>(f.samples);
  json parts = json::array();
  for (const auto& p : f.parts)
    parts.push_back({{"part", p.name},
                     {"samples", p.samples},
                     {"low_ms", latency_ms(p.low_ns)},
                     {"high_ms", latency_ms(p.high_ns)}});
  json j{{"channel", c.channel},
         {"key", c.key()},
         {"simulated", c.from.simulated},
         {"samples", f.samples},
         {"left_out",
          {{"clock_unsure", o.trigger.empty() ? c.from.unsure : 0},
           {"of_faults", c.from.substituted},
           {"near_the_end", c.from.near_end},
           {"without_trigger", c.from.untriggered}}},
         {"p50_ms", latency_ms(f.p50_ns)},
         {"p50_interval_ms", {latency_ms(f.p50_low_ns), latency_ms(f.p50_high_ns)}},
         {"p99_ms", ms_json(shown(f.p99_ns, f.samples, 100))},
         {"p999_ms", ms_json(shown(f.p999_ns, f.samples, 1000))},
         {"max_ms", latency_ms(f.max_ns)},
         {"sigma_capture_ms", latency_ms(c.sigma_ns)},
         {"bound",
          {{"ms", latency_ms(f.bound_ns)},
           {"method", f.method == LatencyBound::order_statistic ? "order statistic" : "exponential tail"},
           {"samples_needed", f.samples_needed},
           {"proven_quantile", f.proven_quantile}}},
         {"stationary", f.parts.empty() ? json() : json(f.stationary)},
         {"part_quantile", f.parts.empty() ? json() : json(f.part_quantile)},
         {"parts", parts},
         {"present",
          {{"latency_ms", ms_json(c.present_ns)},
           {"late", c.from.late},
           {"late_share", static_cast<double>(c.from.late) / n}}},
         {"recommended",
          {{"latency_ms", latency_ms(c.put_ns)},
           {"by", c.by_median ? "median" : "bound"},
           {"late", c.late_then},
           {"late_share", static_cast<double>(c.late_then) / n}}},
         {"warnings", c.warnings}};
  if (!o.trigger.empty()) j["stamps_after_trigger_ms"] = latency_ms(c.after_trigger_ns);
  return j;
}

}  // namespace

nlohmann::json latency_json(const LatencyCalibrationOptions& o, const LatencyCalibration& result) {
  json j{{"inputs", json::array()},
         {"quantile", o.fit.quantile},
         {"confidence", o.fit.confidence},
         {"trigger", o.trigger.empty() ? json() : json(o.trigger)},
         {"channels", json::array()},
         {"unknown", json::array()},
         {"set", json::array()},
         {"warnings", result.warnings},
         {"interrupted", result.interrupted}};
  for (const auto& file : result.inputs)
    j["inputs"].push_back({{"file", file.string()}, {"sha256", sha256_of(file)}});
  for (const ChannelLatency& c : result.channels) j["channels"].push_back(to_json(o, c));
  for (const ChannelLatency* c : result.for_rig()) j["set"].push_back(c->rig_override());
  for (const Error& e : result.unknown) j["unknown"].push_back({{"channel", e.where}, {"why", e.message}});
  return j;
}

std::string latency_text(const LatencyCalibrationOptions& o, const LatencyCalibration& result) {
  std::string out;
  const auto put = [&]<class... T>(fmt::format_string<T...> form, T&&... values) {
    fmt::format_to(std::back_inserter(out), form, std::forward<T>(values)...);
  };
  if (result.interrupted) put("INTERRUPTED: of what was read so far\n");
  const std::string& rig_file = result.rig_file;
  put("ms from {} to arrival; share that is to be in time {:g}, confidence {:g}\n",
      o.trigger.empty() ? "capture" : "the trigger " + o.trigger, o.fit.quantile, o.fit.confidence);
  put("  {:<18}{:>8}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}{:>7}{:>14}{:>7}\n", "channel", "samples", "p50",
      "p99", "p99.9", "max", "sigma", "latency_ms", "late", "recommended", "late");
  for (const ChannelLatency& c : result.channels) {
    const LatencyFit& f = c.fit;
    put("  {:<18}{:>8}{:>10.3f}{:>10}{:>10}{:>10.3f}{:>10.3f}{:>12}{:>7}{:>14}{:>7}\n", c.channel, f.samples,
        latency_ms(f.p50_ns), ms_text(shown(f.p99_ns, f.samples, 100)),
        ms_text(shown(f.p999_ns, f.samples, 1000)), latency_ms(f.max_ns), latency_ms(c.sigma_ns),
        c.present_ns ? fmt::format("{:g}", latency_ms(*c.present_ns)) : "differs", c.from.late,
        fmt::format("{:.1f}", latency_ms(c.put_ns)), c.late_then);
  }
  for (const ChannelLatency& c : result.channels) {
    if (!o.trigger.empty())
      put("{}: its stamps are {:.3f} ms after the captures that follow from the trigger\n", c.channel,
          latency_ms(c.after_trigger_ns));
    if (c.by_median)
      put("{}: no device clock; its stamps are the arrival less latency_ms, which is to be typical: the "
          "median, {:.3f} to {:.3f} ms\n",
          c.channel, latency_ms(c.fit.p50_low_ns), latency_ms(c.fit.p50_high_ns));
  }
  put("put into the rig{}:\n", rig_file.empty() ? "" : " " + rig_file);
  std::string sets;
  for (const ChannelLatency* c : result.for_rig()) {
    put("  {}: {:.1f}{}\n", c->key(), latency_ms(c->put_ns),
        c->from.simulated ? "    # simulated: what this machine needs, not a device" : "");
    sets += " --set " + c->rig_override();
  }
  if (!sets.empty() && !rig_file.empty()) put("try it: rigor run {}{}\n", rig_file, sets);
  for (const Error& e : result.unknown) put("NOT KNOWN {}\n", e.text());
  for (const std::string& w : result.warnings) put("warning: {}\n", w);
  return out;
}

}  // namespace rigor

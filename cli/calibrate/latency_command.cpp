// `rigor calibrate latency`: how long a channel's samples took from capture to arrival, and the latency_ms
// that follows.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "bench/console/terminal.h"
#include "cli/calibrate/calibrate.h"
#include "cli/calibrate/latency_samples.h"
#include "rt-core/stop.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using namespace calibration;
using nlohmann::json;

struct LatencyCommandOptions {
  std::vector<std::filesystem::path> inputs;
  std::vector<std::string> channels;
  LatencyOptions fit;
  std::string trigger;
  double trigger_to_capture_ms = 0;
  bool json = false;
};

struct ChannelLatency {
  std::string channel, rig_channel;
  LatencySamples from;
  LatencyFit fit;
  std::int64_t sigma_ns = 0;               ///< of the capture, the median
  std::optional<std::int64_t> present_ns;  ///< latency_ms of the rig; none: the recordings' rigs differ
  std::int64_t put_ns = 0;                 ///< what goes into the rig
  bool by_median = false;  ///< the driver stamps the arrival less latency_ms: the typical latency counts
  std::size_t late_then = 0;
  std::vector<std::string> warnings;
  /// The simulated side of a pair: its latency_ms is that of the device.
  [[nodiscard]] bool simulated_side() const { return channel == rig_channel + "/simulated"; }
  [[nodiscard]] std::string key() const { return "channels." + rig_channel + ".latency_ms"; }
};

double ms(std::int64_t ns) { return static_cast<double>(ns) / 1e6; }

std::int64_t median(std::vector<std::int64_t> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

void add_warnings(const LatencyCommandOptions& o, ChannelLatency& c) {
  const LatencySamples& s = c.from;
  const LatencyFit& f = c.fit;
  const auto warn = [&](const std::string& text) { c.warnings.push_back(c.channel + ": " + text); };
  if (!c.by_median && f.method == LatencyBound::exponential_tail) {
    const double n = static_cast<double>(f.samples), needed = static_cast<double>(f.samples_needed);
    warn(fmt::format(
        "{} of the {} samples that the quantile {:g} needs ({:.0f} s): extrapolated as an exponential tail; "
        "the largest alone bounds the quantile {:.4f}",
        f.samples, f.samples_needed, o.fit.quantile, std::ceil(s.span_s * needed / n), f.proven_quantile));
  }
  if (!f.stationary) {
    std::vector<std::string> parts;
    for (const auto& p : f.parts)
      parts.push_back(fmt::format("{} {:.3f} to {:.3f} ms", p.name, ms(p.low_ns), ms(p.high_ns)));
    warn(
        fmt::format("NOT STATIONARY: the quantile {:g} is {}. The slowest part counts; find out what changed",
                    f.part_quantile, fmt::join(parts, ", ")));
  } else if (f.parts.empty()) {
    warn("too few samples to compare the halves of the recording");
  }
  if (s.faults > 0)
    warn(fmt::format(
        "{} faults acted on it, and what they delayed counts as the device's: record without them",
        s.faults));
  if (s.negative > 0)
    warn(fmt::format("{} samples arrive before their capture: its stamps are wrong by as much", s.negative));
  if (o.trigger.empty()) {
    if (s.unsure > 0)
      warn(fmt::format("{} samples are left out: the device's clock was not known (kClockUnsure)", s.unsure));
    if (2 * c.sigma_ns > f.bound_ns)
      warn(
          fmt::format("its captures are known to ± {:.3f} ms only, which is most of the result: the driver's "
                      "guide says what makes them surer",
                      ms(c.sigma_ns)));
    return;
  }
  if (s.without_sample > 0) warn(fmt::format("{} triggers brought no sample", s.without_sample));
  if (s.untriggered > 0) warn(fmt::format("{} samples have no trigger of their own", s.untriggered));
  if (s.least_interval_ns > 0 && f.max_ns * 2 > s.least_interval_ns)
    warn(fmt::format(
        "two triggers are {:.3f} ms apart, and latencies above that cannot be told: trigger more slowly",
        ms(s.least_interval_ns)));
}

Result<ChannelLatency> measure(const LatencyCommandOptions& o, const std::string& name, LatencySamples from) {
  if (const auto why = why_unknown(from, name, o.inputs.front().string(), o.trigger); !why.empty())
    return fail(ErrorCode::bad_input, name, why);
  ChannelLatency c;
  c.channel = name, c.rig_channel = name.substr(0, name.find('/'));
  LatencyOptions options = o.fit;
  options.sigma_ns = c.sigma_ns = median(from.sigma_ns);
  auto fit = fit_latency(from.parts, options);
  if (!fit) return fail(fit.error().code, name, fit.error().message);
  c.fit = std::move(*fit), c.from = std::move(from);
  const auto [least, most] = std::minmax_element(c.from.present_ns.begin(), c.from.present_ns.end());
  if (*least == *most) c.present_ns = *least;
  c.by_median = !o.trigger.empty() && c.from.unsure * 2 > c.fit.samples;
  c.put_ns = c.by_median ? round_latency_up(c.fit.p50_ns) : c.fit.recommended_ns;
  // Of a channel by the median the release is the arrival: none is late, whatever it is.
  for (const LatencyPart& p : c.by_median ? std::vector<LatencyPart>{} : c.from.parts)
    c.late_then += static_cast<std::size_t>(
        std::ranges::count_if(p.latency_ns, [&](std::int64_t l) { return l > c.put_ns; }));
  add_warnings(o, c);
  return c;
}

/// The channels that are asked for, or all of them.
Result<std::vector<std::string>> wanted(const LatencyCommandOptions& o,
                                        const std::vector<StampedRecording>& recordings) {
  std::vector<std::string> all, wanted;
  for (const StampedRecording& r : recordings)
    for (const std::string& name : r.names())
      if (std::ranges::find(all, name) == all.end()) all.push_back(name);
  if (o.channels.empty()) return all;
  for (const std::string& asked : o.channels) {
    const std::size_t before = wanted.size();
    for (const std::string& name : all)  // a pair by its name is both of its sides
      if ((name == asked || name.substr(0, name.find('/')) == asked) &&
          std::ranges::find(wanted, name) == wanted.end())
        wanted.push_back(name);
    if (wanted.size() > before || std::ranges::find(wanted, asked) != wanted.end()) continue;
    const std::string file = recordings.front().file.string();
    for (const StampedRecording& r : recordings)
      if (const auto sink = r.sinks.find(asked); sink != r.sinks.end())
        return fail(
            ErrorCode::bad_input, file,
            fmt::format(
                "{} is a sink, whose effect only a channel can show: `rigor calibrate delay {} --first "
                "{}:VALUE --second CHANNEL:INDEX`; its values: {}",
                asked, file, asked, fmt::join(sink->second, ", ")));
    return fail(ErrorCode::bad_input, file,
                "expected a channel " + asked +
                    ", found none of that name; channels: " + joined_or_none(all) + did_you_mean(asked, all));
  }
  return wanted;
}

LatencySamples samples_of(const LatencyCommandOptions& o, const std::string& channel,
                          const std::vector<StampedRecording>& recordings,
                          const std::vector<std::vector<std::int64_t>>& triggers) {
  LatencySamples samples;
  for (std::size_t i = 0; i < recordings.size(); ++i) {
    const RecordedStamps* stamps = recordings[i].find(channel);
    if (stamps == nullptr) continue;
    const std::string name = recordings[i].file.filename().string();
    if (o.trigger.empty())
      add_stamped(*stamps, name, samples);
    else
      add_triggered(*stamps, name, triggers[i], std::llround(o.trigger_to_capture_ms * 1e6), samples);
    samples.faults += stamps->faults;
    samples.simulated = samples.simulated || stamps->simulated;
  }
  return samples;
}

// ------------------------------------------------------------------ what is said

/// None where the samples are too few for a share so small to be one of them.
std::optional<std::int64_t> shown(std::int64_t quantile_ns, std::size_t samples, std::size_t at_least) {
  return samples < at_least ? std::nullopt : std::optional(quantile_ns);
}
std::string ms_text(std::optional<std::int64_t> ns) { return ns ? fmt::format("{:.3f}", ms(*ns)) : "–"; }
json ms_json(std::optional<std::int64_t> ns) { return ns ? json(ms(*ns)) : json(); }

json to_json(const LatencyCommandOptions& o, const ChannelLatency& c) {
  const LatencyFit& f = c.fit;
  const double n = static_cast<double>(f.samples);
  json parts = json::array();
  for (const auto& p : f.parts)
    parts.push_back(
        {{"part", p.name}, {"samples", p.samples}, {"low_ms", ms(p.low_ns)}, {"high_ms", ms(p.high_ns)}});
  json j{{"channel", c.channel},
         {"key", c.key()},
         {"simulated", c.from.simulated},
         {"samples", f.samples},
         {"left_out",
          {{"clock_unsure", o.trigger.empty() ? c.from.unsure : 0},
           {"of_faults", c.from.substituted},
           {"near_the_end", c.from.near_end},
           {"without_trigger", c.from.untriggered}}},
         {"p50_ms", ms(f.p50_ns)},
         {"p50_interval_ms", {ms(f.p50_low_ns), ms(f.p50_high_ns)}},
         {"p99_ms", ms_json(shown(f.p99_ns, f.samples, 100))},
         {"p999_ms", ms_json(shown(f.p999_ns, f.samples, 1000))},
         {"max_ms", ms(f.max_ns)},
         {"sigma_capture_ms", ms(c.sigma_ns)},
         {"bound",
          {{"ms", ms(f.bound_ns)},
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
          {{"latency_ms", ms(c.put_ns)},
           {"by", c.by_median ? "median" : "bound"},
           {"late", c.late_then},
           {"late_share", static_cast<double>(c.late_then) / n}}},
         {"warnings", c.warnings}};
  if (!o.trigger.empty()) j["stamps_after_trigger_ms"] = ms(median(c.from.after_trigger_ns));
  return j;
}

/// Those whose latency goes into the rig: of a pair the device's, unless the other side alone was asked for.
std::vector<const ChannelLatency*> to_put(const std::vector<ChannelLatency>& channels) {
  std::vector<const ChannelLatency*> put;
  for (const ChannelLatency& c : channels)
    if (!c.simulated_side() || std::ranges::none_of(channels, [&](const ChannelLatency& other) {
          return other.rig_channel == c.rig_channel && !other.simulated_side();
        }))
      put.push_back(&c);
  return put;
}
std::string override_of(const ChannelLatency& c) { return fmt::format("{}={:.1f}", c.key(), ms(c.put_ns)); }

void print(const LatencyCommandOptions& o, const std::vector<ChannelLatency>& channels,
           const std::string& rig_file) {
  fmt::print("ms from {} to arrival; share that is to be in time {:g}, confidence {:g}\n",
             o.trigger.empty() ? "capture" : "the trigger " + o.trigger, o.fit.quantile, o.fit.confidence);
  fmt::print("  {:<18}{:>8}{:>10}{:>10}{:>10}{:>10}{:>10}{:>12}{:>7}{:>14}{:>7}\n", "channel", "samples",
             "p50", "p99", "p99.9", "max", "sigma", "latency_ms", "late", "recommended", "late");
  for (const ChannelLatency& c : channels) {
    const LatencyFit& f = c.fit;
    fmt::print("  {:<18}{:>8}{:>10.3f}{:>10}{:>10}{:>10.3f}{:>10.3f}{:>12}{:>7}{:>14}{:>7}\n", c.channel,
               f.samples, ms(f.p50_ns), ms_text(shown(f.p99_ns, f.samples, 100)),
               ms_text(shown(f.p999_ns, f.samples, 1000)), ms(f.max_ns), ms(c.sigma_ns),
               c.present_ns ? fmt::format("{:g}", ms(*c.present_ns)) : "differs", c.from.late,
               fmt::format("{:.1f}", ms(c.put_ns)), c.late_then);
  }
  for (const ChannelLatency& c : channels) {
    if (!o.trigger.empty())
      fmt::print("{}: its stamps are {:.3f} ms after the captures that follow from the trigger\n", c.channel,
                 ms(median(c.from.after_trigger_ns)));
    if (c.by_median)
      fmt::print(
          "{}: no device clock; its stamps are the arrival less latency_ms, which is to be typical: the "
          "median, {:.3f} to {:.3f} ms\n",
          c.channel, ms(c.fit.p50_low_ns), ms(c.fit.p50_high_ns));
  }
  fmt::print("put into the rig{}:\n", rig_file.empty() ? "" : " " + rig_file);
  std::string sets;
  for (const ChannelLatency* c : to_put(channels)) {
    fmt::print("  {}: {:.1f}{}\n", c->key(), ms(c->put_ns),
               c->from.simulated ? "    # simulated: what this machine needs, not a device" : "");
    sets += " --set " + override_of(*c);
  }
  if (!sets.empty() && !rig_file.empty()) fmt::print("try it: rigor run {}{}\n", rig_file, sets);
}

int calibrate_latency(const LatencyCommandOptions& o) {
  const auto wrong = [&](const Error& e) { return report_error(e, o.json); };
  for (const auto& [option, value] :
       {std::pair("--quantile", o.fit.quantile), std::pair("--confidence", o.fit.confidence)})
    if (!(value < 1))
      return wrong(Error{ErrorCode::bad_input, option,
                         fmt::format("expected a share below 1 such as 0.999, got {:g}", value)});
  if (!o.trigger.empty() && o.channels.empty())
    return wrong(Error{ErrorCode::bad_input, "--channel", "expected the channel that --trigger triggers"});
  const auto files = input_files(o.inputs, {".mcap"});
  if (!files) return wrong(files.error());
  StopSource stop;
  SignalStop signals(stop);
  std::vector<StampedRecording> recordings;
  std::vector<std::vector<std::int64_t>> triggers;
  std::vector<std::string> warnings;
  for (const auto& file : *files) {
    auto recording = read_stamps(file, stop.token());
    if (!recording) return wrong(recording.error());
    warnings.insert(warnings.end(), recording->warnings.begin(), recording->warnings.end());
    if (!o.trigger.empty()) {
      auto instants = trigger_instants(*recording, o.trigger, stop.token());
      if (!instants) return wrong(instants.error());
      triggers.push_back(std::move(*instants));
    }
    recordings.push_back(std::move(*recording));
  }
  const auto names = wanted(o, recordings);
  if (!names) return wrong(names.error());

  std::vector<ChannelLatency> channels;
  std::vector<Error> unknown;
  for (const std::string& name : *names) {
    auto channel = measure(o, name, samples_of(o, name, recordings, triggers));
    if (!channel && !o.channels.empty()) return wrong(channel.error());
    if (channel) {
      warnings.insert(warnings.end(), channel->warnings.begin(), channel->warnings.end());
      channels.push_back(std::move(*channel));
    } else {
      unknown.push_back(channel.error());
    }
  }
  if (channels.empty())
    return wrong(unknown.empty() ? Error{ErrorCode::bad_input, files->front().string(),
                                         "expected samples of a channel, got a recording without any"}
                                 : unknown.front());
  for (const ChannelLatency& c : channels)
    for (const ChannelLatency& real : channels)
      if (c.simulated_side() && !real.simulated_side() && real.rig_channel == c.rig_channel &&
          c.put_ns > real.put_ns)
        warnings.push_back(fmt::format(
            "{}: {:g} ms is the device's latency; the simulated side needs {:g} ms on this machine, and is "
            "late where it is the active one",
            c.rig_channel, ms(real.put_ns), ms(c.put_ns)));

  const bool interrupted = stop.token().stop_requested();
  if (o.json) {
    json j{{"inputs", json::array()},        {"quantile", o.fit.quantile},
           {"confidence", o.fit.confidence}, {"trigger", o.trigger.empty() ? json() : json(o.trigger)},
           {"channels", json::array()},      {"unknown", json::array()},
           {"set", json::array()},           {"warnings", warnings},
           {"interrupted", interrupted}};
    for (const auto& file : *files)
      j["inputs"].push_back({{"file", file.string()}, {"sha256", sha256_of(file)}});
    for (const ChannelLatency& c : channels) j["channels"].push_back(to_json(o, c));
    for (const ChannelLatency* c : to_put(channels)) j["set"].push_back(override_of(*c));
    for (const Error& e : unknown) j["unknown"].push_back({{"channel", e.where}, {"why", e.message}});
    fmt::print("{}\n", json_text(j));
  } else {
    if (interrupted) fmt::print("INTERRUPTED: of what was read so far\n");
    print(o, channels, recordings.front().rig_file);
    for (const Error& e : unknown) fmt::print("NOT KNOWN {}\n", e.text());
    for (const std::string& w : warnings) fmt::print("warning: {}\n", w);
  }
  return interrupted ? 1 : 0;
}

}  // namespace

CalibrateSubcommand add_calibrate_latency(CLI::App& calibrate) {
  CommandOptions app(calibrate, "latency",
                     "latency_ms of channels, from how long their samples took from capture to arrival");
  auto o = std::make_shared<LatencyCommandOptions>();
  app.add_option("INPUT", o->inputs, "Recordings (.mcap) of runs in wall-clock time").required();
  app.add_option("--channel", o->channels, "Channel, several times for several; without it all of them");
  app.add_option("--quantile", o->fit.quantile, "Share of the samples that are to be in time; 0.999")
      .positive();
  app.add_option("--confidence", o->fit.confidence, "With which that share is reached; 0.95").positive();
  app.add_option(
      "--trigger", o->trigger,
      "For devices without a clock: CHANNEL whose every sample triggers one, or SINK:VALUE that does "
      "so when it leaves 0");
  app.add_option("--trigger-to-capture", o->trigger_to_capture_ms,
                 "From the trigger to the capture, ms: half of an exposure")
      .not_negative();
  app.add_flag("--json", o->json, "Print the result as JSON");
  app.footer("Example: rigor calibrate latency run.mcap --channel left --quantile 0.999");
  return {app, [o] { return calibrate_latency(*o); }};
}

}  // namespace rigor

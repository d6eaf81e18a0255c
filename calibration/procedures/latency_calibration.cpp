#include "calibration/procedures/latency_calibration.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "calibration/procedures/input_files.h"
#include "calibration/procedures/latency_samples.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using namespace calibration;

double ms(std::int64_t ns) { return static_cast<double>(ns) / 1e6; }

std::int64_t median(std::vector<std::int64_t> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

void add_warnings(const LatencyCalibrationOptions& o, ChannelLatency& c) {
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
  if (s.minimum_interval_ns > 0 && f.max_ns * 2 > s.minimum_interval_ns)
    warn(fmt::format(
        "two triggers are {:.3f} ms apart, and latencies above that cannot be told: trigger more slowly",
        ms(s.minimum_interval_ns)));
}

Result<ChannelLatency> measure(const LatencyCalibrationOptions& o, const std::string& name,
                               LatencySamples from) {
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
  c.after_trigger_ns = median(c.from.after_trigger_ns);
  add_warnings(o, c);
  return c;
}

/// The channels that are asked for, or all of them.
Result<std::vector<std::string>> wanted(const LatencyCalibrationOptions& o,
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

LatencySamples samples_of(const LatencyCalibrationOptions& o, const std::string& channel,
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

}  // namespace

std::string ChannelLatency::rig_override() const { return fmt::format("{}={:.1f}", key(), ms(put_ns)); }

std::vector<const ChannelLatency*> LatencyCalibration::for_rig() const {
  std::vector<const ChannelLatency*> put;
  for (const ChannelLatency& c : channels)
    if (!c.simulated_side() || std::ranges::none_of(channels, [&](const ChannelLatency& other) {
          return other.rig_channel == c.rig_channel && !other.simulated_side();
        }))
      put.push_back(&c);
  return put;
}

Result<LatencyCalibration> calibrate_latency(const LatencyCalibrationOptions& o, const StopToken& stop) {
  for (const auto& [option, value] :
       {std::pair("--quantile", o.fit.quantile), std::pair("--confidence", o.fit.confidence)})
    if (!(value < 1))
      return fail(ErrorCode::bad_input, option,
                  fmt::format("expected a share below 1 such as 0.999, got {:g}", value));
  if (!o.trigger.empty() && o.channels.empty())
    return fail(ErrorCode::bad_input, "--channel", "expected the channel that --trigger triggers");
  const auto files = input_files(o.inputs, {".mcap"});
  if (!files) return tl::unexpected<Error>(files.error());
  std::vector<StampedRecording> recordings;
  std::vector<std::vector<std::int64_t>> triggers;
  std::vector<std::string> warnings;
  for (const auto& file : *files) {
    auto recording = read_stamps(file, stop);
    if (!recording) return tl::unexpected<Error>(recording.error());
    warnings.insert(warnings.end(), recording->warnings.begin(), recording->warnings.end());
    if (!o.trigger.empty()) {
      auto instants = trigger_instants(*recording, o.trigger, stop);
      if (!instants) return tl::unexpected<Error>(instants.error());
      triggers.push_back(std::move(*instants));
    }
    recordings.push_back(std::move(*recording));
  }
  const auto names = wanted(o, recordings);
  if (!names) return tl::unexpected<Error>(names.error());

  std::vector<ChannelLatency> channels;
  std::vector<Error> unknown;
  for (const std::string& name : *names) {
    auto channel = measure(o, name, samples_of(o, name, recordings, triggers));
    if (!channel && !o.channels.empty()) return tl::unexpected<Error>(channel.error());
    if (channel) {
      warnings.insert(warnings.end(), channel->warnings.begin(), channel->warnings.end());
      channels.push_back(std::move(*channel));
    } else {
      unknown.push_back(channel.error());
    }
  }
  if (channels.empty())
    return tl::unexpected<Error>(unknown.empty()
                                     ? Error{ErrorCode::bad_input, files->front().string(),
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

  return LatencyCalibration{.inputs = *files,
                            .rig_file = recordings.front().rig_file,
                            .channels = std::move(channels),
                            .unknown = std::move(unknown),
                            .warnings = std::move(warnings),
                            .interrupted = stop.stop_requested()};
}

}  // namespace rigor

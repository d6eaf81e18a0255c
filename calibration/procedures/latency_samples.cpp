#include "calibration/procedures/latency_samples.h"

#include <fmt/format.h>

#include <algorithm>

#include "calibration/latency/trigger_match.h"
#include "rt-core/stamp.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using calibration::LatencyPart;
using calibration::TriggerMatch;

double span_s(const std::vector<RecordedStamp>& stamps) {
  return stamps.empty() ? 0
                        : static_cast<double>(stamps.back().capture_ns - stamps.front().capture_ns) * 1e-9;
}

void count(const RecordedStamp& s, std::int64_t capture_ns, LatencyPart& part, LatencySamples& to) {
  part.latency_ns.push_back(s.arrival_ns - capture_ns);
  to.present_ns.push_back(s.release_ns - s.capture_ns);
  to.late += s.arrival_ns > s.release_ns;
  to.negative += s.arrival_ns < capture_ns;
  to.at_release += s.arrival_ns == s.release_ns;
}

}  // namespace

std::size_t LatencySamples::count() const {
  std::size_t n = 0;
  for (const LatencyPart& p : parts) n += p.latency_ns.size();
  return n;
}

Result<std::vector<std::int64_t>> trigger_instants(const StampedRecording& recording, const std::string& name,
                                                   const StopToken& stop) {
  std::vector<std::int64_t> t;
  if (const auto colon = name.find(':'); colon != std::string::npos) {
    const auto commands = read_commands(recording.file, name.substr(0, colon), name.substr(colon + 1), stop);
    if (!commands) return tl::unexpected<Error>(commands.error());
    double before = 0;
    for (const RecordedCommand& c : *commands) {
      if (before == 0 && c.value != 0) t.push_back(c.effect_ns);
      before = c.value;
    }
    return t;
  }
  const RecordedStamps* channel = recording.find(name);
  if (channel == nullptr) {
    const auto names = recording.names();
    return fail(ErrorCode::bad_input, recording.file.string(),
                "expected a channel " + name +
                    " or SINK:VALUE as trigger, found none of that name; channels: " + joined_or_none(names) +
                    did_you_mean(name, names));
  }
  for (const RecordedStamp& s : channel->stamps)
    if ((s.validity & kClockUnsure) == 0) t.push_back(s.capture_ns);
  if (t.empty())
    return fail(ErrorCode::bad_input, name,
                "cannot be the trigger: none of its samples knows when it was captured (kClockUnsure)");
  return t;
}

void add_stamped(const RecordedStamps& channel, const std::string& recording, LatencySamples& to) {
  // What was captured in the recording's last moments is in it only where it was quick: that does not count.
  std::int64_t end = 0, longest = 0;
  for (const RecordedStamp& s : channel.stamps) {
    end = std::max({end, s.arrival_ns, s.release_ns});
    longest = std::max({longest, s.arrival_ns - s.capture_ns, s.release_ns - s.capture_ns});
  }
  LatencyPart part{.name = recording, .latency_ns = {}};
  for (const RecordedStamp& s : channel.stamps) {
    if ((s.validity & kClockUnsure) != 0) {
      ++to.unsure;
    } else if ((s.validity & kSubstituted) != 0) {
      ++to.substituted;
    } else if (s.capture_ns > end - longest) {
      ++to.near_end;
    } else {
      count(s, s.capture_ns, part, to);
      to.sigma_ns.push_back(s.sigma_ns);
    }
  }
  to.span_s += span_s(channel.stamps);
  to.parts.push_back(std::move(part));
}

void add_triggered(const RecordedStamps& channel, const std::string& recording,
                   const std::vector<std::int64_t>& triggers_ns, std::int64_t to_capture_ns,
                   LatencySamples& to) {
  std::vector<RecordedStamp> samples;
  for (const RecordedStamp& s : channel.stamps)
    if ((s.validity & kSubstituted) == 0) samples.push_back(s);
  to.substituted += channel.stamps.size() - samples.size();
  std::stable_sort(samples.begin(), samples.end(),
                   [](const auto& a, const auto& b) { return a.arrival_ns < b.arrival_ns; });
  std::vector<std::int64_t> arrivals;
  for (const RecordedStamp& s : samples) arrivals.push_back(s.arrival_ns);
  const TriggerMatch match = calibration::match_triggers(triggers_ns, arrivals);
  LatencyPart part{.name = recording, .latency_ns = {}};
  for (const TriggerMatch::Pair& p : match.pairs) {
    const RecordedStamp& s = samples[p.sample];
    const std::int64_t capture = triggers_ns[p.trigger] + to_capture_ns;
    count(s, capture, part, to);
    to.after_trigger_ns.push_back(s.capture_ns - capture);
    to.unsure += (s.validity & kClockUnsure) != 0;
  }
  to.untriggered += match.without_trigger;
  to.without_sample += match.without_sample;
  if (match.minimum_interval_ns > 0)
    to.minimum_interval_ns = to.minimum_interval_ns == 0
                                 ? match.minimum_interval_ns
                                 : std::min(to.minimum_interval_ns, match.minimum_interval_ns);
  to.span_s += span_s(channel.stamps);
  to.parts.push_back(std::move(part));
}

std::string why_unknown(const LatencySamples& samples, const std::string& channel,
                        const std::string& recording, const std::string& trigger) {
  const std::size_t n = samples.count();
  const auto hint = [&] {
    return fmt::format(
        "measure it against its trigger (--trigger), or against what another channel sees: `rigor calibrate "
        "delay {} --first CHANNEL --second {}`",
        recording, channel);
  };
  if (!trigger.empty()) {
    if (n == 0) return fmt::format("none of its samples comes after a trigger of {}", trigger);
    if (samples.untriggered * 10 > n)
      return fmt::format(
          "expected a sample for each trigger, got {} samples more than the {} that followed one of {}: "
          "something else triggers it, too",
          samples.untriggered, n, trigger);
    return {};
  }
  if (n == 0 && samples.unsure > 0)
    return fmt::format(
        "its stamps do not know the capture: the device's clock is not known in any of {} samples "
        "(kClockUnsure), and drivers then take the arrival less latency_ms; {}",
        samples.unsure, hint());
  if (n > 0 && samples.at_release == n)
    return fmt::format(
        "its stamps do not know the capture: each of {} samples arrives at capture + latency_ms, to the "
        "nanosecond; {}",
        n, hint());
  if (samples.negative * 2 > n)
    return fmt::format(
        "{} of {} samples arrive before their capture: expected a device whose clock, exposure and delay are "
        "right in the rig",
        samples.negative, n);
  return {};
}

}  // namespace rigor

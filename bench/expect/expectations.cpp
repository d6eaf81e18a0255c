#include "bench/expect/expectations.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "bench/expect/samples_due.h"
#include "rt-core/numbers.h"
#include "sensor-hal/channel/typed_values.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using nlohmann::json;

enum class Quantity : std::uint8_t {
  rate_hz,
  missing,
  late,
  age_ms,
  age_p99_ms,  // of a channel
  value,
  per_s,  // of a value
  failed,
  late_commands,
  dropped,  // of a sink
  wake_p50_us,
  wake_p99_us,
  wake_max_us,
  cycle_p99_us,
  skipped,
  misses,  // of the loop
  late_answers,
  skipped_turns,
  restarts,
  answer_p99_ms,  // of the application
  position_m,
  yaw_deg,  // of an estimate
  alarm     // of a pair
};
enum class Subject : std::uint8_t { channel, value, sink, loop, application, estimate };

struct Named {
  const char* key;
  Quantity quantity;
};
constexpr std::array kOfChannel{Named{"rate_hz", Quantity::rate_hz}, Named{"missing", Quantity::missing},
                                Named{"late", Quantity::late}, Named{"age_ms", Quantity::age_ms},
                                Named{"age_p99_ms", Quantity::age_p99_ms}};
constexpr std::array kOfValue{Named{"value", Quantity::value}, Named{"per_s", Quantity::per_s}};
constexpr std::array kOfSink{Named{"failed", Quantity::failed}, Named{"late", Quantity::late_commands},
                             Named{"dropped", Quantity::dropped}};
constexpr std::array kOfLoop{
    Named{"wake_p50_us", Quantity::wake_p50_us}, Named{"wake_p99_us", Quantity::wake_p99_us},
    Named{"wake_max_us", Quantity::wake_max_us}, Named{"cycle_p99_us", Quantity::cycle_p99_us},
    Named{"skipped", Quantity::skipped},         Named{"misses", Quantity::misses}};
constexpr std::array kOfApplication{
    Named{"late", Quantity::late_answers}, Named{"skipped", Quantity::skipped_turns},
    Named{"restarts", Quantity::restarts}, Named{"answer_p99_ms", Quantity::answer_p99_ms}};
constexpr std::array kOfEstimate{Named{"position_m", Quantity::position_m},
                                 Named{"yaw_deg", Quantity::yaw_deg}};

std::span<const Named> quantities_of(Subject s) {
  switch (s) {
    case Subject::channel:
      return kOfChannel;
    case Subject::value:
      return kOfValue;
    case Subject::sink:
      return kOfSink;
    case Subject::loop:
      return kOfLoop;
    case Subject::application:
      return kOfApplication;
    case Subject::estimate:
      return kOfEstimate;
  }
  return {};
}

struct Bounds {
  std::optional<double> min, max;
  [[nodiscard]] bool hold(double v) const { return !(min && !(v >= *min)) && !(max && !(v <= *max)); }
  [[nodiscard]] std::string text() const {
    if (min && max) return fmt::format("from {} to {}", *min, *max);
    return min ? fmt::format("of at least {}", *min) : fmt::format("of at most {}", *max);
  }
};

/// A pose in the plane at an instant.
struct PlaneAt {
  BenchTime t;
  double x_m = 0, y_m = 0, yaw_rad = 0;
};

PlaneAt plane_of(const Sample& s, const Pose& p) {
  const auto& [w, x, y, z] = p.orientation_wxyz;
  return {s.stamp.t_capture, p.position_m[0], p.position_m[1],
          std::atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))};
}

}  // namespace

struct Expectations::Check {
  Expected result;
  ConfigNode node;
  Subject subject{};
  Quantity quantity{};
  Bounds bounds;
  bool wanted_alarm = false;
  Duration from, until;  ///< until 0: the end
  std::string name, value_name, against;

  // Bound.
  const SamplePort* port = nullptr;
  const CommandPort* commands = nullptr;
  SampleKind kind = SampleKind::none;
  std::size_t index = 0;
  Period period;
  Duration latency;
  std::optional<std::size_t> x, y, yaw;  ///< places in the estimate's command

  // Of the loop.
  bool begun = false;
  BenchTime t_first, t_last;
  PortCounters first, last;
  double previous = kNaN;
  BenchTime t_previous;
  Histogram ages;
  std::array<PlaneAt, 64> estimates{};  ///< that no truth lies behind yet, oldest first
  std::size_t estimate_count = 0;
  std::optional<PlaneAt> truth;

  [[nodiscard]] bool in_window(Duration since_start) const {
    return since_start >= from && (until.ns() == 0 || since_start <= until);
  }
  void look(double v, Duration since_start) noexcept {
    if (result.looked_at++ == 0) result.least = result.most = v;
    result.least = std::min(result.least, v);
    result.most = std::max(result.most, v);
    if (bounds.hold(v)) return;
    if (result.outside++ == 0) result.first_s = since_start.seconds();
  }
  /// Of a whole run or window: no instant.
  void judge(double v) noexcept {
    result.looked_at = 1;
    result.least = result.most = v;
    result.outside = !bounds.hold(v);
  }
  void take(double v, BenchTime t, Duration since_start) noexcept {
    if (quantity == Quantity::value) look(v, since_start);
    if (quantity == Quantity::per_s && std::isfinite(previous) && t > t_previous)
      look((v - previous) / (t - t_previous).seconds(), since_start);
    previous = v;
    t_previous = t;
  }
  void take_sample(Duration since_start) noexcept;
  void take_truth(BenchTime t0) noexcept;
  void add_estimate(const Command& c) noexcept;
  void end(const RunEnd& run, BenchTime t0);
};

Expectations::~Expectations() = default;

namespace {

/// `left.value` of a channel or a sink.
std::pair<std::string, std::string> split(const std::string& of) {
  const auto dot = of.find('.');
  return {of.substr(0, dot), dot == std::string::npos ? "" : of.substr(dot + 1)};
}

Bounds read_bounds(const ConfigNode& entry, const char* key) {
  const ConfigNode n = entry.map(key);
  Bounds b;
  if (n.has("min")) b.min = n.number("min");
  if (n.has("max")) b.max = n.number("max");
  n.finish();
  if (!b.min && !b.max) throw entry.error(key, "expected { min: … }, { max: … } or both, got neither");
  if (b.min && b.max && *b.min > *b.max)
    throw entry.error(key, fmt::format("expected min up to max, got {} and {}", *b.min, *b.max));
  return b;
}

struct Found {
  Subject subject{};
  const ChannelEntry* channel = nullptr;
  const SinkEntry* sink = nullptr;
};

Found find_subject(const RigConfig& rig, const ConfigNode& n, const std::string& name,
                   const std::string& value) {
  if (value.empty() && name == "loop") return {Subject::loop};
  if (value.empty() && name == "application") {
    if (rig.application.empty()) throw n.error("of", "expected an application in the rig, found none");
    return {Subject::application};
  }
  Found found;
  for (const ChannelEntry& c : rig.channels)
    if (c.name == name) found.channel = &c;
  for (const SinkEntry& s : rig.sinks)
    if (s.name == name) found.sink = &s;
  if (!found.channel && !found.sink) {
    std::vector<std::string> names{"loop", "application"};
    for (const ChannelEntry& c : rig.channels) names.push_back(c.name);
    for (const SinkEntry& s : rig.sinks) names.push_back(s.name);
    throw n.error(
        "of",
        fmt::format("expected one of {}, or a value of a channel or sink as in NAME.VALUE, got \"{}\"{}",
                    fmt::join(names, ", "), name, did_you_mean(name, names)));
  }
  found.subject = !value.empty()     ? Subject::value
                  : n.has("against") ? Subject::estimate
                  : found.channel    ? Subject::channel
                                     : Subject::sink;
  if (found.subject == Subject::estimate && !found.sink)
    throw n.error("of", "expected a sink that is told an estimate, got a channel");
  return found;
}

}  // namespace

Result<std::unique_ptr<Expectations>> Expectations::read(const RigConfig& rig) {
  return catch_config([&] {
    std::unique_ptr<Expectations> out(new Expectations);
    for (const ConfigNode& n : rig.expect) {
      const std::string of = n.text("of");
      const auto [name, value] = split(of);
      const Found found = find_subject(rig, n, name, value);
      Check base;
      base.node = n;
      base.result.of = of;
      base.name = name;
      base.value_name = value;
      base.subject = found.subject;
      if (found.channel) base.period = found.channel->period, base.latency = found.channel->latency;
      const bool windowed = base.subject == Subject::channel || base.subject == Subject::value ||
                            base.subject == Subject::estimate;
      if (windowed) {
        base.from = seconds_from(n.number_or("from_s", 0, {.min = 0, .max = 1e9}));
        base.until = seconds_from(n.number_or("until_s", 0, {.min = 0, .max = 1e9}));
        if (base.until.ns() > 0 && base.until <= base.from)
          throw n.error("until_s", "expected an instant after from_s");
      }
      if (base.subject == Subject::estimate) base.against = n.text("against");
      const std::size_t before = out->checks_.size();
      for (const Named& q : quantities_of(base.subject)) {
        if (!n.has(q.key)) continue;
        auto check = std::make_unique<Check>(base);
        check->quantity = q.quantity;
        check->bounds = read_bounds(n, q.key);
        check->result.quantity = q.key;
        check->result.bounds = check->bounds.text();
        const bool needs_rate = q.quantity == Quantity::missing;
        if (needs_rate && base.period.ns() <= 0)
          throw n.error(q.key, "expected a channel with a rate, got one that has none: nothing of it is due");
        out->checks_.push_back(std::move(check));
      }
      if (base.subject == Subject::channel && n.has("alarm")) {
        if (!found.channel->is_pair) throw n.error("alarm", "expected a pair, got a channel that is none");
        auto check = std::make_unique<Check>(base);
        check->quantity = Quantity::alarm;
        check->wanted_alarm = n.flag("alarm");
        check->result.quantity = "alarm";
        check->result.bounds = check->wanted_alarm ? "to come" : "not to come";
        out->checks_.push_back(std::move(check));
      }
      n.finish();
      if (out->checks_.size() == before) {
        std::vector<std::string> names;
        for (const Named& q : quantities_of(base.subject)) names.emplace_back(q.key);
        if (base.subject == Subject::channel && found.channel->is_pair) names.emplace_back("alarm");
        throw n.error("of",
                      fmt::format("expected one or more of {} beside it, got none", fmt::join(names, ", ")));
      }
    }
    if (out->checks_.empty()) out.reset();
    return out;
  });
}

Status Expectations::bind(const ApplicationPorts& ports) {
  const auto bound = catch_config([&] {
    for (const auto& check : checks_) {
      Check& c = *check;
      const auto input = ports.inputs.find(c.subject == Subject::estimate ? c.against : c.name);
      const auto output = ports.outputs.find(c.name);
      const auto place = [&](const std::vector<std::string>& names, const std::string& value) {
        const auto it = std::ranges::find(names, value);
        if (it == names.end())
          throw c.node.error(
              "of", fmt::format("expected a value of {} ({}), got \"{}\"{}", c.name,
                                names.empty() ? "it has none" : fmt::format("{}", fmt::join(names, ", ")),
                                value, did_you_mean(value, names)));
        return static_cast<std::size_t>(it - names.begin());
      };
      if (c.subject == Subject::channel || c.subject == Subject::value || c.subject == Subject::estimate) {
        if (input != ports.inputs.end()) {
          c.port = input->second.port;
          c.kind = input->second.description->kind;
        }
      }
      if (c.subject == Subject::value && c.port) {
        std::vector<std::string> names = input->second.description->names;
        if (c.kind != SampleKind::register_block) {
          names.clear();
          for (const ValueName& v : values_of_kind(c.kind)) names.emplace_back(v.name);
        }
        c.index = place(names, c.value_name);
      } else if (c.subject == Subject::value) {
        c.commands = output->second;
        c.index = place(output->second->describe().names, c.value_name);
      } else if (c.subject == Subject::estimate) {
        if (!c.port || c.kind != SampleKind::pose)
          throw c.node.error("against",
                             fmt::format("expected a channel of kind pose, got \"{}\"", c.against));
        c.commands = output->second;
        const auto& names = output->second->describe().names;
        c.x = place(names, "x"), c.y = place(names, "y");
        if (c.quantity == Quantity::yaw_deg) c.yaw = place(names, "yaw");
      }
    }
    return 0;
  });
  return bound ? Status{} : Status(tl::unexpected<Error>(bound.error()));
}

void Expectations::begin(BenchTime t0) noexcept { t0_ = t0; }

void Expectations::Check::take_sample(Duration since_start) noexcept {
  const SampleLease& sample = port->sample();
  if (port->status() != PortStatus::fresh || !sample) return;
  if (subject == Subject::value) {
    double v = kNaN;
    if (const auto* block = sample->as<RegisterBlock>()) {
      if (index < block->count) v = block->value[index];
    } else {
      std::array<double, 32> values{};
      const std::size_t n = std::min(values.size(), values_of_kind(kind).size());
      values_of_sample(*sample, std::span(values).first(n));
      if (index < n) v = values[index];
    }
    take(v, sample->stamp.t_capture, since_start);
  }
}

void Expectations::Check::add_estimate(const Command& c) noexcept {
  if (estimate_count == estimates.size()) {  // the truth is silent: the oldest is given up
    std::move(estimates.begin() + 1, estimates.end(), estimates.begin());
    --estimate_count;
  }
  estimates[estimate_count++] = {c.t_issue, c.value[*x], c.value[*y], yaw ? c.value[*yaw] : 0};
}

/// Estimates that lie between two true poses are compared with what lies between these.
void Expectations::Check::take_truth(BenchTime t0) noexcept {
  const SampleLease& sample = port->sample();
  const Pose* pose = port->status() == PortStatus::fresh && sample ? sample->as<Pose>() : nullptr;
  if (!pose) return;
  const PlaneAt now = plane_of(*sample, *pose);
  const PlaneAt before = truth.value_or(now);
  truth = now;
  std::size_t done = 0;
  for (; done < estimate_count && estimates[done].t <= now.t; ++done) {
    const PlaneAt& e = estimates[done];
    if (e.t < before.t || !in_window(e.t - t0)) continue;
    const double span = (now.t - before.t).seconds(),
                 share = span > 0 ? (e.t - before.t).seconds() / span : 1;
    const double dx = e.x_m - std::lerp(before.x_m, now.x_m, share),
                 dy = e.y_m - std::lerp(before.y_m, now.y_m, share);
    const double true_yaw =
        before.yaw_rad + share * std::remainder(now.yaw_rad - before.yaw_rad, 2 * std::numbers::pi);
    const double error =
        quantity == Quantity::position_m
            ? std::hypot(dx, dy)
            : std::abs(std::remainder(e.yaw_rad - true_yaw, 2 * std::numbers::pi)) * 180 / std::numbers::pi;
    look(error, e.t - t0);
  }
  std::move(estimates.begin() + static_cast<std::ptrdiff_t>(done),
            estimates.begin() + static_cast<std::ptrdiff_t>(estimate_count), estimates.begin());
  estimate_count -= done;
}

void Expectations::command(const CommandPort& port, const Command& command) noexcept {
  const Duration since_start = command.t_issue - t0_;
  for (const auto& check : checks_) {
    if (check->commands != &port) continue;
    if (check->subject == Subject::estimate)
      check->add_estimate(command);
    else if (check->in_window(since_start) && check->index < command.count)
      check->take(command.value[check->index], command.t_issue, since_start);
  }
}

void Expectations::cycle(BenchTime t) noexcept {
  const Duration since_start = t - t0_;
  for (const auto& check : checks_) {
    Check& c = *check;
    if (!c.port) continue;
    if (c.subject == Subject::estimate) {
      c.take_truth(t0_);
      continue;
    }
    if (!c.in_window(since_start)) continue;
    if (!c.begun && c.from.ns() > 0) c.first = c.port->counters(), c.t_first = t;
    if (!c.begun && c.from.ns() == 0) c.t_first = t0_;
    c.begun = true;
    c.last = c.port->counters();
    c.t_last = t;
    c.take_sample(since_start);
    if (c.quantity != Quantity::age_ms && c.quantity != Quantity::age_p99_ms) continue;
    if (c.port->status() != PortStatus::fresh || !c.port->sample()) continue;
    const Duration age = t - c.port->sample()->stamp.t_capture;
    if (c.quantity == Quantity::age_ms)
      c.look(age.seconds() * 1e3, since_start);
    else
      c.ages.record(age);
  }
}

void Expectations::Check::end(const RunEnd& run, BenchTime t0) {
  const auto us = [](Duration d) { return d.seconds() * 1e6; };
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  const std::uint64_t delivered = last.fresh + last.superseded - first.fresh - first.superseded;
  const auto due = [&]() -> std::uint64_t {
    const auto by = [&](BenchTime t) { return samples_due(t - t0, period, latency).value_or(0); };
    return by(t_last) - (from.ns() > 0 ? by(t_first) : 0);
  };
  const auto sink = std::ranges::find(run.sinks, name, &RunEnd::Sink::name);
  const bool has_sink = sink != run.sinks.end();
  switch (quantity) {
    case Quantity::rate_hz: {
      if (!begun) break;
      const double span_s = period.ns() > 0 ? count(due()) * period.seconds() : (t_last - t_first).seconds();
      if (span_s > 0) judge(count(delivered) / span_s);
      break;
    }
    case Quantity::missing: {
      if (!begun) break;
      const std::uint64_t n = due(), behind = n > delivered ? n - delivered : 0;
      const std::uint64_t gaps = last.lost_samples - first.lost_samples;
      judge(count(std::max(gaps, behind > samples_at_edges(n) ? behind : 0)));
      break;
    }
    case Quantity::late:
      if (begun) judge(count(last.late_samples - first.late_samples));
      break;
    case Quantity::age_p99_ms:
      if (ages.count() > 0) judge(ages.percentile(0.99).seconds() * 1e3);
      break;
    case Quantity::failed:
      if (has_sink) judge(count(sink->failed));
      break;
    case Quantity::late_commands:
      if (has_sink) judge(count(sink->late));
      break;
    case Quantity::dropped:
      if (has_sink) judge(count(sink->dropped));
      break;
    case Quantity::wake_p50_us:
      judge(us(run.loop->wake_error.percentile(0.5)));
      break;
    case Quantity::wake_p99_us:
      judge(us(run.loop->wake_error.percentile(0.99)));
      break;
    case Quantity::wake_max_us:
      judge(us(run.loop->wake_error.max()));
      break;
    case Quantity::cycle_p99_us:
      judge(us(run.loop->cycle_time.percentile(0.99)));
      break;
    case Quantity::skipped:
      judge(count(run.loop->cycles_skipped));
      break;
    case Quantity::misses:
      judge(count(run.loop->misses.total));
      break;
    case Quantity::late_answers:
      if (run.application) judge(count(run.application->late));
      break;
    case Quantity::skipped_turns:
      if (run.application) judge(count(run.application->skipped));
      break;
    case Quantity::restarts:
      if (run.application) judge(count(run.application->restarts));
      break;
    case Quantity::answer_p99_ms:
      if (run.application && run.application->answer.count() > 0)
        judge(run.application->answer.percentile(0.99).seconds() * 1e3);
      break;
    case Quantity::alarm: {
      const auto came = std::ranges::find_if(run.alarms, [&](const RunEnd::Alarm& a) {
        return a.pair == name && in_window(seconds_from(a.t_s));
      });
      const bool is = came != run.alarms.end();
      result.looked_at = 1;
      result.least = result.most = is;
      result.outside = is != wanted_alarm;
      if (is && !wanted_alarm) result.first_s = came->t_s;
      break;
    }
    case Quantity::age_ms:
    case Quantity::value:
    case Quantity::per_s:
    case Quantity::position_m:
    case Quantity::yaw_deg:
      break;
  }
  result.holds = result.looked_at > 0 && result.outside == 0;
}

std::vector<Expected> Expectations::finish(const RunEnd& end) {
  std::vector<Expected> out;
  for (const auto& check : checks_) {
    check->end(end, t0_);
    out.push_back(check->result);
  }
  return out;
}

std::string Expected::outcome() const {
  if (looked_at == 0) return "nothing came that could be judged";
  if (quantity == "alarm")
    return least > 0 ? fmt::format("it came{}", first_s ? fmt::format(" at {:.3f} s", *first_s) : "")
                     : "it did not";
  std::string s =
      least == most ? fmt::format("got {:.6g}", least) : fmt::format("got {:.6g} to {:.6g}", least, most);
  if (looked_at > 1 && outside > 0) s += fmt::format("; {} of {}", outside, looked_at);
  if (first_s) s += fmt::format(", first at {:.3f} s", *first_s);
  return s;
}

std::string Expected::sentence() const {
  return quantity == "alarm" ? fmt::format("{}: expected an alarm {}, {}", of, bounds, outcome())
                             : fmt::format("{}: expected {} {}, {}", of, quantity, bounds, outcome());
}

json to_json(const std::vector<Expected>& all) {
  json out = json::array();
  for (const Expected& e : all) {
    json j{{"of", e.of},
           {"quantity", e.quantity},
           {"bounds", e.bounds},
           {"holds", e.holds},
           {"looked_at", e.looked_at},
           {"outside", e.outside},
           {"outcome", e.outcome()},
           {"text", e.sentence()}};
    j["first_s"] = e.first_s ? json(*e.first_s) : json();
    if (e.looked_at > 0) j["least"] = e.least, j["most"] = e.most;
    out.push_back(std::move(j));
  }
  return out;
}

std::string junit_text(const std::vector<Expected>& all, const std::string& rig,
                       const std::string& failure_of_run, double duration_s) {
  const auto escaped = [](const std::string& text) {
    std::string out;
    for (const char c : text) {
      if (c == '&')
        out += "&amp;";
      else if (c == '<')
        out += "&lt;";
      else if (c == '>')
        out += "&gt;";
      else if (c == '"')
        out += "&quot;";
      else
        out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
    return out;
  };
  const auto failures =
      std::ranges::count_if(all, [](const Expected& e) { return !e.holds; }) + !failure_of_run.empty();
  std::string out = fmt::format(
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"{}\" tests=\"{}\" failures=\"{}\" "
      "errors=\"0\" "
      "skipped=\"0\" time=\"{:.3f}\">\n",
      escaped(rig), all.size() + 1, failures, duration_s);
  const auto add = [&](const std::string& name, const std::string& failure, double time_s) {
    out += fmt::format("  <testcase classname=\"{}\" name=\"{}\" time=\"{:.3f}\"", escaped(rig),
                       escaped(name), time_s);
    out += failure.empty()
               ? "/>\n"
               : fmt::format(">\n    <failure message=\"{}\"/>\n  </testcase>\n", escaped(failure));
  };
  add("run", failure_of_run, duration_s);
  for (const Expected& e : all)
    add(fmt::format("{} {} {}", e.of, e.quantity, e.bounds), e.holds ? "" : e.sentence(), 0);
  return out + "</testsuite>\n";
}

}  // namespace rigor

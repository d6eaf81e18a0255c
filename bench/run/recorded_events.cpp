#include "bench/run/recorded_events.h"

#include <fmt/format.h>

#include <map>

#include "bench/run/recording.h"
#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {
namespace {

bool is_fault(std::uint32_t code) {
  return code == kEventFaultBegin || code == kEventFaultEnd || code == kEventLiveFaultBegin ||
         code == kEventLiveFaultEnd;
}

Result<RecordedFault> to_fault(const record::msg::Fault& m, const std::filesystem::path& file) {
  const auto kind = fault_kind_named(m.kind);
  if (!kind)
    return fail(ErrorCode::protocol, file.string(),
                "/rigor/faults: expected a kind of fault that this version knows, got \"" + m.kind + "\"");
  RecordedFault f;
  f.of = m.channel;
  f.index = m.index;
  f.kind = *kind;
  f.live = m.live;
  f.begins = m.begins;
  f.json = m.fault;
  return f;
}

/// `topic` of `view`, with the file's name where the message cannot be read.
template <typename Message>
Result<Message> message_of(const record::MessageView& view, const std::filesystem::path& file) {
  Message m;
  if (const auto s = record::CdrReader::read(view.data, m); !s)
    return fail(ErrorCode::protocol, file.string(), view.channel->topic + ": " + s.error().text());
  return m;
}

}  // namespace

Result<RecordedEvents> read_recorded_events(const std::filesystem::path& file, const RecordedRun& run) {
  auto reader = record::McapReader::open(file.string());
  if (!reader) return tl::unexpected<Error>(reader.error());
  RecordedEvents events;
  auto cursor = (*reader)->messages(
      {.topics = {"/rigor/events", "/rigor/faults"}, .order = record::MessageOrder::file});
  record::MessageView view;
  bool fault_events = false;
  const auto to_bench = [&](const record::msg::Time& t) {
    return run.epoch.to_bench(RealtimeTime(std::int64_t{t.sec} * 1'000'000'000 + t.nanosec));
  };
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    if (view.channel->topic == "/rigor/faults") {
      const auto m = message_of<record::msg::Fault>(view, file);
      if (!m) return tl::unexpected<Error>(m.error());
      auto fault = to_fault(*m, file);
      if (!fault) return tl::unexpected<Error>(fault.error());
      fault->t = to_bench(m->header.stamp);
      events.faults.push_back(std::move(*fault));
      continue;
    }
    const auto m = message_of<record::msg::Event>(view, file);
    if (!m) return tl::unexpected<Error>(m.error());
    const BenchTime t = to_bench(m->header.stamp);
    if (m->code == kEventPairAlarm)
      events.alarms.push_back({t, m->channel});
    else if (m->code == kEventMadeSafe && m->value >= 0 && m->value < 1e6)
      events.made_safe.push_back({t, static_cast<std::size_t>(m->value)});
    fault_events |= is_fault(m->code);
  }
  events.faults_as_text = fault_events && events.faults.empty();
  return events;
}

Result<std::vector<RecordedLiveFault>> recorded_live_faults(const std::filesystem::path& file,
                                                            const RecordedRun& run,
                                                            const RecordedEvents& events) {
  if (auto s = faults_are_known(file, events); !s) return tl::unexpected<Error>(s.error());
  std::map<std::pair<std::string, std::uint32_t>, RecordedLiveFault> found;
  for (const RecordedFault& f : events.faults) {
    if (!f.live) continue;
    const Duration t = f.t - run.t0;
    const auto [at, is_new] = found.try_emplace({f.of, f.index}, RecordedLiveFault{f.of, f.index, f.json, t});
    if (f.begins != is_new)
      return fail(
          ErrorCode::bad_input, file.string(),
          fmt::format("/rigor/faults: expected live fault {} of {} to begin once before it ends, got {} at "
                      "{} s: the recording is not whole",
                      f.index, f.of, f.begins ? "a second begin" : "an end without a begin", t.seconds()));
    if (!f.begins) at->second.until = t;
  }
  std::vector<RecordedLiveFault> faults;
  for (auto& [key, fault] : found) faults.push_back(std::move(fault));
  return faults;
}

Status faults_are_known(const std::filesystem::path& file, const RecordedEvents& events) {
  if (!events.faults_as_text) return {};
  return fail(
      ErrorCode::bad_input, file.string(),
      "expected a recording that has its faults under /rigor/faults, got one of an earlier version, which "
      "wrote them as text alone: record the run again with this version");
}

}  // namespace rigor

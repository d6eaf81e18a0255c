#include "bench/run/recorded_events.h"

#include <optional>

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

/// "live fault 2 of left.real begins in cycle 40: {kind: drop}"
std::optional<RecordedFault> parse_fault(const record::msg::Event& m) {
  const std::size_t of = m.text.find(" of "), end = m.text.find(' ', of + 4), brace = m.text.find(": {");
  if (of == std::string::npos || end == std::string::npos || brace == std::string::npos) return {};
  if (!(m.value >= 0 && m.value < 1e6)) return {};
  RecordedFault f;
  f.of = m.text.substr(of + 4, end - of - 4);
  f.yaml = m.text.substr(brace + 2);
  f.index = static_cast<std::uint32_t>(m.value);
  f.live = m.code == kEventLiveFaultBegin || m.code == kEventLiveFaultEnd;
  f.begins = m.code == kEventFaultBegin || m.code == kEventLiveFaultBegin;
  const auto node = ConfigDocument::parse(f.yaml, "fault");
  const auto kind = node ? fault_kind_named(node->scalar_or_empty("kind")) : std::nullopt;
  if (!kind) return {};
  f.kind = *kind;
  return f;
}

}  // namespace

Result<RecordedEvents> read_recorded_events(const std::filesystem::path& file, const RecordedRun& run) {
  auto reader = record::McapReader::open(file.string());
  if (!reader) return tl::unexpected<Error>(reader.error());
  RecordedEvents events;
  auto cursor = (*reader)->messages({.topics = {"/rigor/events"}, .order = record::MessageOrder::file});
  record::MessageView view;
  while (true) {
    const auto more = cursor.next(view);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) return events;
    record::msg::Event m;
    if (auto s = record::CdrReader::read(view.data, m); !s) return tl::unexpected<Error>(s.error());
    const BenchTime t = run.epoch.to_bench(
        RealtimeTime(std::int64_t{m.header.stamp.sec} * 1'000'000'000 + m.header.stamp.nanosec));
    if (m.code == kEventPairAlarm) {
      events.alarms.push_back({t, m.channel});
    } else if (m.code == kEventMadeSafe && m.value >= 0 && m.value < 1e6) {
      events.made_safe.push_back({t, static_cast<std::size_t>(m.value)});
    } else if (is_fault(m.code)) {
      auto fault = parse_fault(m);
      if (!fault)
        return fail(ErrorCode::protocol, file.string(),
                    "an event of a fault is not as this version writes it: " + m.text);
      fault->t = t;
      events.faults.push_back(std::move(*fault));
    }
  }
}

}  // namespace rigor

#include "bench/run/run_json.h"

#include <nlohmann/json.hpp>

#include "bench/run/bench_run.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/fault_source.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

using nlohmann::json;

const char* name_of(PortStatus status) noexcept {
  switch (status) {
    case PortStatus::never:
      return "never";
    case PortStatus::fresh:
      return "fresh";
    case PortStatus::held:
      return "held";
    case PortStatus::overdue:
      return "overdue";
    case PortStatus::disconnected:
      return "disconnected";
  }
  return "?";
}

RunIdentity identity_of(const RigConfig& rig) {
  RunIdentity id;
  id.rig = rig.name;
  id.file = rig.file;
  id.wall_clock = rig.clock == ClockKind::wall;
  id.seed = rig.seed;
  id.version = RIGOR_VERSION;
  id.spin = rig.loop.spin;
  id.application = rig.application;
  return id;
}

json identity_json(const RunIdentity& run) {
  return {{"rig", run.rig},
          {"file", run.file.string()},
          {"clock", run.wall_clock ? "wall" : "virtual"},
          {"seed", run.seed},
          {"version", run.version}};
}

FaultyReport faulty_report(const FaultySource& source, const std::string& name) {
  const FaultySource::Accounts& a = source.accounts();
  return {name,
          a.taken.load(),
          a.handed_on.load(),
          a.dropped.load(),
          a.disconnected.load(),
          a.no_slot.load(),
          a.waiting.load(),
          source.inner().health()};
}

SinkReport sink_report(const RunSink& sink) {
  return {sink.entry->name, sink.entry->sink.backend, sink.replaced_by, sink.sink->counters()};
}

json commands_json(const SinkSnapshot& n) {
  return {{"accepted", n.accepted}, {"applied", n.applied}, {"late", n.late},
          {"failed", n.failed},     {"dropped", n.dropped}, {"made_safe", n.made_safe}};
}

json faulty_json(const FaultyReport& source) {
  return {{"taken", source.taken},     {"handed_on", source.handed_on},
          {"dropped", source.dropped}, {"disconnected", source.disconnected},
          {"no_slot", source.no_slot}, {"waiting", source.waiting}};
}

}  // namespace rigor

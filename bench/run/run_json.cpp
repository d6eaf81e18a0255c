#include "bench/run/run_json.h"

#include <nlohmann/json.hpp>

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
    case PortStatus::stale:
      return "stale";
    case PortStatus::late:
      return "late";
    case PortStatus::lost:
      return "lost";
  }
  return "?";
}

json identity_json(const RigConfig& rig) {
  return {{"rig", rig.name},
          {"file", rig.file.string()},
          {"clock", rig.clock == ClockKind::wall ? "wall" : "virtual"},
          {"seed", rig.seed},
          {"version", RIGOR_VERSION}};
}

json commands_json(const Sink& sink) {
  const Sink::Counters& n = sink.counters();
  return {{"accepted", n.accepted.load()}, {"applied", n.applied.load()}, {"late", n.late.load()},
          {"failed", n.failed.load()},     {"dropped", n.dropped.load()}, {"made_safe", n.made_safe.load()}};
}

json faulty_json(const FaultySource& source) {
  const FaultySource::Accounts& a = source.accounts();
  return {{"taken", a.taken.load()},     {"handed_on", a.handed_on.load()},
          {"dropped", a.dropped.load()}, {"disconnected", a.disconnected.load()},
          {"no_slot", a.no_slot.load()}, {"waiting", a.waiting.load()}};
}

}  // namespace rigor

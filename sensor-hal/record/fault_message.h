// A begin or an end of a fault as the recording and the live view have it, on `/rigor/faults`.
#pragma once

#include "sensor-hal/channel/fault_injector.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor {

/// All but its time. `change` is there. Any thread that may allocate.
[[nodiscard]] inline record::msg::Fault fault_message(const FaultChange& change) {
  const FaultIdentity& f = *change.fault;
  record::msg::Fault m;
  m.channel = f.of;
  m.index = f.index;
  m.kind = fault_kind_name(f.kind);
  m.live = f.live;
  m.begins = change.begins;
  m.seen = change.seen;
  m.dropped = change.dropped;
  m.changed = change.changed;
  m.delayed = change.delayed;
  m.fault = f.json;
  return m;
}

}  // namespace rigor

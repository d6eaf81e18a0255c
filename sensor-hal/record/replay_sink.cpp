#include "sensor-hal/record/replay_sink.h"

namespace rigor {

bool ReplaySink::command(const Command&) noexcept {
  counters_.accepted.fetch_add(1, std::memory_order_relaxed);
  return true;
}

void ReplaySink::watch(const Heartbeat*, Duration) {}

Status ReplaySink::do_configure(const ChannelConfig& config) {
  description_ = {};
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  for (const ConfigNode& r : params_.list_or_empty("registers")) {
    description_.names.push_back(r.text("name"));
    description_.units.push_back(r.text_or("unit", ""));
  }
  // Signals of a bus, whose units stand in a DBC file that need not be here; of a platform, names.
  for (const ConfigNode& s : params_.list_or_empty("signals")) {
    description_.names.push_back(s.is_map() ? s.text_or("name", s.text("signal")) : s.as_text());
    description_.units.emplace_back();
  }
  return {};
}

}  // namespace rigor

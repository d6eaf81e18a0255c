#include "apps/forest-localization/rig_ports.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace rigor::forest {
namespace {

std::string joined(const auto& named) {
  std::string names;
  for (const auto& [name, port] : named) names += (names.empty() ? "" : ", ") + name;
  return names.empty() ? "there is none" : names;
}

}  // namespace

const InputPort& find_input(const ConfigNode& n, const ApplicationPorts& ports,
                            std::initializer_list<SampleKind> kinds, const char* expected) {
  const std::string name = n.text("channel");
  const auto it = ports.inputs.find(name);
  if (it == ports.inputs.end())
    throw n.error("channel",
                  "expected the name of a channel (" + joined(ports.inputs) + "), got \"" + name + "\"");
  if (std::find(kinds.begin(), kinds.end(), it->second.description->kind) == kinds.end())
    throw n.error("channel",
                  std::string("expected a channel of kind ") + expected + "; \"" + name + "\" is of another");
  return it->second;
}

CommandPort& find_output(const ConfigNode& n, const ApplicationPorts& ports) {
  const std::string name = n.text("sink");
  const auto it = ports.outputs.find(name);
  if (it == ports.outputs.end())
    throw n.error("sink",
                  "expected the name of a sink (" + joined(ports.outputs) + "), got \"" + name + "\"");
  return *it->second;
}

std::uint64_t read_every(const ConfigNode& n, Period loop_period) {
  const double loop_hz = loop_period.hz();
  const double rate_hz = n.number_or("rate_hz", std::min(20.0, loop_hz), {.min = 0.1, .max = loop_hz});
  return static_cast<std::uint64_t>(std::llround(loop_hz / rate_hz));
}

const Sample* fresh_sample(const SamplePort* port) noexcept {
  if (!port || port->status() != PortStatus::fresh || !port->sample()) return nullptr;
  const Sample& s = *port->sample();
  return (s.stamp.validity & (kCorrupt | kIncomplete)) == 0 ? &s : nullptr;
}

}  // namespace rigor::forest

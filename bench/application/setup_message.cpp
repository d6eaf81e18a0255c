#include "bench/application/setup_message.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/application/process_protocol.h"

namespace rigor::application {

using nlohmann::json;

json setup_message(const RigConfig& rig, const ApplicationPorts& ports, Period loop_period,
                   const json& params) {
  json out{{"protocol", kProtocolVersion},
           {"rig", rig.name},
           {"clock", rig.clock == ClockKind::virtual_time ? "virtual" : "wall"},
           {"seed", rig.seed},
           {"loop_rate_hz", loop_period.hz()},
           {"duration_s", rig.duration.seconds()},
           {"params", params},
           {"inputs", json::array()},
           {"outputs", json::array()}};
  for (const auto& [name, input] : ports.inputs) {
    const ChannelDescription& d = *input.description;
    json port{{"name", name},     {"kind", kind_name(d.kind)}, {"frame_id", d.frame_id},  {"names", d.names},
              {"units", d.units}, {"width_px", d.width_px},    {"height_px", d.height_px}};
    if (d.kind == SampleKind::image) port["format"] = pfnc_name(d.format);
    const auto entry = std::ranges::find(rig.channels, name, &ChannelEntry::name);
    if (entry != rig.channels.end()) {
      port["rate_hz"] = entry->period.ns() > 0 ? entry->period.hz() : 0.0;
      port["latency_ms"] = entry->latency.seconds() * 1e3;
    }
    out["inputs"].push_back(std::move(port));
  }
  for (const auto& [name, output] : ports.outputs) {
    json port{{"name", name}, {"names", output->describe().names}, {"units", output->describe().units}};
    const auto entry = std::ranges::find(rig.sinks, name, &SinkEntry::name);
    if (entry != rig.sinks.end()) port["latency_ms"] = entry->latency.seconds() * 1e3;
    out["outputs"].push_back(std::move(port));
  }
  return out;
}

Result<double> rate_of_turns(double of_rig_hz, const json& ready, Period loop_period,
                             const std::string& where) {
  if (of_rig_hz > 0 || !ready.is_object() || !ready.contains("rate_hz")) return of_rig_hz;
  const json& asked = ready["rate_hz"];
  if (!asked.is_number() || !(asked.get<double>() > 0) || asked.get<double>() > loop_period.hz())
    return fail(
        ErrorCode::bad_input, where,
        fmt::format("expected the application to ask for a rate above 0 and of at most the loop's {} Hz, "
                    "got {}",
                    loop_period.hz(), asked.dump()));
  return asked.get<double>();
}

std::uint64_t cycles_of_turn(double rate_hz, Period loop_period) {
  if (rate_hz <= 0) return 1;
  return std::max<std::uint64_t>(1, static_cast<std::uint64_t>(std::llround(loop_period.hz() / rate_hz)));
}

}  // namespace rigor::application

// What an application's process receives before its first turn: the rig, its parameters, its inputs and
// outputs.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::application {

/// {"protocol", "rig", "clock", "seed", "loop_rate_hz", "duration_s", "params",
///  "inputs": [{"name", "kind", "rate_hz", "latency_ms", "frame_id", "width_px", "height_px", "format",
///              "names", "units"}],
///  "outputs": [{"name", "latency_ms", "names", "units"}]}
/// in the order of the indices that turns and answers use. 0 where there is no limit of time or no nominal
/// rate. Setup context.
[[nodiscard]] nlohmann::json setup_message(const RigConfig& rig, const ApplicationPorts& ports,
                                           Period loop_period, const nlohmann::json& params);

/// Turns in a second: those of the rig or, where it says nothing (0), those that the message `ready` asks
/// for; 0: every cycle. bad_input at `where`. Setup context.
[[nodiscard]] Result<double> rate_of_turns(double of_rig_hz, const nlohmann::json& ready, Period loop_period,
                                           const std::string& where);
/// Cycles of the loop from one turn to the next.
[[nodiscard]] std::uint64_t cycles_of_turn(double rate_hz, Period loop_period);

}  // namespace rigor::application

// A window of a pair that is watched, as ROS has diagnostics.
//
//   name: "left pair"   hardware_id: left   level: OK | WARN (learning) | ERROR (alarm)
//   values: pairs, bias, sigma, residual left, …, and of each parameter NAME [UNIT], NAME sigma, NAME level
#pragma once

#include <span>
#include <string>

#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/types/sample.h"

namespace rigor {
struct PairWindow;
namespace pair_watch {
struct Parameter;
}
}  // namespace rigor

namespace rigor::record {

/// `parameters`: of the watch, in its order. What a window does not tell is left out. Any thread; allocates.
[[nodiscard]] msg::DiagnosticStatus pair_diagnostics(const std::string& channel, SampleKind kind,
                                                     std::span<const pair_watch::Parameter> parameters,
                                                     const PairWindow& window);
}  // namespace rigor::record

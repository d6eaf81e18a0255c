// Channels and sinks of the bench by the names in the application's keys.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <numbers>

#include "sensor-hal/channel/application.h"

namespace rigor::forest {

inline constexpr double kRadPerDeg = std::numbers::pi / 180;  ///< keys have degrees

// Setup context; ConfigError with its place is thrown.

/// The channel that `channel` names, of one of these kinds; `expected` has them in words.
[[nodiscard]] const InputPort& find_input(const ConfigNode& n, const ApplicationPorts& ports,
                                          std::initializer_list<SampleKind> kinds, const char* expected);
/// The sink that `sink` names.
[[nodiscard]] CommandPort& find_output(const ConfigNode& n, const ApplicationPorts& ports);
/// Every how many cycles of the loop, by `rate_hz` (20, or as often as the loop runs).
[[nodiscard]] std::uint64_t read_every(const ConfigNode& n, Period loop_period);

/// Loop thread. What came in this cycle, unless it is damaged; null: nothing, or there is no port.
[[nodiscard]] const Sample* fresh_sample(const SamplePort* port) noexcept;

}  // namespace rigor::forest

// What the kernel tells about a bus in error frames (linux/can/error.h), in words and as a state.
#pragma once

#include <cstdint>
#include <string>

#include "sensor-hal/types/sample.h"

namespace rigor::can {

/// ISO 11898-1, 12.1.4: how a controller takes part. `unknown`: no error frame has told yet.
enum class BusState : std::uint8_t { unknown, error_active, error_warning, error_passive, bus_off, stopped };
[[nodiscard]] const char* state_name(BusState state) noexcept;

struct BusErrors {
  bool bus_off = false, restarted = false, tx_timeout = false, lost_arbitration = false,
       no_acknowledge = false, bus_error = false, protocol = false, transceiver = false, controller = false;
  bool rx_overflow = false, tx_overflow = false;  ///< the controller lost frames by itself
  std::uint8_t tx_count = 0, rx_count = 0;        ///< error counters, where the driver gives them
};
/// Any thread, no allocation.
[[nodiscard]] BusErrors read_error(const CanFrame& frame) noexcept;
/// The state after an error frame; `before` where the frame does not tell.
[[nodiscard]] BusState state_after(const CanFrame& frame, BusState before) noexcept;
/// "bus-off", "controller: rx overflow; error counters tx 128 rx 0".
[[nodiscard]] std::string describe_error(const CanFrame& frame);

}  // namespace rigor::can

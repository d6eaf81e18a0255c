// What the real and the virtual side of a channel share, so that virtual time reads the same keys and
// presents the same values as the device would.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "drivers/modbus/modbus_link.h"
#include "drivers/modbus/register_map.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::modbus {

/// Keys of a source: those of an Endpoint, registers, max_gap, max_registers.
struct SourceSettings {
  Endpoint endpoint;
  RegisterMap map;

  /// Throws ConfigError; fills the description.
  [[nodiscard]] static SourceSettings parse(const ChannelConfig& config, ChannelDescription& description);
};

/// Keys of a sink: as a source, and `safe` (name: value, for any of the registers), `verify` (read back what
/// was written), `watchdog` (the device's own: its `register` and `timeout_ms`).
struct SinkSettings {
  Endpoint endpoint;
  RegisterMap map;
  RegisterMap safe_map;  ///< the registers that `safe` names
  std::vector<std::uint16_t> safe_raw;
  std::vector<std::optional<double>> safe;  ///< in the order of `map`
  bool verify = false;
  RegisterMap watchdog_map;  ///< one register, or none
  std::vector<std::uint16_t> watchdog_raw;
  /// Without a new command the last one is written again after this, so that the device's watchdog knows that
  /// its master lives; 0: never.
  Duration refresh;

  [[nodiscard]] static SinkSettings parse(const ChannelConfig& config, ChannelDescription& description);
};

/// Slots of a source's pool: what waits for its release, what the loop, the pair and the recorder hold.
[[nodiscard]] std::size_t pool_slots(const ChannelConfig& config);

/// Writes one block into `sample`. Any thread, no allocation.
void fill_sample(Sample& sample, const RegisterMap& map, std::span<const std::uint16_t> raw) noexcept;

}  // namespace rigor::modbus

// A rig's `controls: { name: value }` against the controls that a device has.
#pragma once

#include "drivers/v4l2/device_table.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::v4l2 {

struct ControlValue {
  std::uint32_t id = 0;
  std::int64_t value = 0;
  std::string name;
};

/// Names as v4l2-ctl writes them. Numbers within range and on a step; flags for booleans and buttons; menus
/// by the item's name (as v4l2-ctl would write it, or as the kernel has it) or index, integer menus by the
/// value. In the order of the file: a device may open up one control by another. Throws ConfigError, which
/// lists the controls that there are, or the range. Setup context.
[[nodiscard]] std::vector<ControlValue> check_controls(const ConfigNode& controls, const DeviceTable& table);

}  // namespace rigor::v4l2
